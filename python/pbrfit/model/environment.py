"""A panorama as light, with all of its detail: windows and lamps show in polished metal.

The panorama is kept blurred by round lobes of many widths, and the reflection of each pixel is a
sum of a few of them, with weights that are never negative (docs/relight.md#panoramas). SH light,
beside it, is what is recovered of pictures: it ends at l = 3.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pbrfit import _core
from pbrfit._core import InputError
from pbrfit.io.color import ColorSpace
from pbrfit.lazy import lazy
from pbrfit.model import panorama
from pbrfit.model.lighting import rotated
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import (
    DEFAULT_MODEL,
    Model,
    View,
    checked_model,
    whole_number,
)
from pbrfit.values.arrays import Array
from pbrfit.values.checks import finite, real_array

LEAST_ROWS = 2
"""Rows of a panorama: with one there is no up and down."""


@dataclass(frozen=True, eq=False)
class Environment:
    """Light from all directions, as a panorama holds it.

    Attributes
    ----------
    pixels
        (H, 2H, 3) equirectangular radiance, linear Rec.709, kept as float32: the centre looks along
        −Z, into the scene, its right half is +X, its top +Y. Channels below 0, of colours beyond
        Rec.709, count as 0.
    rotate
        Degrees that the light is turned by about +Y, from +Z, the viewer, towards +X.

    Raises
    ------
    InputError
        If the pixels have another shape, or are not finite or beyond 10¹⁶.
    """

    pixels: NDArray[np.floating[Any]]
    rotate: float = 0.0

    def __post_init__(self) -> None:
        pixels = real_array("pixels", self.pixels)
        rows = len(pixels) if pixels.ndim else 0
        if pixels.shape != (rows, 2 * rows, 3) or rows < LEAST_ROWS:
            raise InputError(
                f"pixels: expected a panorama of shape (H, 2H, 3), H {LEAST_ROWS} or more, found "
                f"shape {pixels.shape}"
            )
        object.__setattr__(self, "pixels", np.maximum(pixels, 0).astype(np.float32))
        degrees = finite("rotate", self.rotate, "a finite number of degrees")
        object.__setattr__(self, "rotate", degrees)

    def __repr__(self) -> str:
        height, width = self.pixels.shape[:2]
        return f"Environment({width} × {height}, rotate={self.rotate:g})"

    @classmethod
    def read(
        cls,
        path: str | os.PathLike[str],
        rotate: float = 0.0,
        color_space: ColorSpace | None = None,
    ) -> Environment:
        """Read a panorama, as `pbrfit.model.panorama.read` does."""
        return cls(panorama.read(path, color_space), rotate)

    def turned(self, degrees: float) -> Environment:
        """The light turned further about +Y; what is made of its pixels is kept."""
        _ = self.blurred  # which both then share
        further = replace(self, rotate=self.rotate + degrees)
        vars(further).update(
            {k: v for k, v in vars(self).items() if k in ("blurred", "_projected")}
        )
        return further

    @lazy
    def blurred(self) -> _core.Environment:
        """What the core renders with; made once, in about a second."""
        return _core.Environment(self.pixels, 0)

    @lazy
    def _projected(self) -> Array:
        return panorama.nonnegative(panorama.project(self.pixels))

    @property
    def harmonics(self) -> Array:
        """(16, 3): the nearest SH light, damped until it is nowhere negative."""
        return rotated(self._projected, self.rotate)


def render_environment(
    materials: Materials,
    normals: ArrayLike,
    environment: Environment,
    fov: float,
    threads: int = 0,
    *,
    model: Model = DEFAULT_MODEL,
) -> Array:
    """Radiance (H, W, 3), linear Rec.709, of a view under a panorama, with the full model.

    What `render_directional` gives under every pixel of the panorama, by a sum of a few blurred
    look-ups (docs/relight.md#panoramas has the errors). Never negative. Nothing casts a shadow. All
    else is as for `render`.
    """
    model = checked_model(model)
    view, threads = View.of_maps(materials, normals, fov), whole_number("threads", threads)
    turn = math.radians(math.remainder(environment.rotate, 360))
    radiance = environment.blurred.radiance(*view.pixels, turn, threads, model)
    return np.asarray(view.pictures(radiance[None])[0])
