"""Transfer curves and primaries: the one place that knows how colour is encoded.

The working space is linear Rec.709 with white D65. Matrices are computed from chromaticities.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache, reduce
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pbrfit._core import InputError, average_light
from pbrfit.io.limits import Limits, converted
from pbrfit.values.arrays import Array, Floats
from pbrfit.values.checks import one_of

ColorSpace = Literal["srgb", "linear", "acescg", "display-p3", "adobe-rgb"]
"""How stored values are to be read.

``srgb``: sRGB curve, Rec.709 primaries. ``linear``: linear Rec.709. ``acescg``: linear ACES AP1,
white about D60. ``display-p3``: sRGB curve, P3 primaries, D65. ``adobe-rgb``: Adobe RGB (1998).
"""

Curve = Literal["srgb", "linear"]
"""Transfer curves that files without a profile may have."""


class Primaries(NamedTuple):
    """CIE xy chromaticities of the three primaries and of the white point."""

    red: tuple[float, float]
    green: tuple[float, float]
    blue: tuple[float, float]
    white: tuple[float, float]


# ITU-R BT.709 (also IEC 61966-2-1, sRGB); SMPTE EG 432-1 primaries with D65; S-2014-004 (ACEScg);
# ST 2065-1 (ACES2065-1); ITU-R BT.2020; Adobe RGB (1998) color image encoding, 2005; CIE 1931,
# white of equal energy.
REC709 = Primaries((0.64, 0.33), (0.30, 0.60), (0.15, 0.06), (0.3127, 0.3290))
DISPLAY_P3 = Primaries((0.680, 0.320), (0.265, 0.690), (0.150, 0.060), (0.3127, 0.3290))
ACES_AP1 = Primaries((0.713, 0.293), (0.165, 0.830), (0.128, 0.044), (0.32168, 0.33767))
ACES_AP0 = Primaries((0.7347, 0.2653), (0.0, 1.0), (0.0001, -0.077), (0.32168, 0.33767))
REC2020 = Primaries((0.708, 0.292), (0.170, 0.797), (0.131, 0.046), (0.3127, 0.3290))
ADOBE_RGB = Primaries((0.64, 0.33), (0.21, 0.71), (0.15, 0.06), (0.3127, 0.3290))
CIE_XYZ = Primaries((1.0, 0.0), (0.0, 1.0), (0.0, 0.0), (1 / 3, 1 / 3))

_SPACES: dict[str, tuple[Curve | float, Primaries]] = {
    "srgb": ("srgb", REC709),
    "linear": ("linear", REC709),
    "acescg": ("linear", ACES_AP1),
    "display-p3": ("srgb", DISPLAY_P3),
    "adobe-rgb": (563 / 256, ADOBE_RGB),
}

# Parts of names such as lin_ap1_scene (Color Interop Forum: Color Space Encodings for Texture
# Assets and CG Rendering); lin_srgb, too, is Rec.709.
_CURVES: dict[str, Curve | float] = {"lin": "linear", "srgb": "srgb", "g22": 2.2}
_GAMUTS = {"rec709": REC709, "srgb": REC709, "p3d65": DISPLAY_P3, "rec2020": REC2020}
_GAMUTS |= {"ap0": ACES_AP0, "ap1": ACES_AP1, "adobergb": ADOBE_RGB}

# Code points of Rec. ITU-T H.273 that are acted upon.
CODED_PRIMARIES = {1: REC709, 9: REC2020, 12: DISPLAY_P3}
CODED_CURVES: dict[int, Curve | float] = {4: 2.2, 5: 2.8, 8: "linear", 13: "srgb"}

# White of the profile connection space, ICC.1:2022, 7.2.16, in XYZ.
ICC_D50 = np.array([0.9642, 1.0, 0.8249])

# Cone responses of the Bradford transform (Lam 1985), as in ICC.1:2022, annex E.
_BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)


def over_channels(of: np.ufunc, values: NDArray[Any]) -> NDArray[Any]:
    """(...): a function of two over the last axis of (..., C), faster than its own `reduce`."""
    return reduce(of, np.moveaxis(values, -1, 0))


def decode_srgb(encoded: ArrayLike) -> Array:
    """Linear light of sRGB values (IEC 61966-2-1), 1 = white; of negative ones by symmetry."""
    value = np.asarray(encoded, dtype=np.float64)
    size = np.abs(value)
    linear = np.where(size <= 0.04045, size / 12.92, ((size + 0.055) / 1.055) ** 2.4)
    return np.copysign(linear, value)


def encode_srgb(linear: ArrayLike) -> Array:
    """Encode linear light of any shape as sRGB, float64, not clipped: undoes `decode_srgb`."""
    value = np.asarray(linear, dtype=np.float64)
    size = np.abs(value)
    encoded = np.where(size <= 0.0031308, size * 12.92, 1.055 * size ** (1 / 2.4) - 0.055)
    return np.copysign(encoded, value)


def rgb_to_xyz(primaries: Primaries) -> Array:
    """Matrix (3, 3) from linear RGB to CIE XYZ, white with Y = 1.

    The columns are the primaries, (x, y, 1-x-y), scaled so that they add up to the white point.
    Raises InputError if the y of white is not above 0, or three of the four lie on one line.
    """
    points = np.array(primaries)
    x, y = points.T
    found = points.tolist()
    if not np.isfinite(points).all() or y[3] < 1e-6:
        raise InputError(f"chromaticities: expected finite xy, of white y > 0, found {found}")
    xyz = np.stack([x, y, 1 - x - y])
    columns, white = xyz[:, :3], xyz[:, 3] / y[3]
    if np.linalg.cond(columns) <= 1e6:
        scaled = np.asarray(columns * np.linalg.solve(columns, white))
        if np.linalg.cond(scaled) <= 1e6:
            return scaled
    raise InputError(f"chromaticities: expected a triangle around white, found {found}")


def to_rec709(primaries: Primaries) -> Array:
    """Matrix (3, 3) from linear RGB to Rec.709, whose rows sum to 1; raises as `rgb_to_xyz`."""
    to_xyz = rgb_to_xyz(primaries)
    return colorants_to_rec709(to_xyz, to_xyz.sum(axis=1))


def colorants_to_rec709(to_xyz: ArrayLike, white: Array) -> Array:
    """Matrix (3, 3) to linear Rec.709 of colorants (columns) in XYZ under a white (3,) in XYZ."""
    rec709 = rgb_to_xyz(REC709)
    gain = (_BRADFORD @ rec709.sum(axis=1)) / (_BRADFORD @ white)  # adapts white to white
    adapt = np.linalg.solve(_BRADFORD, gain[:, None] * _BRADFORD)
    return np.asarray(np.linalg.solve(rec709, adapt @ np.asarray(to_xyz, dtype=np.float64)))


@dataclass(frozen=True)
class Place:
    """Where the pixels of a picture are put, and which: they are averaged to its arrays' size."""

    used: tuple[slice, slice]
    """Rows and columns of the upright picture."""
    pixels: NDArray[np.float32]
    """(height, width, 3), in one piece, to be filled."""
    limits: Limits
    """Zeros of that shape, in one piece."""

    @classmethod
    def new(cls, size: tuple[int, ...], used: tuple[slice, slice] = np.s_[:, :]) -> Place:
        """Of new arrays of a size (height, width); all of the picture unless part is `used`."""
        return cls(used, np.empty((*size, 3), np.float32), np.zeros((*size, 3), np.uint8))


