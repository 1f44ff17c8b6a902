"""`lighting.json`: lights of named pictures, the one format for them everywhere."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pbrfit._core import InputError
from pbrfit.io.json_files import expecting, read_as, read_json, table, write_json
from pbrfit.io.lamp_files import LENGTH_OFF_MAX, rows_of_json, unit
from pbrfit.model.lamps import Lamps, entries_of_lamps, lamps_of_rows
from pbrfit.model.reflection import sh_basis
from pbrfit.values.checks import finite, of_what, real_array
from pbrfit.values.quoting import quoted, shown

BAND_OF = np.repeat(np.arange(4), 2 * np.arange(4) + 1)
"""(16,): band l of coefficient k."""

BASIS = "real SH, no Condon-Shortley phase, index l(l+1)+m"
ORDER = 3


VERSION = 2
"""Of files with lamps; those without have none, as there was none before."""


@dataclass(frozen=True)
class Lighting:
    """SH light of each picture, and its lamps.

    Raises InputError if lamps are of pictures beyond the names.
    """

    pictures: tuple[str, ...]
    """Names, one a picture."""
    coefficients: NDArray[np.float64]
    """(N, 16, 3) float64: picture, coefficient k = l(l+1)+m, channel; linear Rec.709. Where there
    are lamps, the ambient light beside them."""
    lamps: Lamps | None = None
    """None = all light is in the coefficients."""

    def __post_init__(self) -> None:
        if self.lamps is not None:
            self.lamps.check_pictures(len(self.pictures))

    def save(self, path: Path) -> None:
        """Write `lighting.json`."""
        content: dict[str, Any] = {} if self.lamps is None else {"version": VERSION}
        content |= {
            "basis": BASIS,
            "order": ORDER,
            "pictures": list(self.pictures),
            "coefficients": self.coefficients.tolist(),
        }
        if self.lamps is not None:
            content["lamps"] = entries_of_lamps(self.lamps, self.pictures)
        write_json(path, content)

    @classmethod
    def load(cls, path: Path) -> Lighting:
        """Read `lighting.json`.

        Raises InputError if the file is not what `save` writes; the message names the file.
        """
        parts = "JSON with basis, order, pictures and coefficients"
        content = read_json(path, parts)
        with expecting(path, parts):
            content = table(content)
            basis, order = content["basis"], content["order"]
            pictures = read_as(tuple[str, ...], content["pictures"])
            stored = np.array(content["coefficients"])
            if stored.dtype.kind not in "if":
                raise ValueError(f"coefficients of type {stored.dtype}")
            coefficients = stored.astype(np.float64)
            lamps = _listed(content)
        if (basis, order) != (BASIS, ORDER):
            raise InputError(
                f"{path}: expected basis {BASIS!r} of order {ORDER}, "
                f"found {quoted(basis)} of order {quoted(order)}"
            )
        expected = (len(pictures), 16, 3)
        if coefficients.shape != expected:
            raise InputError(
                f"{path}: expected coefficients of shape {expected}, one light for each name in "
                f"pictures, found shape {coefficients.shape}"
            )
        if len(set(pictures)) != len(pictures):
            twice = next(name for name in pictures if pictures.count(name) > 1)
            raise InputError(f"{path}: expected one light a name, found {shown(twice)} twice")
        if not np.isfinite(coefficients).all():
            raise InputError(f"{path}: expected finite coefficients, found NaN or infinity")
        return cls(pictures, coefficients, None if lamps is None else _lamps(path, lamps, pictures))

    def of(self, pictures: tuple[str, ...], path: Path) -> NDArray[np.float64]:
        """Coefficients in the order of `pictures`; `path` is named when one has no light."""
        missing = [name for name in pictures if name not in self.pictures]
        if missing:
            raise InputError(
                f"{path}: expected a light for every picture, found none for {missing[0]}"
                + (f" and {len(missing) - 1} more" if len(missing) > 1 else "")
            )
        return self.coefficients[[self.pictures.index(name) for name in pictures]]


def _listed(content: Mapping[str, Any]) -> list[Any] | None:
    """What stands under `lamps`, in files of version 2; one of `UNFIT` if that does not fit."""
    if "version" not in content:
        if "lamps" in content:
            raise ValueError(f"lamps without version {VERSION}")
        return None
    if content["version"] != VERSION:
        raise ValueError(f"version {quoted(content['version'])} in place of {VERSION}")
    lamps = content["lamps"]
    if not isinstance(lamps, list):
        raise ValueError(f"{quoted(lamps)} in place of a list of lamps")
    return lamps


def _lamps(path: Path, entries: Sequence[Any], pictures: tuple[str, ...]) -> Lamps:
    rows = rows_of_json(path, entries)
    for i, row in enumerate(rows):
        if row.picture not in pictures:
            raise InputError(
                f"{path}: lamp {i + 1}: expected the name of a picture of the file, found "
                f"{shown(row.picture)}"
            )
        length = math.hypot(*row.place)
        if not row.near and not abs(length - 1) <= LENGTH_OFF_MAX:
            raise InputError(
                f"{path}: lamp {i + 1}: expected a direction of length 1, found {length:.4g}"
            )
    rows = [row if row.near else replace(row, place=unit(row.place)) for row in rows]
    return lamps_of_rows(rows, [pictures.index(row.picture) for row in rows])


def rotated(coefficients: ArrayLike, degrees: float) -> NDArray[np.float64]:
    """SH lights (..., 16, 3) turned about +Y, from +Z towards +X.

    Radiance from R d is then what it was from d. A light is known where its radiance is known in
    some 16 directions or more, so with Y of directions d, and of those turned back,

        Y(d) L' = Y(R⁻¹ d) L   ⇒   L' = Y(d)⁺ Y(R⁻¹ d) L.
    """
    light = real_array("coefficients", coefficients)
    if light.shape[-2:] != (16, 3) or not np.isfinite(light).all():
        raise InputError(
            f"coefficients: expected finite lights (..., 16, 3), found {of_what(light)}"
        )
    angle = math.radians(math.remainder(finite("degrees", degrees), 360))
    back = np.array(
        [[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]]
    )
    rotation = np.linalg.pinv(sh_basis(_SPREAD)) @ sh_basis(_SPREAD @ back.T)
    with np.errstate(over="ignore", invalid="ignore"):
        turned = np.asarray(rotation @ light)
    if not np.isfinite(turned).all():
        raise InputError("coefficients: expected lights that float64 can hold when turned")
    return turned


def spread_directions(count: int, height: float = 2.0) -> NDArray[np.float64]:
    """Directions spread evenly, on a spiral, over a cap of the unit sphere around Z: (count, 3)."""
    index = np.arange(count)
    z = 1 - (index + 0.5) / count * height
    around = index * np.pi * (3 - np.sqrt(5))
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(around), radius * np.sin(around), z], axis=-1)


_SPREAD = spread_directions(64)
