"""What JPEG did to the samples of a picture: its variance, by the file's own tables.

A JPEG file holds, for each component (Y, Cb, Cr) and block of 8 × 8 samples, the coefficients c_k
of an orthonormal cosine transform, rounded to multiples of the steps q_k in its tables (ITU-T T.81,
A.3). It keeps lengths: samples are off by the mean over k of what coefficients are off by.

**A coefficient** that is rounded to n ≠ 0, and the first one, is off by q²/12; one that is rounded
to 0 is off by itself. Its density is Laplacian, exp(−|c| / β) / 2β (E. Y. Lam and J. W. Goodman, "A
mathematical analysis of the DCT coefficient distributions for images", IEEE Trans. Image Process.
9, 2000), with β = s / |k|² for the frequency k = (k_y, k_x): the transform continues a block as in
a mirror, so that what is smooth has kinks in its slope. With u = q/β and e = exp(−u/2),

    of a block are not 0:  Σ_k e_k, which tells s from their number m, as m + ½
    of those that are 0:  E c² = q² (2/u² − (1/4 + 1/u) e / (1 − e));    u → 0: q²/12

Two roundings to integers, before the transform and after the inverse one, add 1/12 each.

**Chroma at half resolution** lacks the octave above its own. The power of natural pictures falls
with the square of the frequency (D. J. Field, J. Opt. Soc. Am. A 4, 1987), so that every octave has
the energy of the one below it, which is the upper half of the stored block.

**Pictures of one view** have most coefficients in common but for a factor. So what was rounded to
0, or lost with the resolution of chroma, is lost in all of them alike, and the mean over pictures
has it still. What rounding left of other coefficients is independent.
"""

from __future__ import annotations

import io
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.io.resampling import area_shares

Array = NDArray[np.float64]

SIDE = 8
"""Samples along a block."""

SHARED_ZERO, SHARED_LOSS = 0.4, 0.6
"""Correlation, between two pictures of one view, of the errors of coefficients that are 0, and of
what chroma lost. Coefficients themselves have 0.8 in rooms under different lights; of those that
are 0 in one picture half of the energy is in such as are not 0 in another. By six rooms, qualities
50 to 98; in others the correlation that follows from them is off by up to a third."""

SAMPLED = 32
"""Places along each side of a picture whose blocks are looked at, at most."""

YCC_TO_RGB = np.array([[1, 0, 1.402], [1, -0.344136, -0.714136], [1, 1.772, 0]])
"""JFIF 1.02."""


@dataclass(frozen=True, eq=False)
class Tables:
    """How a JPEG file was quantised."""

    steps: tuple[Array, ...]
    """(8, 8) of each component: q, rows are vertical frequencies."""
    sampling: NDArray[np.intp]
    """(1 or 3, 2): how many rows and columns of the picture a component's sample stands for."""
    to_rgb: Array
    """(3, 3) from Y, Cb, Cr, or whatever else the components are; (3, 1) from grey."""

    def in_words(self) -> str:
        """Mean steps and resolution of colour."""
        mean = f", mean quantisation step {self.steps[0].mean():.2g}"
        largest = np.max(self.sampling)
        return mean if largest == 1 else f"{mean}, chroma at 1/{largest} resolution"


def read_tables(data: bytes, channels: int) -> Tables | None:
    """The tables of a JPEG file; None if its components are not of 1 or 3 `channels`."""
    from PIL import Image  # here: it takes longer to import than most of this package

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about damage, which the decoder judges
        try:
            picture: Any = Image.open(io.BytesIO(data), formats=("JPEG",))
            _, across, down, tables = zip(*picture.layer, strict=True)
            steps = tuple(
                np.array(picture.quantization[one], dtype=np.float64).reshape(SIDE, SIDE)
                for one in tables
            )
            plain = picture.info.get("adobe_transform", 1) == 0
            factors = np.stack([down, across], axis=1)
            sampling, rest = np.divmod(factors.max(axis=0), factors)
        except Exception:  # whatever a damaged header leads to
            return None
    if len(steps) != channels or rest.any() or sampling.min() < 1 or np.min(steps) <= 0:
        return None
    to_rgb = np.ones((3, 1)) if channels == 1 else np.eye(3) if plain else YCC_TO_RGB
    return Tables(steps, sampling, to_rgb)