@dataclass(frozen=True)
class Conversion:
    """The way from stored samples to linear Rec.709."""

    curve: Curve | float | NDArray[np.float32]
    """``"srgb"``, ``"linear"``, an exponent, or sampled curves (1 or 3, levels), float32."""
    matrix: Array | None = None
    """(3, 3) from linear RGB to linear Rec.709, or None for the identity."""

    def __call__(self, samples: NDArray[Any]) -> NDArray[np.float32]:
        """Samples (H, W, 3), uint8, uint16 or floating, as linear Rec.709 float32, a new array."""
        place = Place.new(samples.shape[:2])
        self.average(samples, place)
        return place.pixels

    def average(
        self, samples: NDArray[Any], place: Place, codes: tuple[int, int] | None = None
    ) -> bool:
        """Fill a place with linear Rec.709 of samples (H, W, 1 to 4), without alpha.

        Integers beyond `codes` are at a limit, as by `of_limits`. Returns whether one is.
        """
        pixels = place.pixels
        curves = np.empty((1, 1), np.float32)
        if samples.dtype.kind == "u":
            curves = self._sampled(int(np.iinfo(samples.dtype).max) + 1)
        else:
            assert not isinstance(self.curve, np.ndarray), "curves are sampled for integers"
            samples = _decoded(samples, self.curve).astype(np.float32, copy=False)
        within = zip(place.used, samples.shape[:2], strict=True)
        ranges = [part.indices(length)[:2] for part, length in within]
        # Of red, green and blue in all 27 combinations, at 9 red + 3 green + blue.
        colors = converted(np.indices((3, 3, 3), np.uint8).reshape(3, 27).T, self.matrix)
        some = average_light(samples, ranges, curves, codes, colors, pixels, place.limits)
        if self.matrix is not None:
            # Plane by plane: the same bits whichever linear algebra library numpy is linked with.
            red, green, blue = (pixels[..., k].copy() for k in range(3))
            for k, row in enumerate(self.matrix.astype(np.float32)):
                pixels[..., k] = row[0] * red + row[1] * green + row[2] * blue
        return some

    def of_limits(self, limits: Limits, size: tuple[int, ...]) -> Limits:
        """Limits (height, width, 3), `converted`, of means over the area that falls on each pixel.

        A mean that has a part in a sample of "at least" is at least what it is, whatever else it
        has a part in; else it is "at most" if it has a part in one of those.
        """
        place = Place.new(size)
        # Below 1 is "at most", above it "at least".
        self.average(np.array([1, 2, 0], np.uint8)[limits], place, (1, 1))
        return place.limits

    def slopes(self, linear: Floats, levels: int) -> NDArray[np.float32]:
        """Radiance a code, of `levels`, before the matrix, at linear Rec.709 (..., 3)."""
        if self.matrix is not None:
            linear = linear @ np.linalg.inv(self.matrix).T.astype(np.float32)
        if isinstance(self.curve, str):
            slope = np.ones_like(linear, dtype=np.float32)
            if self.curve == "srgb":
                # IEC 61966-2-1 by its derivative: of value 1 a code, 2.4/1.055 y^(1.4/2.4).
                power = (2.4 / 1.055) * np.maximum(linear, 0.0031308) ** np.float32(1.4 / 2.4)
                slope = np.where(linear <= 0.0031308, np.float32(1 / 12.92), power)
            return slope / np.float32(levels - 1)
        found = np.empty(linear.shape, dtype=np.float32)
        curves = self._sampled(levels).astype(np.float64)
        for k in range(3):
            curve = curves[k % len(curves)]
            found[..., k] = np.interp(linear[..., k], curve, np.gradient(curve))
        return found

    def _sampled(self, levels: int) -> NDArray[np.float32]:
        return self.curve if isinstance(self.curve, np.ndarray) else _table(self.curve, levels)


