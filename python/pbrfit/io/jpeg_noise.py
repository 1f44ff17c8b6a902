"""What JPEG did to the samples of a picture: variances of its blocks, from its own tables.

A JPEG file holds, for each component (Y, Cb, Cr) and block of 8 × 8 samples, the coefficients c_k
of an orthonormal cosine transform, rounded to multiples n_k q_k of the steps in its tables (ITU-T
T.81, A.3). The transform keeps lengths, so the mean over k of the coefficients' error variances is
that of the block's samples.

**Errors.** Coefficient k of block b is Laplacian, with the density exp(−|c| / β) / 2β, β = s_b g_k
(E. Y. Lam and J. W. Goodman, "A mathematical analysis of the DCT coefficient distributions for
images", IEEE Trans. Image Process. 9, 2000). The scales s of blocks and g of frequencies are found
in turn, each the mean of |c| over the other, where c is the mean of its density inside the bin that
it was rounded to (expectation maximisation). With u = q/β,

    n = 0:  E c² = 2β² − (q²/4 + qβ) e / (1 − e),  e = exp(−u/2);      u → 0: q²/12
    n ≠ 0:  E (c − nq)² = 2β² + q²/4 − qβ coth(u/2);                    u → 0: q²/12

The second is the variance q²/12 of M. A. Robertson and R. L. Stevenson ("DCT quantization noise in
compressed images", IEEE Trans. Circuits Syst. Video Technol. 15, 2005) and the square of the bias
that the slope of the density makes. The first coefficient has a flat density and q²/12. Two
roundings to integers, before the transform and after the inverse one, add 1/12 each.

**Chroma at half resolution** lacks the octave above its own. The power of natural pictures falls
with the square of the frequency (D. J. Field, J. Opt. Soc. Am. A 4, 1987), so that every octave has
the energy of the one below it, which is the upper half of the stored block.

**Pictures of one view** have most coefficients in common but for a factor. So what was rounded to
0, or lost with the resolution of chroma, is lost in all of them alike (`SHARED_ZERO`,
`SHARED_LOSS`), and the mean over pictures has it still. What rounding left of other coefficients is
independent.
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

SAMPLE_BLOCKS = 1024
"""Blocks that the scales of frequencies are found from, spread over the picture."""

ROUNDS, BLOCK_ROUNDS = 40, 6
"""Steps of the expectation maximisation, on those blocks, and of the scales of all others after it:
twice as many change deviations by less than 2 %."""

_CHUNK = 1 << 14  # blocks that are looked at together

YCC_TO_RGB = np.array([[1, 0, 1.402], [1, -0.344136, -0.714136], [1, 1.772, 0]])
"""JFIF 1.02."""


@dataclass(frozen=True, eq=False)
class Tables:
    """How a JPEG file was quantised."""

    steps: tuple[Array, ...]
    """(8, 8) of each component: q, rows are vertical frequencies."""
    sampling: tuple[tuple[int, int], ...]
    """Of each component: how many rows and columns of the picture one of its samples stands for."""
    transformed: bool
    """Whether three components are Y, Cb, Cr; else they are R, G, B."""

    def in_words(self) -> str:
        """Mean steps and resolution of colour."""
        mean = f"mean quantisation step {self.steps[0].mean():.2g}"
        largest = max(max(of) for of in self.sampling)
        return mean if largest == 1 else f"{mean}, chroma at 1/{largest} resolution"


def read_tables(data: bytes, channels: int) -> Tables | None:
    """The tables of a JPEG file; None if its components are not of 1 or 3 `channels`."""
    from PIL import Image  # here: it takes longer to import than most of this package

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about damage, which the decoder judges
        try:
            picture: Any = Image.open(io.BytesIO(data), formats=("JPEG",))
            layers = [tuple(map(int, layer[1:4])) for layer in picture.layer]
            steps = tuple(
                np.array(picture.quantization[table], dtype=np.float64).reshape(SIDE, SIDE)
                for *_, table in layers
            )
            transformed = picture.info.get("adobe_transform", 1) != 0
        except Exception:  # whatever a damaged header leads to
            return None
    down, across = (max([1, *(layer[axis] for layer in layers)]) for axis in (1, 0))
    if len(layers) != channels or any(down % v or across % h for h, v, _ in layers):
        return None
    sampling = tuple((down // v, across // h) for h, v, _ in layers)
    return Tables(steps, sampling, transformed) if min(s.min() for s in steps) > 0 else None


def block_variances(
    codes: NDArray[np.uint8], tables: Tables, size: tuple[int, int]
) -> tuple[NDArray[np.float32], float]:
    """(rows, columns, 3): variances of R, G and B, in codes, in each block of a decoded picture.

    They are those of means where the picture (H, W, 1 or 3) is averaged down to `size`. Blocks are
    those of the first component. What rounding R, G and B to codes adds is not in them. Beside them
    the mean covariance of the same with another picture of the view.
    """
    grid = tuple(-(-length // SIDE) for length in codes.shape[:2])
    to_rgb = np.ones((3, 1))
    planes = [codes[..., 0].astype(np.float32)]
    if codes.shape[2] == 3:
        to_rgb = YCC_TO_RGB if tables.transformed else np.eye(3)
        to_ycc = np.linalg.inv(to_rgb).astype(np.float32)
        planes = [sum(row[c] * codes[..., c] for c in range(3)) for row in to_ycc]
    found, shared = np.zeros((*grid, 3), dtype=np.float32), 0.0
    for plane, steps, sampling, column in zip(
        planes, tables.steps, tables.sampling, to_rgb.T, strict=True
    ):
        others, zeros, losses = (
            _on_grid(variances, sampling, grid)
            for variances in _of_component(plane, steps, sampling, size)
        )
        of_mean = float(np.square(column).mean())
        shared += of_mean * float(SHARED_ZERO * zeros.mean() + SHARED_LOSS * losses.mean())
        found += (others + zeros + losses)[..., None] * np.square(column).astype(np.float32)
    return found, shared


def _on_grid(
    of_blocks: NDArray[np.float32], sampling: tuple[int, int], grid: tuple[int, ...]
) -> NDArray[np.float32]:
    """Values of a component's blocks at those of the picture."""
    for axis, times in enumerate(sampling):
        of_blocks = np.repeat(of_blocks, times, axis=axis)
    return of_blocks[: grid[0], : grid[1]]


