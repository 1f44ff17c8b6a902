"""A page for people about a result: one HTML file that needs nothing else (docs/report.md)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pbrfit._core import InputError
from pbrfit.io.output import new_file

if TYPE_CHECKING:
    from pbrfit.result.result import Result
    from pbrfit.scene.scene import Scene


def write_report(
    result: Result,
    path: str | Path,
    scene: Scene | str | Path | None = None,
    overwrite: bool = False,
) -> None:
    """Write a page about a result, whole or not at all; at most 20 MB.

    Parameters
    ----------
    result
        The result.
    path
        File to write, .html.
    scene
        The scene that the result was made from, or its folder, to show the pictures beside their
        reconstructions. None = the folder that the result was read from, as long as it is there and
        unchanged; without pictures the page says why.
    overwrite
        Replace an existing file.

    Raises
    ------
    InputError
        If the path is no name of a page, or `scene` is not the scene of the result.
    FileExistsError
        If the file exists and `overwrite` is False.
    OSError
        If a file cannot be read or written.
    """
    # Here: an import of one part of this package, such as the viewer, does not need all of them.
    from pbrfit.report import originals
    from pbrfit.report.page import page

    path = Path(path)
    if path.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"{path}: expected a name that ends with .html, found {path.name!r}")
    with new_file(path, overwrite=overwrite) as file:
        content = page(result, *originals.find(result, scene))
        file.write_text(content, encoding="utf-8")