def jpeg_variance(
    codes: NDArray[np.uint8], tables: Tables, size: tuple[int, int]
) -> tuple[Array, float]:
    """(3,): variances of R, G and B, in codes², of a decoded picture (H, W, 1 or 3).

    They are those of means where the picture is averaged down to `size`. What rounding R, G and B
    to codes adds is not in them. Beside them, in the mean: their covariance with another
    picture of the view.
    """
    of_axes = list(zip(codes.shape[:2], size, tables.sampling.T, strict=True))
    places = [_places(length, SIDE * int(times.max())) for length, _, times in of_axes]
    sampled = codes[np.ix_(*places)]
    if sampled.shape[2] == 3:
        sampled = np.einsum("hwc,kc->hwk", sampled, np.linalg.inv(tables.to_rgb))
    found, shared = np.zeros(3), 0.0
    for c, steps in enumerate(tables.steps):
        shares = [kept(length, to, int(times[c])) for length, to, times in of_axes]
        others, zeros, lost = _of_component(sampled[..., c], steps, tables.sampling[c], shares)
        to_rgb = np.square(tables.to_rgb[:, c])
        found += (others + zeros + lost) * to_rgb
        shared += (SHARED_ZERO * zeros + SHARED_LOSS * lost) * to_rgb.mean()
    return found, shared


def _places(length: int, block: int) -> NDArray[np.intp]:
    """Of whole blocks spread over a side, which is continued at its end."""
    of_blocks = np.linspace(0, (length - 1) // block, SAMPLED).round().astype(np.intp)
    places = np.unique(of_blocks)[:, None] * block + np.arange(block)
    return np.minimum(places.ravel(), length - 1)


def _of_component(
    plane: NDArray[Any], steps: Array, sampling: NDArray[np.intp], shares: list[Array]
) -> tuple[float, float, float]:
    """Variances of a sample, by `shares` of those of vertical and of horizontal coefficients.

    By coefficients that are not 0, by those that are, and by what was lost with the resolution.
    """
    from scipy.fft import dctn

    height, width = plane.shape // sampling // SIDE
    plane = plane.reshape(height, SIDE, sampling[0], width, SIDE, sampling[1]).mean(axis=(2, 5))
    found = np.rint(dctn(plane - 128, axes=(1, 3), norm="ortho") / steps[:, None])
    counts = found.swapaxes(1, 2).reshape(-1, SIDE**2)[:, 1:]
    zero = counts == 0
    y, x = np.indices(steps.shape)
    halves = (steps * (y**2 + x**2) / 2).ravel()[1:]  # u/2 is this over s
    scales = np.geomspace(halves.min() / 10, halves.max() * 100, 1000)
    expected = np.exp(-halves / scales[:, None]).sum(axis=1)
    own = np.interp(np.count_nonzero(counts, axis=1) + 0.5, expected, scales)
    u = np.maximum(2 * halves / own[:, None], 1e-2)  # where it is flat to u/5, and digits are left
    of_zeros = 2 / u**2 - (0.25 + 1 / u) / np.expm1(np.minimum(u / 2, 80))

    of_zeros = (zero * of_zeros).mean(axis=0) * steps.ravel()[1:] ** 2
    of_others = (steps**2).ravel() / 12 * np.append(1, 1 - zero.mean(axis=0))
    kept_shares = np.multiply.outer(*shares).ravel()
    energy = of_zeros + np.square(counts).mean(axis=0) * steps.ravel()[1:] ** 2
    octaves = [np.where(np.arange(SIDE) < 4, 0, int(times).bit_length() - 1) for times in sampling]
    upper = np.maximum.outer(*octaves).ravel()[1:]
    return (
        float(of_others @ kept_shares + 2 / 12 * kept_shares.sum()),
        float(of_zeros @ kept_shares[1:]),
        float(energy @ upper * kept_shares[-1]),
    )


def kept(length: int, small: int, times: int) -> Array:
    """(8,): the variance of a sample, by a variance of 1 of each frequency's coefficient.

    Of a sample averaged down, with shares a_x: the mean of Σ (Σ_x a_x φ_k(x))² over all blocks.
    """
    from scipy.fft import dct
    from scipy.sparse import eye_array, kron

    functions = np.repeat(dct(np.eye(SIDE), axis=0, norm="ortho").T, times, axis=0)
    of_blocks = kron(eye_array(-(-length // len(functions))), functions, format="csr")[:length]
    means = (area_shares(length, small) @ of_blocks).power(2).sum(axis=0) / small
    return np.asarray(means.reshape(-1, SIDE).sum(axis=0))
