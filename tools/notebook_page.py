"""A notebook as a page of the site, executed.

python tools/notebook_page.py NOTEBOOK.ipynb ... --out DIR

writes DIR/NAME.md and its pictures DIR/NAME/*. `page_of` does the same without executing.
"""

from __future__ import annotations

import argparse
import re
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbconvert import MarkdownExporter
from nbformat import NotebookNode

TIME_LIMIT = 300
"""Of a cell, in seconds."""


def read(path: Path) -> NotebookNode:
    """A notebook."""
    return nbformat.read(path, as_version=4)


def executed(notebook: NotebookNode) -> NotebookNode:
    """Run all cells, in a folder that is thrown away; raises if one fails."""
    with tempfile.TemporaryDirectory() as folder:
        return NotebookClient(
            notebook,
            timeout=TIME_LIMIT,
            extra_arguments=["--log-level=ERROR"],
            resources={"metadata": {"path": folder}},
        ).execute()


def page_of(notebook: NotebookNode, pictures: str = "") -> tuple[str, dict[str, bytes]]:
    """Markdown, and its pictures by name; `pictures` is the folder that links name."""
    text, resources = MarkdownExporter().from_notebook_node(notebook)
    text = re.sub(r"\x1b\[[0-9;]*m", "", text)
    found = resources.get("outputs", {})
    for name in found:
        text = text.replace(f"]({name})", f"]({pictures}/{name})")
    return text, found


def main() -> None:
    """Write the pages."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("notebooks", metavar="NOTEBOOK", nargs="+", type=Path)
    parser.add_argument("--out", metavar="DIR", type=Path, required=True)
    options = parser.parse_args()
    for path in options.notebooks:
        text, pictures = page_of(executed(read(path)), path.stem)
        folder = options.out / path.stem
        folder.mkdir(parents=True, exist_ok=True)
        for old in folder.iterdir():
            old.unlink()
        for name, content in pictures.items():
            (folder / name).write_bytes(content)
        (options.out / f"{path.stem}.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
