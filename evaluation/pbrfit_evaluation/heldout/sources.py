"""Sets of pictures of one view: where they are, how they are read, and what is known of them.

A *source* is a scene folder, perhaps with a `set.json` that says where it comes from and what is
known, or one of the public sets as it was published; `write_scene` makes a scene folder of those.
"""

from __future__ import annotations

import logging
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io.color import ColorSpace
from pbrfit.io.json_files import UNFIT, read_json, unfit
from pbrfit.io.normal_files import find_normals
from pbrfit.io.resampling import averaged_channels
from pbrfit.scene import folder as scene_folder
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.heldout.public_sets import ROOMS, SETS, Source, room_source
from pbrfit_evaluation.normal_errors import unit

Array = NDArray[np.float64]

SET, NORMALS = "set.json", "normals.npz"
"""Of a scene folder, beside what pbrfit reads: what it is, and true normals to compare with."""

UNLICENSED = "none stated"
"""How the licence of a set begins of which nothing may be published."""

BRICK_HEIGHT = 1.8
"""Distance along Z of the brick sphere's lamps, whose files tell X and Y alone: the one that
explains the pictures best on the true sphere, to within 0.1."""


@dataclass(frozen=True, eq=False)
class Opened:
    """A source, read."""

    scene: Scene
    """As pbrfit reads it, without true materials and known lighting."""
    lamps: Array | None
    """(N, 3) vectors to the far lamps of the pictures, one each, as long as they are strong; unit
    vectors where nobody knows how strong; None = unknown."""
    normals: Array | None
    """(H, W, 3) true ones that the scene is not told, NaN where unknown; None = no such."""


# ------------------------------------------------------------------------------------- finding


def find_data(folders: Sequence[Path], environment: Mapping[str, str]) -> list[Path]:
    """Folders as given, else that of PBRFIT_DATA; InputError if there is neither."""
    if folders:
        return list(folders)
    if environment.get("PBRFIT_DATA"):
        return [Path(environment["PBRFIT_DATA"])]
    raise InputError("FOLDER: expected folders of pictures, found none, and PBRFIT_DATA is not set")


def find_sources(path: Path) -> list[Source]:
    """Sources that a path names: a scene folder, a public set, or a folder that holds such.

    Scene folders with a `set.json` are found one folder further down, too.

    Raises
    ------
    FileNotFoundError, InputError
        If there is no such folder, or nothing in it that could be pictures of one view.
    """
    if not path.is_dir():
        there = "a file" if path.exists() else "nothing of that name"
        raise FileNotFoundError(f"{path}: expected a folder of pictures, found {there}")
    found = _sources_at(path)
    if not found:
        folders = [one for one in sorted(path.iterdir()) if one.is_dir() and one.name[0] != "."]
        for folder in folders:
            found += _sources_at(folder) or [
                source
                for below in sorted(folder.glob(f"*/{SET}"))
                for source in _sources_at(below.parent)
            ]
    if not found:
        raise InputError(
            f"{path}: expected a scene folder or one of {', '.join(SETS)}, found none of them"
        )
    return found


def check_names(sources: Sequence[Source]) -> None:
    """Raise InputError if two sources have one name: records are kept by it."""
    names = [source.name for source in sources]
    for source in sources:
        if names.count(source.name) > 1:
            raise InputError(
                f"{source.folder}: expected different names, found {source.name} twice"
            )


def _sources_at(path: Path) -> list[Source]:
    name = path.resolve().name
    if name in SETS:
        return SETS[name].find(path)
    if not scene_folder.is_scene(path):
        return []
    if not (path / "images").is_dir() and not find_normals(path):
        return [room_source(path)]
    said = _said(path)
    licence = str(said.get("licence", ""))
    about = "; ".join(str(said[key]) for key in ("what", "source", "licence") if said.get(key))
    pictures = len(scene_folder.locate(path).pictures)
    private = licence.startswith(UNLICENSED)
    return [Source(name, path, "scene", pictures, about or "scene folder, as it is", private)]


