"""Panoramas: light from all directions as an equirectangular picture, to and from SH lights.

The centre of a panorama looks along −Z, into the scene; its right half is +X, its top +Y. With
W × H pixels, column j and row i counted from 0,

    φ = 2π ((j + ½)/W − ½)      d = (sin φ cos θ, sin θ, −cos φ cos θ)
    θ = π (½ − (i + ½)/H)

where d points to where the light comes from.
"""

from __future__ import annotations

import logging
import os

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pbrfit._core import InputError
from pbrfit.io import images
from pbrfit.io.color import ColorSpace
from pbrfit.io.limits import AT_LEAST
from pbrfit.model.lighting import BAND_OF
from pbrfit.model.reflection import sh_basis
from pbrfit.values.arrays import Array, Floats

log = logging.getLogger("pbrfit")

CHUNK = 1 << 18
"""Pixels whose basis is held at once: 32 MiB of it."""

FEWEST_ROWS = 7
"""Products of two functions with l = 3 have degree 6; with fewer rows, or columns, `solid_angles`
does not integrate them exactly, and grey panoramas would light unevenly."""

NEGATIVE_MAX = 1 / 255
"""Share of a panorama's light that may be negative, and is taken for 0: a code of 8 bits."""


def directions(height: int, width: int, rows: slice = slice(None)) -> Array:
    """Where the light of each pixel, in some rows, comes from: (h, width, 3) unit vectors."""
    around = 2 * np.pi * ((np.arange(width) + 0.5) / width - 0.5)
    up = np.pi * (0.5 - (np.arange(height)[rows] + 0.5) / height)[:, None]
    return np.stack(
        np.broadcast_arrays(np.sin(around) * np.cos(up), np.sin(up), -np.cos(around) * np.cos(up)),
        axis=-1,
    )


