"""The maps of a result as textures: finite everywhere, packed into channels, as integers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io.color import encode_srgb
from pbrfit.model.materials import nearest_inside
from pbrfit.result.result import Result
from pbrfit.values.arrays import Array, Mask

NormalConvention = Literal["opengl", "directx"]
"""Which way the green channel of a normal map points: up, or down."""

Bits = Literal[8, 16]


@dataclass(frozen=True)
class Texture:
    """What a texture file holds."""

    name: str
    """Of the file, without suffix."""
    channels: tuple[str, ...]
    """Keys of `CHANNELS`, one a channel of the file."""
    color: bool = False
    """Whether it is a colour: integer files then hold it sRGB-encoded, but for alpha."""
    bits: Bits = 16
    """Of integer files, unless asked otherwise."""

    @property
    def color_space(self) -> str:
        """How integer files hold it, in words."""
        return "sRGB, Rec.709 primaries, D65" if self.color else "data, linear"


@dataclass(frozen=True)
class Maps:
    """The maps of a result; outside the mask they hold the values of the nearest pixel inside."""

    albedo: Array
    """(H, W, 3), linear Rec.709."""
    roughness: Array
    metallic: Array
    """(H, W)."""
    normals: Array
    """(H, W, 3), unit vectors in camera space, Y up."""
    mask: Mask
    """(H, W) bool."""
    deviation: Array | None = None
    """(H, W, 5): standard deviations of the first three, of results that have them."""

    @classmethod
    def of(cls, result: Result) -> Maps:
        """Maps of a result; InputError if no pixel is in the mask, or one in it is not finite."""
        if not result.mask.any():
            raise InputError("mask: expected at least one pixel in it, found none")
        nearest = nearest_inside(result.mask)

        def filled(name: str, values: NDArray[Any]) -> Array:
            found: Array = np.asarray(values, dtype=np.float64)[nearest]
            if not np.isfinite(found).all():
                raise InputError(
                    f"{name}: expected finite values inside the mask, found NaN or infinity"
                )
            return found

        deviation = None
        if result.uncertainty is not None:
            deviation = filled("deviation", result.uncertainty.deviation.planes)
        return cls(
            albedo=filled("albedo", result.albedo),
            roughness=filled("roughness", result.roughness),
            metallic=filled("metallic", result.metallic),
            normals=filled("normals", result.normals),
            mask=result.mask,
            deviation=deviation,
        )

    def floats(self, texture: Texture) -> NDArray[np.float32]:
        """Channels of a texture, (H, W, C) float32; colours are linear."""
        return self._stacked(texture).astype(np.float32)

    def integers(self, texture: Texture, bits: Bits) -> NDArray[Any]:
        """The same, (H, W, C) uint8 or uint16, 0 to 1 on all codes; colours are sRGB-encoded."""
        values = np.clip(self._stacked(texture), 0.0, 1.0)
        if texture.color:
            values[..., :3] = encode_srgb(values[..., :3])
        return codes(values, bits)

    def _stacked(self, texture: Texture) -> Array:
        return np.stack([CHANNELS[name](self) for name in texture.channels], axis=-1)


def codes(values: Array, bits: Bits) -> NDArray[Any]:
    """Values from 0 to 1 as uint8 or uint16, spread over all codes."""
    return np.floor(values * ((1 << bits) - 1) + 0.5).astype(np.uint8 if bits == 8 else np.uint16)


def _deviation(channel: int, maps: Maps) -> Array:
    assert maps.deviation is not None
    return maps.deviation[..., channel]


BASE_COLOR_DEVIATION = tuple(f"deviation of linear base color {c}" for c in "RGB")

DEVIATIONS = (*BASE_COLOR_DEVIATION, "deviation of roughness", "deviation of metallic")

CHANNELS: dict[str, Callable[[Maps], Array]] = {
    "base color R": lambda maps: maps.albedo[..., 0],
    "base color G": lambda maps: maps.albedo[..., 1],
    "base color B": lambda maps: maps.albedo[..., 2],
    "roughness": lambda maps: maps.roughness,
    "smoothness = 1 − roughness": lambda maps: 1 - maps.roughness,
    "metallic": lambda maps: maps.metallic,
    "0.5 + 0.5 normal X": lambda maps: 0.5 + 0.5 * maps.normals[..., 0],
    "0.5 + 0.5 normal Y": lambda maps: 0.5 + 0.5 * maps.normals[..., 1],
    "0.5 − 0.5 normal Y": lambda maps: 0.5 - 0.5 * maps.normals[..., 1],
    "0.5 + 0.5 normal Z": lambda maps: 0.5 + 0.5 * maps.normals[..., 2],
    **{name: partial(_deviation, c) for c, name in enumerate(DEVIATIONS)},
    "mask": lambda maps: maps.mask.astype(np.float64),
    "occlusion, none": lambda maps: np.ones(maps.mask.shape),
    "detail mask, none": lambda maps: np.zeros(maps.mask.shape),
    "unused": lambda maps: np.zeros(maps.mask.shape),
}
"""What a channel of a texture may hold: (H, W) in [0, 1]."""

BASE_COLOR = ("base color R", "base color G", "base color B")
GREEN: dict[NormalConvention, str] = {
    "opengl": "0.5 + 0.5 normal Y",
    "directx": "0.5 − 0.5 normal Y",
}
NORMAL = ("0.5 + 0.5 normal X", GREEN["opengl"], "0.5 + 0.5 normal Z")