def _of_component(
    plane: NDArray[np.float32], steps: Array, sampling: tuple[int, int], size: tuple[int, int]
) -> NDArray[np.float32]:
    """(3, rows, columns): variances in the blocks of a component.

    Of coefficients that are not 0, of those that are, and of what was lost with the resolution.
    """
    from scipy.fft import dctn

    # What a coefficient's error adds to the variance of a sample, after averaging.
    kept = np.multiply.outer(*(_kept(*of) for of in zip(plane.shape, size, sampling, strict=True)))
    blocks = _blocks(plane, sampling)
    flat, q = blocks.reshape(-1, SIDE, SIDE), steps.ravel()[1:].astype(np.float32)
    counts = np.empty((len(flat), SIDE * SIDE - 1), dtype=np.float32)
    for first in range(0, len(flat), _CHUNK):
        chunk = slice(first, first + _CHUNK)
        coefficients = dctn(flat[chunk], axes=(1, 2), norm="ortho") / steps
        counts[chunk] = np.abs(np.rint(coefficients)).reshape(-1, SIDE * SIDE)[:, 1:]
    found = np.zeros((3, len(flat)), dtype=np.float32)
    found[0] = kept[0, 0] * steps[0, 0] ** 2 / 12 + 2 / 12 * kept.sum()
    if counts.any():
        scale = _scales(counts[:: -(-len(counts) // SAMPLE_BLOCKS)], q)
        gains = kept.ravel()[1:].astype(np.float32)
        upper = np.zeros((SIDE, SIDE), np.float32)
        for axis, times in enumerate(sampling):
            halves = np.moveaxis(upper, axis, 0)
            halves[SIDE // 2 :] = np.maximum(halves[SIDE // 2 :], times.bit_length() - 1)
        lost = (upper * kept[-1, -1]).ravel()[1:].astype(np.float32)
        for first in range(0, len(flat), _CHUNK):
            chunk = slice(first, first + _CHUNK)
            found[:, chunk] += _by_counts(counts[chunk], q, scale, gains, lost)
    return found.reshape(3, *blocks.shape[:2])


def _scales(counts: NDArray[np.float32], q: NDArray[np.float32]) -> NDArray[np.float32]:
    """(63,): g, by expectation maximisation with the blocks' own scales."""
    scale = q * (counts.sum(axis=0) + 0.5) / len(counts)
    own = np.ones((len(counts), 1), np.float32)
    for _ in range(ROUNDS):
        sizes = _sizes(counts, q, own * scale)
        own = (sizes / scale).mean(axis=1, keepdims=True)
        scale = (sizes / own).mean(axis=0)
    return np.asarray(scale)


def _sizes(
    counts: NDArray[np.float32], q: NDArray[np.float32], beta: NDArray[np.float32]
) -> NDArray[np.float32]:
    """E |c|, by |n|."""
    u = np.maximum(q / beta, _FLAT)
    zero = 1 / u - 0.5 / np.expm1(np.minimum(u / 2, 80))
    return q * np.where(counts == 0, zero, counts)


def _by_counts(
    counts: NDArray[np.float32],
    q: NDArray[np.float32],
    scale: NDArray[np.float32],
    gains: NDArray[np.float32],
    lost: NDArray[np.float32],
) -> NDArray[np.float32]:
    """(3, blocks): as of `_of_component`, by |n| (blocks, 63) and β (63,)."""
    zero = counts == 0
    own = 1 + (counts * q / scale).mean(axis=1, keepdims=True)
    for _ in range(BLOCK_ROUNDS):
        own = (_sizes(counts, q, own * scale) / scale).mean(axis=1, keepdims=True)
    of_zero, inside = _squares(q / (own * scale))
    of_zero *= q**2
    of_zeros = np.where(zero, of_zero, 0.0)
    energy = np.where(zero, of_zero, np.square(counts * q))
    others = np.where(zero, 0.0, inside) * q**2
    sums = (_product(others, gains), _product(of_zeros, gains), _product(energy, lost))
    return np.stack(sums).astype(np.float32)


def _product(of_blocks: NDArray[Any], weights: NDArray[Any]) -> Array:
    """Sums over coefficients without BLAS, whose bits differ from machine to machine."""
    return np.asarray(np.einsum("bk,k->b", of_blocks, weights))


_FLAT = 1e-2
"""u below which densities are flat inside their bin to better than u/5, and the formulas below lose
their digits."""


def _squares(u: NDArray[np.float32]) -> tuple[Array, Array]:
    """E c² / q² for n = 0, and E (c − nq)² / q² for others; in doubles, for 2/u² cancels."""
    flat, u = u < _FLAT, np.maximum(u, _FLAT, dtype=np.float64)
    e = np.exp(-np.minimum(u / 2, 80))
    zero = 2 / u**2 - (0.25 + 1 / u) * e / (1 - e)
    inside = 2 / u**2 + 0.25 - (1 + e**2) / (u * (1 - e**2))
    return np.where(flat, 1 / 12, zero), np.where(flat, 1 / 12, inside)


def _blocks(plane: NDArray[np.float32], sampling: tuple[int, int]) -> NDArray[np.float32]:
    """(rows, columns, 8, 8) of the component's own samples less 128, continued at the border."""
    multiple = [SIDE * times for times in sampling]
    pad = [(0, -length % of) for length, of in zip(plane.shape, multiple, strict=True)]
    plane = np.pad(plane, pad, mode="edge") - np.float32(128)
    (down, across), (height, width) = sampling, plane.shape
    if max(sampling) > 1:
        plane = plane.reshape(height // down, down, width // across, across).mean(axis=(1, 3))
    height, width = plane.shape
    return plane.reshape(height // SIDE, SIDE, width // SIDE, SIDE).swapaxes(1, 2)


def _kept(length: int, small: int, times: int) -> Array:
    """(8,): of the variance 1 of each frequency's coefficient, what a sample has, averaged down.

    The mean over samples Σ_x a_x φ(x) of new ones with shares a, for the functions φ of all blocks:
    1/8 where nothing is averaged.
    """
    if length == small:
        return np.full(SIDE, 1 / SIDE)
    from scipy.sparse import csr_array

    x = np.arange(SIDE)
    basis = np.cos(np.pi * np.outer(x, x + 0.5) / SIDE) * np.sqrt(2 / SIDE)
    basis[0] = np.sqrt(1 / SIDE)
    parts = area_shares(length, small)
    block, within = np.divmod(np.arange(length) // times, SIDE)
    found = np.empty(SIDE)
    for k in range(SIDE):
        # Samples of one block add up before they are squared.
        of_blocks = csr_array((basis[k, within], (np.arange(length), block)))
        found[k] = (parts @ of_blocks).power(2).sum() / small
    return found
