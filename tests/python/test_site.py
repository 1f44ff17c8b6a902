"""The documentation as pages: what `make site` needs, without its packages; and the notebooks."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))
BESIDE = [ROOT / name for name in ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md")]

CODE = re.compile(r"^```.*?^```|`[^`\n]+`", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\]\((?P<path>[^)#:\s]*)(?:#(?P<anchor>[^)\s]+))?\)")


def anchors(page: Path) -> set[str]:
    """As code hosts and the site name headings."""
    text = re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)
    headings = re.findall(r"^#+ +(.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", one).strip().lower().replace(" ", "-") for one in headings}


def broken(page: Path) -> Iterator[str]:
    for link in LINK.finditer(CODE.sub("", page.read_text("utf-8"))):
        target = (page.parent / link["path"]).resolve() if link["path"] else page
        if not target.exists():
            yield f"{page.relative_to(ROOT)}: no file {link['path']}"
        elif link["anchor"] and target.suffix == ".md" and link["anchor"] not in anchors(target):
            yield f"{page.relative_to(ROOT)}: no heading {link['path']}#{link['anchor']}"


def test_links_between_pages_lead_somewhere() -> None:
    found = [one for page in (*DOCS.rglob("*.md"), *BESIDE) for one in broken(page)]
    assert not found, "\n".join(found)


def test_pages_that_code_names_are_there() -> None:
    files = [*(ROOT / "python").rglob("*.py"), *(ROOT / "tools").glob("*.py")]
    named = {one for p in files for one in re.findall(r"docs/[\w/-]+\.md", p.read_text("utf-8"))}
    assert [one for one in named if not (ROOT / one).exists()] == []


def test_every_page_is_in_the_navigation() -> None:
    _, _, navigation = (ROOT / "mkdocs.yml").read_text("utf-8").partition("\nnav:\n")
    named = set(re.findall(r"[\w./-]+\.md$", navigation, re.MULTILINE))
    there = {str(path.relative_to(DOCS)) for path in DOCS.rglob("*.md")}
    there |= {f"notebooks/{path.stem}.md" for path in NOTEBOOKS}
    assert there <= named, f"mkdocs.yml lacks {', '.join(sorted(there - named))}"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_hold_no_outputs_and_import_what_there_is(path: Path) -> None:
    cells = json.loads(path.read_text("utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert not any(cell["outputs"] or cell["execution_count"] for cell in code)
    lines = [line for cell in code for line in cell["source"]]
    imports = [line for line in lines if re.match(r"(from|import) pbrfit\b", line)]
    assert imports
    exec("".join(imports), {})


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of the packages that run notebooks
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path: Path, tmp_path: Path) -> None:
    pytest.importorskip("ipykernel")
    nbclient = pytest.importorskip("nbclient")
    nbformat = pytest.importorskip("nbformat")
    notebook = nbformat.read(path, as_version=4)
    place = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(notebook, timeout=300, resources=place).execute()
    assert not (DOCS / "notebooks" / "my_scene").exists()