def solid_angles(height: int, width: int) -> Array:
    """Solid angle that a pixel of each row stands for, in steradians: (height,).

    All pixels together have 4π. These are the weights of Fejér's first rule, whose nodes are the
    centres of rows: unlike areas of pixels they integrate smooth light exactly, SH lights among
    them,

        w_i = (2π/W) (2/H) (1 − 2 Σ_k cos(2 k θ_i)/(4 k² − 1)),  k = 1 ... H/2 rounded down,

    with θ_i the angle from the top. They differ from areas by O(1/H²).

    Source: L. Fejér, "Mechanische Quadraturen mit positiven Cotesschen Zahlen", 1933.
    """
    from scipy.fft import dct

    k = np.arange(height // 2 + 1)
    series = np.zeros(height)
    # The sum over even frequencies is a cosine transform of type III, a_0 + 2 Σ a_j cos(j θ_i).
    even = k[2 * k < height]
    series[2 * even] = -1 / (4.0 * even**2 - 1)
    return np.asarray(dct(series, type=3) * (2 * np.pi / width) * (2 / height))


def read(
    path: str | os.PathLike[str], color_space: ColorSpace | None = None
) -> NDArray[np.float32]:
    """Read a panorama as linear Rec.709: (H, 2H, 3).

    Other pictures than EXR and Radiance HDR files are read too, but know no light above white,
    which is warned of where they reach it. So are infinities, taken for the brightest pixel or
    65504, where half floats end; and a little negative radiance, as filters leave it, taken for 0.
    `color_space` is as for `images.read_picture`. Raises InputError if it cannot be read as a
    picture, is not twice as wide as high or too small, holds NaN or nothing finite, or so much
    negative radiance that light changes (`NEGATIVE_MAX`). Colours that only other primaries than
    Rec.709 hold are negative in Rec.709 and welcome. Raises OSError if the file cannot be read.
    """
    picture = images.read_picture(path, color_space)
    pixels = picture.pixels
    height, width = pixels.shape[:2]
    if width != 2 * height:
        raise InputError(
            f"{path}: expected a panorama twice as wide as high (equirectangular), "
            f"found {width} × {height}"
        )
    infinite = np.isposinf(pixels)
    below = picture.negative[..., None] & (pixels < 0)
    light = solid_angles(height, width)[:, None, None] * np.where(infinite, 0, pixels)
    too_much = -light[below].sum() > NEGATIVE_MAX * np.abs(light).sum()
    for wrong, what in (
        ((~np.isfinite(pixels) & ~infinite).any(axis=-1) | infinite.all(), "NaN or infinity"),
        (picture.negative & too_much, "negative radiance"),
    ):
        if len(places := np.argwhere(wrong)):
            raise InputError(
                f"{path}: expected finite radiance of 0 or more, found {what} in {len(places)} "
                f"pixels, the first in column {places[0, 1]} of row {places[0, 0]}"
            )
    if height < FEWEST_ROWS:
        raise InputError(
            f"{path}: expected a panorama of {2 * FEWEST_ROWS} × {FEWEST_ROWS} pixels or more, "
            f"found {width} × {height}"
        )
    most = max(float(pixels[~infinite].max()), float(np.finfo(np.float16).max))
    for wrong, what, value in ((infinite, "infinite", most), (below, "negative", 0.0)):
        if wrong.any():
            pixels[wrong] = value
            count = np.count_nonzero(wrong.any(axis=-1))
            log.warning("%s: %d pixels are %s, taken for %g", path, count, what, value)
    clipped = picture.limits is not None and (picture.limits == AT_LEAST).any(axis=-1)
    if np.any(clipped):
        log.warning(
            "%s: %.2g %% of the pixels are clipped, so lamps, windows and skies are darker in it "
            "than they were; .hdr and .exr hold them",
            path,
            100 * np.mean(clipped),
        )
    return pixels


def project(pixels: Floats) -> Array:
    """SH light (16, 3) that comes nearest to a panorama: L_k = ∫ E Y_k dω.

    Pixels are (H, W, 3), linear Rec.709 radiance.
    """
    height, width = pixels.shape[:2]
    weights = solid_angles(height, width)
    light = np.zeros((16, 3))
    step = max(1, CHUNK // width)
    for first in range(0, height, step):
        rows = slice(first, first + step)
        basis = sh_basis(directions(height, width, rows))
        weighted = pixels[rows] * weights[rows, None, None]
        light += np.tensordot(basis, weighted, axes=((0, 1), (0, 1)))
    return light


def radiance(coefficients: ArrayLike, height: int) -> Array:
    """An SH light (16, 3) as a panorama (height, 2 height, 3); it may be negative in places."""
    return np.asarray(sh_basis(directions(height, 2 * height)) @ np.asarray(coefficients))


def darkest(coefficients: ArrayLike) -> float:
    """Smallest radiance of an SH light over all directions and channels; below 0 it rings."""
    return float(radiance(coefficients, DARKEST_HEIGHT).min())


DARKEST_HEIGHT = 64
"""Rows of the panorama that negative light is looked for in; l = 3 has no detail finer than 20."""


def nonnegative(coefficients: ArrayLike) -> Array:
    """SH light (16, 3) damped until it is nowhere negative; the mean light stays.

    A lamp cut off at l = 3 is surrounded by rings, negative ones among them. Band l is divided by
    1 + λ l² (l+1)², with the smallest λ that leaves no direction and no channel negative.

    Source: P.-P. Sloan, "Stupid Spherical Harmonics (SH) Tricks", 2008; the factors come of
    penalising the square of the Laplacian.
    """
    light = np.asarray(coefficients, dtype=np.float64)
    bands = (BAND_OF * (BAND_OF + 1.0)) ** 2

    def damped(strength: float) -> Array:
        return np.asarray(light / (1 + strength * bands)[:, None])

    mean = light[0].max(initial=0.0)
    if darkest(light) >= 0 or mean == 0:
        return light
    # Strengths on a logarithmic scale: at the upper end only the mean light is left.
    low, high = -6.0, 12.0
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (low, middle) if darkest(damped(10**middle)) >= 0 else (middle, high)
    return damped(10**high)
