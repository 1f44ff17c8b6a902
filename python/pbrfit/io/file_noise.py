"""What files did to their samples: standard deviations of quantisation, in linear radiance.

A code is the true one rounded, off by 1/√12 (uniform error), or more where a JPEG's coefficients
were rounded. The slope of the decoding curve turns deviations of codes into those of radiance, and
a matrix M, squared entry by entry, variances into those of its colours, as if channels were
independent. A mean of samples with shares s_i and independent errors has Σ s_i² of the variance.

A JPEG file holds, for each component (Y, Cb, Cr) and block of 8 × 8 samples, the coefficients c_k
of an orthonormal cosine transform, rounded to multiples of the steps q_k in its tables (ITU-T T.81,
A.3). The transform keeps lengths: the error variance of samples is the mean of the coefficients'.

**Coefficients** rounded to n ≠ 0, and the first one of a block, are off by q²/12; those rounded to
0 are off by themselves. Their density is Laplacian, exp(−|c| / β) / 2β (E. Y. Lam and J. W.
Goodman, "A mathematical analysis of the DCT coefficient distributions for images", IEEE Trans.
Image Process. 9, 2000), with β = s / |k|² at the frequency k = (k_y, k_x), as of a smooth function
whose slope has kinks: the transform continues a block as mirrors do. With u = q/β, e = exp(−u/2)

    coefficients of a block that are not 0:  m + ½ = Σ_k e_k, which tells its s;
    those that are:  E c² = q² (2/u² − (1/4 + 1/u) e / (1 − e));  u → 0: q²/12.

Where m = 0 the sum is n₁/n₀, at most ½, by the numbers of blocks with m = 1 and 0: its mean there
(H. Robbins, "An empirical Bayes approach to statistics", Proc. 3rd Berkeley Symp., 1956).
Two roundings to integers, before the transform and after the inverse one, add 1/12 each.

**Chroma at half resolution** lacks the octave above its own. The power of natural pictures falls
with the square of the frequency (D. J. Field, J. Opt. Soc. Am. A 4, 1987), so every octave has the
energy of the one below it, which is the upper half of the stored block.

**Pictures of one view** have most coefficients in common but for a factor, so they lose alike what
is rounded to 0, or lost with the resolution of chroma. Other rounding errors are independent.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.io.color import Conversion
from pbrfit.io.exif import without_warnings
from pbrfit.io.resampling import area_shares
from pbrfit.values.arrays import Array, Codes, Floats

SIDE = 8
"""Samples along a block."""

SHARED_ZERO, SHARED_LOSS = 0.4, 0.6
"""Correlation, between two pictures of one view, of the errors of coefficients that are 0, and of
what chroma lost: by six rooms, qualities 50 to 98. In others it is off by up to a third."""

SAMPLED = 32
"""Blocks of the coarsest component, along each side of a picture, that are looked at."""

YCC_TO_RGB = np.array([[1, 0, 1.402], [1, -0.344136, -0.714136], [1, 1.772, 0]])
"""JFIF 1.02."""


@dataclass(frozen=True, eq=False)
class Tables:
    """How a JPEG file was quantised."""

    steps: Array
    """(C, 8, 8) of each component: q, rows are vertical frequencies."""
    sampling: NDArray[np.intp]
    """(C, 2): how many rows and columns of the picture one of a component's samples stands for."""
    to_rgb: Array
    """(3, C): Red, green and blue by components."""


@dataclass(frozen=True, eq=False)
class FileNoise:
    """Of one picture of integers."""

    conversion: Conversion
    levels: int
    """Codes there are: 256 or 65536."""
    variance: Array
    """(3,): of the errors of R, G and B, in codes²."""
    correlation: float
    """Of these errors with those of another picture of the view: 0 for rounding."""

    def deviation(self, pixels: Floats) -> NDArray[np.float32]:
        """Standard deviations of `pixels` (..., 3)."""
        slopes = self.conversion.slopes(pixels, self.levels)
        variance = np.square(slopes) * self.variance.astype(np.float32)
        matrix = self.conversion.matrix
        if matrix is not None:
            variance = variance @ np.square(matrix).T.astype(np.float32)
        return np.asarray(np.sqrt(variance, dtype=np.float32))


@dataclass(frozen=True, eq=False)
class Stored:
    """Samples as a file holds them, from which `FileNoise` is made."""

    codes: NDArray[Any]
    """(H, W, 1 or 3), uint8 or uint16, before they are turned."""
    turned: bool
    """Whether their rows are to be seen as columns."""
    conversion: Conversion
    form: str
    """Name of the format."""
    tables: Tables | None
    """Of a JPEG file."""

    def in_words(self) -> str:
        """The form of the file; of a JPEG file mean steps and resolution of colour."""
        words = f"{8 * self.codes.dtype.itemsize}-bit {self.form}"
        if self.tables is not None:
            words += f", mean quantisation step {self.tables.steps[0].mean():.2g}"
            if (coarsest := self.tables.sampling.max()) > 1:
                words += f", chroma at 1/{coarsest} resolution"
        return words

    def noise(self, size: tuple[int, int]) -> FileNoise:
        """Of the picture averaged down to `size`, (height, width) as it is to be seen."""
        small = size[::-1] if self.turned else size
        rounding = 1 / 12
        for length, to in zip(self.codes.shape, small, strict=False):
            rounding *= float(kept_variance(length, to).sum())
        variance, shared = np.full(3, rounding), 0.0
        if self.tables is not None:
            of_jpeg, shared = jpeg_variance(self.codes, self.tables, small)
            variance += of_jpeg
        levels = int(np.iinfo(self.codes.dtype).max) + 1
        return FileNoise(self.conversion, levels, variance, shared / float(variance.mean()))


