"""What a folder of pictures lacks: normals, weights, segments, depth, estimates, lamps."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.io.input_files import there
from pbrfit.io.lamp_files import LAMP_FILES, find_lamps, write_lamps
from pbrfit.io.normal_files import NORMAL_FILES, find_normals, write_normals
from pbrfit.io.output import check_free_file, new_file
from pbrfit.io.weight_files import WEIGHT_FILE, write_weights
from pbrfit.model.lamps import Lamps, entries_of_lamps
from pbrfit.scene import folder as scene_folder
from pbrfit.scene.folder import HEIGHT_FILE
from pbrfit.scene.writing import write_height
from pbrfit.values.arrays import Array, Floats
from pbrfit.values.checks import any_array, errors_about


def picture_size(folder: Path) -> tuple[int, int]:
    """(height, width) of a scene folder's pictures, as its maps must have it.

    Raises InputError or OSError if there is no picture that can be read.
    """
    files = scene_folder.locate(folder)
    height, width = files.settings().picture(files.pictures[0]).pixels.shape[:2]
    return height, width


def check_normals_can_be_added(folder: Path, *, overwrite: bool, height: bool = False) -> None:
    """Check what can be checked before the normals are there: making them may take long.

    Raises FileExistsError if the folder has normals or weights, or a height where there will be
    one, and `overwrite` is False, or they are no files; InputError or OSError if there is no such
    folder, or its `scene.toml` states a convention that nothing can be turned into.
    """
    _to_convention(folder, np.zeros(3))
    scene_folder.locate(folder)
    parts = {"normals": NORMAL_FILES, "weights": [WEIGHT_FILE], "height": [HEIGHT_FILE] * height}
    for what, names in parts.items():
        check_none(folder, names, what, overwrite=overwrite, replaced=" normals and weights")


def add_normals(
    folder: Path,
    normals: Floats,
    *,
    uncertainty: Floats | None = None,
    weights: Floats | None = None,
    height: Floats | None = None,
    overwrite: bool = False,
) -> list[Path]:
    """Write `normals.exr`, and `weights.exr` and `height.exr` if there are any; returns the paths.

    The normals are turned into the convention that the folder's `scene.toml` states, so that they
    are read back as they are given. Weights of earlier normals are not weights of these: with
    `overwrite` they are replaced, or removed where there are none now. Normals (H, W, 3) are in
    camera space, of the pictures' size; uncertainty (H, W), in degrees, is kept as a channel of
    `normals.exr`; weights (H, W) are how much the pixels count; height (H, W) is in pixels, NaN
    where unknown. Raises FileExistsError if the folder has normals, weights or a height that is to
    be written and `overwrite` is False; InputError if the normals have another size.
    """
    check_normals_can_be_added(folder, overwrite=overwrite, height=height is not None)
    any_array("normals", normals, (*picture_size(folder), 3))
    stored = _to_convention(folder, normals)
    path, weight_path = folder / "normals.exr", folder / WEIGHT_FILE
    if height is not None:
        write_height(folder / HEIGHT_FILE, height)
    write_normals(path, stored, uncertainty)  # what cannot be written costs nothing
    for other in find_normals(folder):
        if other != path:
            other.unlink()
    written = [path] if height is None else [path, folder / HEIGHT_FILE]
    if weights is None:
        weight_path.unlink(missing_ok=True)
        return written
    write_weights(weight_path, weights, ())
    return [*written, weight_path]


def _to_convention(folder: Path, normals: Floats) -> Array:
    """Normals (..., 3) of camera space as the folder's `scene.toml` says they are written."""
    settings = scene_folder.read_settings(folder / "scene.toml")
    with errors_about(folder / "scene.toml"):
        return settings.convention.from_camera(normals)


def add_map(
    folder: Path,
    what: str,
    names: Sequence[str],
    plane: NDArray[Any],
    write: Callable[[Path], object],
    *,
    overwrite: bool,
) -> Path:
    """Have the first of the `names` of a map written, of which `plane` is one; returns its path.

    Raises FileExistsError if there is one and `overwrite` is False; InputError if its size is not
    the pictures'.
    """
    check_none(folder, names, what, overwrite=overwrite)
    any_array(what, plane, picture_size(folder))
    path = folder / names[0]
    write(path)  # what cannot be written costs nothing
    for name in names[1:]:
        (folder / name).unlink(missing_ok=True)
    return path


def check_none(
    folder: Path, names: Iterable[str], what: str, *, overwrite: bool, replaced: str = ""
) -> None:
    """Raise FileExistsError if files are there and `overwrite` is False, or what is is no file."""
    for path in (folder / name for name in names):
        if there(path) and not overwrite:
            raise FileExistsError(
                f"{path}: expected no {what} yet, found some; overwrite=True replaces{replaced}"
            )
        check_free_file(path, overwrite=True)


def add_lamps(folder: Path, lamps: Lamps, *, overwrite: bool = False) -> Path:
    """Write `lights.json`; returns its path.

    Raises FileExistsError as `check_no_lamps`; InputError if lamps are of other pictures.
    """
    check_no_lamps(folder, overwrite=overwrite)
    names = scene_folder.locate(folder).names
    lamps.check_pictures(len(names))
    path = folder / LAMP_FILES[0]
    with new_file(path, overwrite=overwrite) as temporary:
        write_lamps(temporary, entries_of_lamps(lamps, names))
    return path


def check_no_lamps(folder: Path, *, overwrite: bool) -> None:
    """Raise FileExistsError if the folder has lamps, but for a `lights.json` with `overwrite`."""
    path = next(iter(find_lamps(folder)), folder / LAMP_FILES[0])
    own = path.name == LAMP_FILES[0]
    if not there(path) or (overwrite and own):
        return
    other = f"it is read as it is; move it away to write {LAMP_FILES[0]}"
    remedy = "overwrite=True replaces" if own else other
    raise FileExistsError(f"{path}: expected no lamps yet, found some; {remedy}")