def _said(folder: Path) -> dict[str, Any]:
    path, expected = folder / SET, "an object"
    content = read_json(path, expected) if path.exists() else {}
    if not isinstance(content, dict):
        raise InputError(f"{path}: expected {expected}, found {type(content).__name__}")
    return content


# ------------------------------------------------------------------------------------- reading


def write_scene(source: Source, folder: Path) -> None:
    """Write a public set as a scene folder, into a folder that exists and is empty."""
    SETS[source.kind].write(source, folder)


@contextmanager
def scene_of(source: Source) -> Iterator[Path]:
    """The scene folder of a source, for a while; rooms stay without normals."""
    if source.kind in ("scene", ROOMS):
        yield source.folder
    else:
        with tempfile.TemporaryDirectory() as folder:
            write_scene(source, Path(folder))
            yield Path(folder)


def opened(
    source: Source, max_size: int, most: int = 1000, color_space: ColorSpace | None = None
) -> Opened:
    """Read a source; of more pictures than `most`, so many, evenly chosen.

    Raises
    ------
    InputError, OSError
        If a file cannot be used.
    """
    logger = logging.getLogger("pbrfit")
    with scene_of(source) as folder:
        before, logger.disabled = logger.disabled, True  # it would say the same for each way
        try:
            scene = Scene.load(folder, max_size=max_size, color_space=color_space)
        finally:
            logger.disabled = before
    count = len(scene.images)
    lamps = _lamps(source, scene)
    if lamps is not None and lamps.shape != (count, 3):
        raise InputError(
            f"{source.folder}: expected a lamp for each of {count} pictures, found {len(lamps)}"
        )
    some = np.linspace(0, count - 1, min(count, most)).round().astype(int).tolist()
    return Opened(
        replace(scene, lighting=None, truth=None).of_pictures(some),
        None if lamps is None else lamps[some],
        None if scene.normals_known else _true_normals(source.folder, scene),
    )


def _true_normals(folder: Path, scene: Scene) -> Array | None:
    path = folder / NORMALS
    if not path.exists():
        return None
    with np.load(path) as arrays:
        normals = np.asarray(arrays[arrays.files[0]], np.float64)
    if normals.ndim != 3 or normals.shape[2] != 3:
        raise InputError(f"{path}: expected an array (H, W, 3), found {normals.shape}")
    normals = averaged_channels(np.nan_to_num(normals), (scene.height, scene.width))
    with np.errstate(invalid="ignore"):
        return np.where(scene.valid[..., None], unit(normals), np.nan)


def _lamps(source: Source, scene: Scene) -> Array | None:
    """As of `Opened`, of all pictures."""
    path, said = source.folder / SET, _said(source.folder)
    if said.get("directions"):
        try:
            directions = unit(np.array(said["directions"], np.float64))
            colors = np.array(said.get("colors") or np.ones_like(directions), np.float64)
            return np.asarray(directions * colors.mean(axis=-1, keepdims=True))
        except UNFIT as error:
            raise unfit(path, "directions and colors (N, 3)", error) from None
    if source.kind == "bunny_ps":
        with np.load(source.folder / f"{source.name}.npz") as arrays:
            return np.asarray(arrays["lights"], np.float64)
    if source.kind.startswith("visiont3lab"):
        # As OpenCV writes it: its longest list of numbers.
        text = (source.folder / "LightMatrix.yml").read_text(encoding="utf-8")
        numbers = max(re.findall(r"\[([^\]]*)\]", text), key=len).split(",")
        return unit(np.array(numbers, np.float64).reshape(-1, 3))
    if source.kind == "maxcrous_sphere_color":  # Sphere_X_Y
        places = [[*map(float, name.split("_")[1:]), BRICK_HEIGHT] for name in scene.names]
        return unit(np.array(places))
    lamps = scene.lamps
    if lamps is None or lamps.near.any() or len(lamps) != len(scene.images):
        return None
    return lamps.places