def read_tables(data: bytes, channels: int) -> Tables | None:
    """The tables of a JPEG file; None if its components are not of 1 or 3 `channels`."""
    from PIL import Image  # here: it takes longer to import than most of this package

    try:
        with without_warnings():  # about damage, which the decoder judges
            picture: Any = Image.open(io.BytesIO(data), formats=("JPEG",))
        _, across, down, tables = zip(*picture.layer, strict=True)
        steps = np.array([picture.quantization[one] for one in tables], dtype=np.float64)
        factors = np.stack([down, across], axis=1)
        sampling, rest = np.divmod(factors.max(axis=0), factors)
        plain = picture.info.get("adobe_transform", 1) == 0
    except Exception:  # whatever a damaged header leads to
        return None
    if len(steps) != channels or rest.any() or sampling.min() < 1 or steps.min() <= 0:
        return None
    to_rgb = np.ones((3, 1)) if channels == 1 else np.eye(3) if plain else YCC_TO_RGB
    return Tables(steps.reshape(channels, SIDE, SIDE), sampling, to_rgb)


def jpeg_variance(codes: Codes, tables: Tables, size: tuple[int, int]) -> tuple[Array, float]:
    """(3,): variances of R, G and B, in codes², of a decoded picture (H, W, C) averaged to `size`.

    Without the last rounding to codes; and what their mean shares with other pictures' means.
    """
    places, kept = [], []
    for length, small, times in zip(codes.shape[:2], size, tables.sampling.T, strict=True):
        block = SIDE * times.max()
        of_blocks = np.unique(np.linspace(0, (length - 1) // block, SAMPLED).astype(np.intp))
        within = of_blocks[:, None] * block + np.arange(block)
        places.append(np.minimum(within.ravel(), length - 1))
        kept.append([kept_variance(length, small, one) for one in times])
    sampled = codes[np.ix_(*places)]
    if len(tables.steps) == 3:
        red, green, blue = (sampled[..., k].astype(np.float64) for k in range(3))
        rows = np.linalg.inv(tables.to_rgb)
        sampled = np.stack([r * red + g * green + b * blue for r, g, b in rows], axis=-1)
    found = np.zeros((3, 3))
    for c, of in enumerate(zip(tables.steps, tables.sampling, *kept, strict=True)):
        found += np.multiply.outer(np.square(tables.to_rgb[:, c]), _errors(sampled[..., c], *of))
    return found.sum(axis=1), float(found.mean(axis=0) @ [0, SHARED_ZERO, SHARED_LOSS])


def _errors(
    plane: NDArray[Any], q: Array, sampling: NDArray[np.intp], down: Array, across: Array
) -> Array:
    """Variances, (3,), of a component, of whose frequencies `down` and `across` are kept.

    Of coefficients that are not 0, of those that are, and of what was lost with the resolution.
    """
    from scipy.fft import dctn

    height, width = plane.shape // sampling // SIDE
    plane = plane.reshape(height, SIDE, sampling[0], width, SIDE, sampling[1]).mean(axis=(2, 5))
    counts = np.rint(dctn(plane - 128, axes=(1, 3), norm="ortho") / q[:, None]).swapaxes(1, 2)
    counts[..., 0, 0] = 1  # the first one is off by q²/12 always
    y, x = np.indices(q.shape)
    scales = np.geomspace(0.01, 1e9, 2000)[:, None, None]  # from where all are 0 to where none is
    squared = q * (y**2 + x**2)  # u s
    expected = np.exp(-squared / 2 / scales).sum(axis=(1, 2)) - 1
    m = np.count_nonzero(counts, axis=(2, 3)) - 1
    none, one = np.bincount(m.ravel(), minlength=2)[:2] + 0.5
    m = np.where(m == 0, min(one / none, 0.5), m + 0.5)
    own = np.interp(m, expected, scales.ravel())[..., None, None]
    u = np.maximum(squared / own, 0.01)  # below, densities are flat to u/5 and digits cancel
    of_zero = 2 / u**2 - (0.25 + 1 / u) / np.expm1(np.minimum(u / 2, 80))
    of_zero = np.where(counts == 0, of_zero, 0).mean(axis=(0, 1))
    others = (counts != 0).mean(axis=(0, 1)) / 12
    energy = of_zero + np.square(counts).mean(axis=(0, 1))
    octaves = [np.repeat([0, int(times).bit_length() - 1], SIDE // 2) for times in sampling]
    kept = np.multiply.outer(down, across)
    lost = energy * np.maximum.outer(*octaves) * kept[-1, -1]
    found = q**2 * np.stack([others * kept, of_zero * kept, lost])
    found[0] += 2 / 12 * kept
    return np.asarray(found.sum(axis=(1, 2)))


@cache
def kept_variance(length: int, small: int, times: int = 1) -> Array:
    """(8,): the variance of samples by one of 1 of each frequency's coefficients along a side.

    Of means with shares a_x: that of Σ (Σ_x a_x φ_k(x))² over all blocks.
    """
    from scipy.fft import dct
    from scipy.sparse import eye_array, kron

    functions = np.repeat(dct(np.eye(SIDE), norm="ortho"), times, axis=0)
    of_blocks = kron(eye_array(-(-length // len(functions))), functions, format="csr")[:length]
    means = (area_shares(length, small) @ of_blocks).power(2).sum(axis=0) / small
    return np.asarray(means.reshape(-1, SIDE).sum(axis=0))
