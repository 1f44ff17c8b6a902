"""Pages of the site beside those of docs/: hooks of MkDocs, which mkdocs.yml names.

README.md and its neighbours become pages, and links between them and docs/ are turned, so that the
same files read well on a code host. The reference is made of the public names and of `pbrfit
COMMAND --help`. Notebooks are pages as `tools/notebook_page.py` executed them into out/notebooks,
else without outputs; reports of the gallery are those that `tools/gallery.py` left in out/gallery.
"""

from __future__ import annotations

import os
import posixpath
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import notebook_page
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import pbrfit

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = ROOT / "out" / "notebooks"
GALLERY = ROOT / "out" / "gallery"

FROM_ROOT = {
    "README.md": "overview.md",
    "ARCHITECTURE.md": "architecture.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
}
"""Files beside docs/ that are pages."""

AS_THEY_ARE = ("CITATION.cff", "LICENSE-MIT", "LICENSE-APACHE")
"""Files beside docs/ that pages link to."""

NAMES = {
    "From pictures to a result": ("Scene", "decompose", "FitOptions", "Priors", "Progress"),
    "Results": ("Result", "Materials", "Status", "Truth"),
    "Light": ("relight", "DirectionalLight"),
    "The forward model": tuple(f"kernel.{name}" for name in pbrfit.kernel.__all__),
    "Bring your own optimiser": ("Objective",),
    "Other": ("InputError",),
}
"""Public names by what they are for. One that stands nowhere here goes to the last."""

LINK = re.compile(r"\[(?P<text>[^][]*)\]\((?P<path>[^)#:\s]+)(?P<anchor>#[^)\s]*)?\)")
CODE = re.compile(r"^```.*?^```|`[^`\n]+`", re.DOTALL | re.MULTILINE)
LIVE = re.compile(r"<!-- live: (?P<name>[\w-]+) -->")
NOT_LIVE = re.compile(r"<!-- not live -->.*?<!-- /not live -->", re.DOTALL)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add what is not below docs/."""
    for source, page in FROM_ROOT.items():
        files.append(File.generated(config, page, abs_src_path=str(ROOT / source)))
    for name in AS_THEY_ARE:
        files.append(File.generated(config, name, abs_src_path=str(ROOT / name)))
    files.append(File.generated(config, "python.md", content=python_page()))
    files.append(File.generated(config, "commands.md", content=commands_page()))
    for path in sorted((ROOT / "docs" / "notebooks").glob("*.ipynb")):
        executed = NOTEBOOKS / f"{path.stem}.md"
        page = f"notebooks/{path.stem}.md"
        if executed.is_file():
            files.append(File.generated(config, page, abs_src_path=str(executed)))
        else:
            text, _ = notebook_page.page_of(notebook_page.read(path))
            files.append(File.generated(config, page, content=text))
        for picture in sorted((NOTEBOOKS / path.stem).glob("*")):
            uri = f"notebooks/{path.stem}/{picture.name}"
            files.append(File.generated(config, uri, abs_src_path=str(picture)))
    for report in sorted(GALLERY.glob("*.html")):
        uri = f"gallery/{report.name}"
        files.append(File.generated(config, uri, abs_src_path=str(report)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn links to where the site has what they name, and name the reports there are."""
    del config
    here = page.file.src_uri
    origin = next((name for name, uri in FROM_ROOT.items() if uri == here), f"docs/{here}")
    if here == "gallery.md":
        markdown = with_reports(markdown)
    # Not in code: what stands there is kept and put back.
    kept: list[str] = []

    def keep(code: re.Match[str]) -> str:
        kept.append(code[0])
        return f"\0{len(kept) - 1}\0"

    def turned(link: re.Match[str]) -> str:
        wanted = posixpath.normpath(posixpath.join(posixpath.dirname(origin), link["path"]))
        uri = site_uri(wanted)
        found = None if uri is None else files.get_file_from_path(uri)
        if uri is None or found is None:
            return link[0]  # MkDocs says what is wrong with it
        text = link["text"]
        if text in (link["path"], posixpath.basename(link["path"]), wanted):
            text = title_of(found)
        target = posixpath.relpath(uri, posixpath.dirname(here) or ".") + (link["anchor"] or "")
        return f"[{text}]({target})"

    text = LINK.sub(turned, CODE.sub(keep, markdown))
    return re.sub("\0(\\d+)\0", lambda number: kept[int(number[1])], text)


def title_of(file: File) -> str:
    """What a page is called, where a link names its file: its heading up to a colon."""
    heading = (
        re.match(r"# ([^:\n]+)", file.content_string) if file.is_documentation_page() else None
    )
    return heading[1] if heading else file.name


def site_uri(path: str) -> str | None:
    """Where the site has a file of the repository; None if nowhere."""
    if path in FROM_ROOT:
        return FROM_ROOT[path]
    if path in AS_THEY_ARE:
        return path
    if path.startswith("docs/"):
        return re.sub(r"^docs/|\.ipynb$", lambda part: "" if part[0] == "docs/" else ".md", path)
    return None


def with_reports(markdown: str) -> str:
    """The gallery with a link to each report that was made."""

    def link(place: re.Match[str]) -> str:
        if not (GALLERY / f"{place['name']}.html").is_file():
            return ""
        return f"[Open it in the viewer](gallery/{place['name']}.html){{ .md-button }}"

    if any(GALLERY.glob("*.html")):
        markdown = NOT_LIVE.sub("", markdown)
    return LIVE.sub(link, markdown)


def python_page() -> str:
    """The reference of all public names."""
    known = {name for names in NAMES.values() for name in names}
    if gone := {name for name in known if "." not in name} - set(pbrfit.__all__):
        raise PluginError(f"tools/site_pages.py: no public names any more: {', '.join(gone)}")
    rest = tuple(name for name in pbrfit.__all__ if name not in known and name[0] != "_")
    groups = {**NAMES, "Other": (*NAMES["Other"], *rest)}
    parts = [
        "# Python",
        "Everything public is in `pbrfit` and `pbrfit.kernel`. Arrays are linear Rec.709; axes, "
        "spherical harmonics and units are in [Conventions](conventions.md).",
    ]
    for title, names in groups.items():
        parts.append(f"## {title}")
        parts += [f"::: pbrfit.{name}\n    options:\n      heading_level: 3" for name in names]
    return "\n\n".join(parts)


def commands_page() -> str:
    """What each command says of itself."""
    parts = ["# Commands", "As `pbrfit COMMAND --help` prints it."]
    names = re.findall(r"^    ([a-z][a-z-]*)(?: |$)", help_of(), re.MULTILINE)
    for name in names:
        parts.append(f"## {name}\n\n```text\n{help_of(name)}```")
    return "\n\n".join(parts)


def help_of(*command: str) -> str:
    """Help of pbrfit, or of a command of it."""
    environment: dict[str, Any] = {**os.environ, "COLUMNS": "88", "NO_COLOR": "1"}
    asked = [
        sys.executable,
        "-m",
        "pbrfit",
        *command,
        "--help-all" if command == ("decompose",) else "--help",
    ]
    return subprocess.run(
        asked, env=environment, cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout
