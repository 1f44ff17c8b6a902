"""Lamps: lights from single directions, far away or near, one or several a picture.

A lamp has no size. A far one shines along one direction everywhere and is told as
`DirectionalLight` is: by the radiance of a white diffuse surface that faces it, its irradiance over
π. A near one at q brings a point p of the scene, from the direction (q − p)/d at the distance
d = |q − p|,

    E/π = color / d² · max(axis · (p − q)/d, 0)^exponent,

with an exponent of 0 where it shines alike to all sides.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io.json_files import as_json
from pbrfit.io.lamp_files import LampRow
from pbrfit.values.arrays import Array, Mask
from pbrfit.values.checks import reals

UNIT = 1e-5
"""Largest difference of a direction's length from 1."""


@dataclass(frozen=True, eq=False)
class Lamps:
    """K lamps of N pictures; InputError if a shape does not fit or a value cannot be used."""

    pictures: NDArray[np.intp]
    """(K,) index of the picture that each lights, from 0; in rising order."""
    places: Array
    """(K, 3), camera space (X right, Y up, Z towards the viewer): of far lamps the unit vector from
    the scene to the lamp; of near ones where they are, in the unit of the scene's depth, the camera
    at 0."""
    near: Mask = field(default=None)  # type: ignore[arg-type]
    """(K,) bool."""
    colors: Array = field(default=None)  # type: ignore[arg-type]
    """(K, 3), linear Rec.709, 0 or more: radiance of a white diffuse surface that faces the lamp,
    of near ones at a distance of 1. NaN = unknown."""
    axes: Array = field(default=None)  # type: ignore[arg-type]
    exponents: Array = field(default=None)  # type: ignore[arg-type]
    """(K, 3) unit vectors and (K,): where near lamps shine, and how much they are gathered there;
    an exponent of 0 = alike to all sides."""

    def __post_init__(self) -> None:
        pictures = np.asarray(self.pictures)
        count = pictures.size
        if pictures.shape != (count,) or pictures.dtype.kind not in "iu":
            raise InputError(f"lamps: expected indices of pictures (K,), found {pictures.dtype}")
        if count and (pictures.min() < 0 or (np.diff(pictures) < 0).any()):
            raise InputError("lamps: expected indices of pictures in rising order, from 0")
        near = np.zeros(count, bool) if self.near is None else np.asarray(self.near, bool)
        defaults: dict[str, Any] = {
            "places": np.zeros((count, 3)),
            "colors": np.full((count, 3), np.nan),
            "axes": np.tile([0.0, 0.0, -1.0], (count, 1)),
            "exponents": np.zeros(count),
        }
        for name, default in defaults.items():
            given = getattr(self, name)
            array = reals(f"lamps: {name}", default if given is None else given).astype(np.float64)
            if array.shape != default.shape:
                raise InputError(f"lamps: expected {name} {default.shape}, found {array.shape}")
            if name != "colors" and not np.isfinite(array).all():
                raise InputError(f"lamps: expected finite {name}, found NaN or infinity")
            object.__setattr__(self, name, array)
        if near.shape != (count,):
            raise InputError(f"lamps: expected near {(count,)}, found {near.shape}")
        for name, vectors in (("places of far lamps", self.places[~near]), ("axes", self.axes)):
            if (np.abs(np.linalg.norm(vectors, axis=-1) - 1) > UNIT).any():
                raise InputError(f"lamps: expected {name} of unit length")
        if (self.colors < 0).any() or np.isinf(self.colors).any() or (self.exponents < 0).any():
            raise InputError("lamps: expected finite colors and exponents, 0 or more")
        object.__setattr__(self, "pictures", pictures.astype(np.intp))
        object.__setattr__(self, "near", near)

    def __len__(self) -> int:
        return len(self.pictures)

    @property
    def colored(self) -> bool:
        """Whether all colours are known."""
        return not np.isnan(self.colors).any()

    def in_words(self) -> str:
        """How many there are of which kind: 3 far lamps."""
        near = int(self.near.sum())
        counts = [f"{n} {kind}" for n, kind in ((len(self) - near, "far"), (near, "near")) if n]
        return f"{' and '.join(counts) or 'no'} lamp{'' if len(self) == 1 else 's'}"

    def check_pictures(self, count: int) -> None:
        """Raise InputError if a lamp is of a picture beyond so many."""
        if len(self) and self.pictures[-1] >= count:
            last = int(self.pictures[-1])
            raise InputError(f"lamps: expected indices of {count} pictures, found {last}")

    def of_pictures(self, chosen: Sequence[int]) -> Lamps:
        """The lamps of some pictures, which are counted anew in this order."""
        rows = [np.flatnonzero(self.pictures == i) for i in chosen]
        of = np.concatenate([*rows, np.zeros(0, np.intp)]).astype(np.intp)
        renamed = np.repeat(np.arange(len(rows)), [len(one) for one in rows])
        return self._rows(of, renamed.astype(np.intp))

    def only(self, k: int) -> Lamps:
        """Lamp k alone, of a picture 0."""
        return self._rows(np.array([k], np.intp), np.zeros(1, np.intp))

    def _rows(self, of: NDArray[np.intp], pictures: NDArray[np.intp]) -> Lamps:
        every: Any = (self.places, self.near, self.colors, self.axes, self.exponents)
        return Lamps(pictures, *(values[of] for values in every))

    def at(self, points: Array | None, count: int = 1) -> tuple[Array, Array]:
        """Unit vectors to the lamps (P, K, 3), and strengths (P, K) that colours are multiplied by.

        Points (P, 3) are in the unit of near lamps; None = nobody knows them, and there are
        `count`. Raises InputError if lamps are near and there are no points.
        """
        if points is None and self.near.any():
            raise InputError("lamps: expected depth for near lamps, found none")
        size = count if points is None else len(points)
        directions = np.tile(self.places, (size, 1, 1))
        strengths = np.ones((size, len(self)))
        if points is not None and self.near.any():
            away = self.places[self.near] - points[:, None, :]
            squared = np.maximum(np.einsum("pkx,pkx->pk", away, away), np.finfo(np.float64).tiny)
            away /= np.sqrt(squared)[..., None]
            along = np.maximum(-np.einsum("pkx,kx->pk", away, self.axes[self.near]), 0.0)
            directions[:, self.near] = away
            strengths[:, self.near] = along ** self.exponents[self.near] / squared
        return directions, strengths


def lamps_of_rows(rows: Sequence[LampRow], pictures: Sequence[int]) -> Lamps:
    """Lamps of rows, each with the index of its picture, in any order."""
    order = np.argsort(np.array(pictures, np.intp), kind="stable")
    rows = [rows[i] for i in order]
    places, colors, axes = (
        np.array([getattr(row, name) for row in rows], np.float64).reshape(-1, 3)
        for name in ("place", "color", "axis")
    )
    near = np.array([row.near for row in rows], bool)
    exponents = np.array([row.exponent for row in rows], np.float64)
    return Lamps(np.array(pictures, np.intp)[order], places, near, colors, axes, exponents)


def entries_of_lamps(lamps: Lamps, names: Sequence[str]) -> list[dict[str, Any]]:
    """Entries, as files have them, of lamps of pictures with these names."""
    found = []
    for k, i in enumerate(lamps.pictures):
        place, color, axis = (of[k].tolist() for of in (lamps.places, lamps.colors, lamps.axes))
        entry = {"picture": names[i], "position" if lamps.near[k] else "direction": place}
        if not all(map(math.isnan, color)):
            entry["color"] = as_json(color)
        if lamps.near[k] and lamps.exponents[k] > 0:
            entry |= {"axis": axis, "exponent": float(lamps.exponents[k])}
        found.append(entry)
    return found
