"""Photographs of one view under lamps, and what is known of them: lamps, and perhaps true normals.

Of public sets the lamps are those that come with them. A scene folder may have lamps and normals of
its own (docs/formats.md), or, beside what pbrfit reads, what nobody but this suite is to know:
`true_lamps.npy` (N, 3), direction times relative strength, and `true_normals.npy` (H, W, 3), both
in camera space.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io.lamp_files import find_lamps
from pbrfit.io.resampling import averaged_channels
from pbrfit.model.lamps import Lamps
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.normal_errors import unit
from pbrfit_evaluation.real.sources import CODE_RANGE, SETS, Source, load

Array = NDArray[np.float64]

LIGHTS, NORMALS = "true_lamps.npy", "true_normals.npy"
"""Of a scene folder: what only this suite reads."""

TRUE_NORMALS = ("bunny_ps", "visiont3lab_ball3", "maxcrous_sphere_color")
"""Public sets whose normals are no estimates."""

ROOMS, ROOM_FOV = "mit_multi_illumination", 60.0
"""Photographs of rooms, and the horizontal field of view in degrees that they are taken to have."""

BRICK_HEIGHT = 1.8
"""Distance along Z of the brick sphere's lamps, whose files tell X and Y alone: the one that
explains the pictures best on the true sphere, to within 0.1."""


@dataclass(frozen=True, eq=False)
class Known:
    """Distant lamps of N pictures, one each.

    Attributes
    ----------
    directions
        (N, 3) unit vectors to the lamps, camera space.
    strengths
        (N,) relative to each other; None = unknown.
    """

    directions: Array
    strengths: Array | None

    @classmethod
    def of(cls, vectors: Array) -> Known:
        """From directions times strengths, (N, 3)."""
        strengths = np.linalg.norm(vectors, axis=-1)
        return cls(vectors / strengths[:, None], strengths)

    def of_pictures(self, chosen: tuple[int, ...]) -> Known:
        """The lamps of some pictures, in this order."""
        at = list(chosen)
        strengths = None if self.strengths is None else self.strengths[at]
        return Known(self.directions[at], strengths)

    @property
    def lamps(self) -> Lamps:
        """For a scene; colours unknown, as nobody knows them but up to a factor."""
        return Lamps(np.arange(len(self.directions), dtype=np.intp), self.directions)


@dataclass(frozen=True, eq=False)
class Photographs:
    """A source, read.

    Attributes
    ----------
    scene
        The pictures; neither normals nor lamps.
    known
        The lamps; None = unknown.
    normals
        (H, W, 3) true ones, to compare with, NaN outside the mask; None = unknown.
    """

    scene: Scene
    known: Known | None
    normals: Array | None


def read(source: Source, max_size: int | None = None, fov: float | None = None) -> Photographs:
    """Read a source; `fov` in degrees overrides what a scene folder says of its own.

    Raises
    ------
    InputError, OSError
        If a file cannot be used.
    """
    if source.kind in SETS and source.kind != ROOMS:
        given = load(source, max_size)
    else:
        of = ROOM_FOV if source.kind == ROOMS else fov
        given = Scene.load(source.folder, fov=of, max_size=max_size, code_range=CODE_RANGE)
    scene = replace(
        given,
        normals=None,  # type: ignore[arg-type]
        lamps=None,
        lighting=None,
        truth=None,
        source=None,
        model=None,
    )
    return Photographs(scene, _lamps(source, given), _normals(source, given))


def has_lamps(source: Source) -> bool:
    """Whether `read` will know the lamps."""
    if source.kind == "scene":
        return (source.folder / LIGHTS).exists() or find_lamps(source.folder) is not None
    return source.kind in _LAMPS


def _normals(source: Source, given: Scene) -> Array | None:
    path = source.folder / NORMALS
    if source.kind == "scene" and path.exists():
        normals = np.load(path)
        if normals.ndim != 3 or normals.shape[2] != 3:
            raise InputError(f"{path}: expected an array (H, W, 3), found {normals.shape}")
        small = averaged_channels(
            np.where(np.isfinite(normals), normals, 0.0), (given.height, given.width)
        )
        with np.errstate(invalid="ignore"):
            return np.where(given.valid[..., None], unit(small), np.nan)
    if source.kind in TRUE_NORMALS or (source.kind == "scene" and given.normals_known):
        return np.asarray(given.normals, np.float64)
    return None


def _lamps(source: Source, given: Scene) -> Known | None:
    path = source.folder / LIGHTS
    if source.kind in _LAMPS:
        known = _LAMPS[source.kind](source, given.names)
    elif source.kind == "scene" and path.exists():
        known = Known.of(np.load(path).astype(np.float64))
    elif given.lamps is not None:
        return _of_scene(given.lamps, len(given.images))
    else:
        return None
    if known.directions.shape != (len(given.images), 3):
        raise InputError(
            f"{source.folder}: expected a lamp for each of {len(given.images)} pictures, found "
            f"{len(known.directions)}"
        )
    return known


def _of_scene(lamps: Lamps, pictures: int) -> Known | None:
    """Lamps that a scene has, if there is one far one a picture."""
    if lamps.near.any() or not np.array_equal(lamps.pictures, np.arange(pictures)):
        return None
    strengths = lamps.colors.mean(axis=-1) if lamps.colored else None
    return Known(lamps.places, strengths)


# Public sets


def _of_arrays(source: Source, _: tuple[str, ...]) -> Known:
    with np.load(source.folder / f"{source.name}.npz") as arrays:
        return Known.of(arrays["lights"].astype(np.float64))


def _of_matrix(source: Source, _: tuple[str, ...]) -> Known:
    """`LightMatrix.yml` as OpenCV writes it: its longest list of numbers."""
    path = source.folder / "LightMatrix.yml"
    lists = re.findall(r"\[([^\]]*)\]", path.read_text(encoding="utf-8"))
    numbers = np.array([float(text) for text in max(lists, key=len).split(",")])
    if numbers.size % 3:
        raise InputError(f"{path}: expected three numbers a lamp, found {numbers.size}")
    vectors = numbers.reshape(-1, 3)
    return Known(unit(vectors), np.ones(len(vectors)))


def _of_names(_: Source, names: tuple[str, ...]) -> Known:
    """Files named Sphere_X_Y; lamps at one height above the camera's plane, not equally strong."""
    places = [[float(part) for part in name.split("_")[1:]] + [BRICK_HEIGHT] for name in names]
    return Known(unit(np.array(places)), None)


_LAMPS: Mapping[str, Callable[[Source, tuple[str, ...]], Known]] = {
    "bunny_ps": _of_arrays,
    "visiont3lab_shrek": _of_matrix,
    "visiont3lab_ball3": _of_matrix,
    "maxcrous_sphere_color": _of_names,
}
"""Lamps of a source by its kind and the names of its pictures."""
