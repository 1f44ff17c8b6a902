"""ParameterLayout: which unknowns a scene has, and where in x they lie."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.sampling import placed
from pbrfit.lazy import lazy
from pbrfit.scene.scene import Scene
from pbrfit.values.arrays import Array, Floats, Mask


@dataclass(frozen=True, eq=False)
class ParameterLayout:
    """Where the unknowns of a scene lie in x.

    x = [albedo (a plane of P valid pixels for each of C channels) | roughness | metallic | tilts
    (two planes) | lighting (N, K, light_channels)], without what is known.
    """

    valid: Mask
    """(H, W) bool: the pixels that are fitted; their row order is the order in x."""
    segments: NDArray[np.intp] | None
    """(P,) labels of the valid pixels: 0 = unclassified, 1 … `segment_count` in the order of the
    scene's ids, without gaps; None where the scene has no segments."""
    segment_count: int
    """Number of segments that have valid pixels."""
    pictures: int
    channels: int
    coefficients: int
    """N; C of albedo; K of one light in one channel."""
    light_channels: int
    """C, or 1 where the lights are the same in all channels."""
    metallic_known: bool
    lighting_known: bool
    """Whether these are no unknowns."""
    weighted: bool = False
    """Whether samples of valid pixels have different weights."""
    free_normals: bool = False
    """Whether the normals are unknowns: then x has a tilt (a, b) for each pixel."""

    @classmethod
    def of(
        cls,
        scene: Scene,
        *,
        sh_order: int = 3,
        metallic_known: bool = False,
        mono_light: bool = False,
        free_normals: bool = False,
    ) -> ParameterLayout:
        """Of the fit of `scene` with these options; see `Objective`.

        Grey pictures have one channel, and known lights without band 3 are of order 2: neither
        changes the fit.
        """
        channels = 1 if scene.grey else 3
        if scene.lighting is not None and not scene.lighting[:, 9:].any():
            sh_order = 2
        segments, count = scene.labels or (None, 0)
        return cls(
            valid=scene.valid,
            segments=segments,
            segment_count=count,
            pictures=len(scene.images),
            channels=channels,
            coefficients=(sh_order + 1) ** 2,
            light_channels=1 if mono_light else channels,
            metallic_known=metallic_known,
            lighting_known=scene.lighting is not None,
            weighted=scene.weighted or scene.limits is not None,
            free_normals=free_normals,
        )

    @lazy
    def pixels(self) -> int:
        """P, the number of valid pixels."""
        return int(np.count_nonzero(self.valid))

    def whole(self, values: Floats) -> Array:
        """(H, W, ...) of values (P, ...) of the valid pixels; NaN elsewhere."""
        return placed(values, self.valid)

    @property
    def sh_order(self) -> int:
        """Highest band of the lights."""
        return math.isqrt(self.coefficients) - 1

    @property
    def albedo(self) -> slice:
        """C planes of P."""
        return slice(0, self.channels * self.pixels)

    @property
    def roughness(self) -> slice:
        """One plane."""
        return slice(self.albedo.stop, self.albedo.stop + self.pixels)

    @property
    def metallic(self) -> slice | None:
        """One plane; None where it is known."""
        end = self.roughness.stop
        return None if self.metallic_known else slice(end, end + self.pixels)

    @property
    def roughness_metallic(self) -> tuple[slice, ...]:
        """The planes that tell one finish from another: roughness, and metallic if it is free."""
        return (self.roughness,) if self.metallic is None else (self.roughness, self.metallic)

    @property
    def materials(self) -> slice:
        """Albedo, roughness and metallic: the maps that lie in [0, 1]."""
        return slice(0, (self.metallic or self.roughness).stop)

    @property
    def tangent_offsets(self) -> slice | None:
        """Two planes, a and b; None where normals are known."""
        end = self.materials.stop
        return slice(end, end + 2 * self.pixels) if self.free_normals else None

    @property
    def maps(self) -> slice:
        """All that are no lights."""
        return slice(0, (self.tangent_offsets or self.materials).stop)

    @property
    def lighting(self) -> slice | None:
        """(N, K, light_channels); None where the lights are known."""
        length = self.pictures * self.coefficients * self.light_channels
        return None if self.lighting_known else slice(self.maps.stop, self.maps.stop + length)

    @property
    def size(self) -> int:
        """Length of x."""
        return int((self.lighting or self.maps).stop)