def _decoded(values: NDArray[Any], curve: Curve | float) -> NDArray[Any]:
    """Linear light of encoded values, 1 = white; of negative ones by odd symmetry."""
    if curve == "linear":
        return values
    if curve == "srgb":
        return decode_srgb(values)
    return np.asarray(np.copysign(np.abs(values, dtype=np.float64) ** curve, values))


@cache
def _table(curve: Curve | float, levels: int) -> NDArray[np.float32]:
    """(1, levels) float32: linear light of the codes 0 to levels - 1."""
    table = _decoded(np.arange(levels) / (levels - 1), curve).astype(np.float32)[None]
    table.setflags(write=False)
    return table


def conversion(space: ColorSpace) -> Conversion:
    """Conversion from a named colour space; InputError if it is not one of `ColorSpace`."""
    one_of("color_space", space, ColorSpace)
    return from_primaries(*_SPACES[space])


def from_primaries(curve: Curve | float, primaries: Primaries) -> Conversion:
    """Conversion from a curve and primaries; InputError as `rgb_to_xyz`."""
    return Conversion(curve, None if near_rec709(primaries) else to_rec709(primaries))


def of_name(name: str) -> tuple[Curve | float, Primaries] | None:
    """The space that a file names: as `ColorSpace` does, or the Color Interop Forum; or None."""
    # OpenColorIO's are for people: "Linear Rec.709 (sRGB)".
    plain = re.sub(r"\(.*\)|\W", "", re.sub("^linear ", "lin_", name.lower()))
    curve, _, gamut = re.sub("_(scene|display)$", "", plain).partition("_")
    if curve in _CURVES and gamut in _GAMUTS:
        return _CURVES[curve], _GAMUTS[gamut]
    return _SPACES.get(name.lower())


def nearest_name(convert: Conversion, dtype: np.dtype[Any]) -> str | None:
    """The named space that integers of a type are in, to 1/255 of white; None = none of them."""
    codes = (np.eye(4, 3) * np.iinfo(dtype).max * 0.6 + np.iinfo(dtype).max * 0.3).astype(dtype)
    for name, space in _SPACES.items():
        off = convert(codes[None]) - from_primaries(*space)(codes[None])
        if np.abs(off).max() <= 1 / 255:
            return name
    return None


def near_rec709(primaries: Primaries) -> bool:
    """Whether chromaticities are those of Rec.709 to within rounding (5e-4)."""
    return bool(np.abs(np.subtract(REC709, primaries)).max() <= 5e-4)


def from_icc(curves: list[NDArray[np.float32]], to_xyz: ArrayLike | None) -> Conversion:
    """Conversion from an ICC profile: 1 or 3 curves (levels,), linear light per code; colorants.

    `to_xyz` (3, 3) has the colorants as columns, XYZ under D50; None = a grey profile. Those of
    Rec.709 to within the rounding that profiles have (1e-3 in the matrix) count as Rec.709.
    """
    matrix = None if to_xyz is None else colorants_to_rec709(to_xyz, ICC_D50)
    if matrix is not None and np.abs(matrix - np.eye(3)).max() <= 1e-3:
        matrix = None
    return Conversion(np.stack(curves), matrix)
