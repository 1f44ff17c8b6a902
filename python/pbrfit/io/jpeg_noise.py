"""What JPEG did to the samples of a picture: variances of its blocks, from its own tables.

A JPEG file holds, for each component (Y, Cb, Cr) and block of 8 × 8 samples, the coefficients c_k
of an orthonormal cosine transform, rounded to multiples n_k q_k of the steps in its tables (ITU-T
T.81, A.3). The transform keeps lengths, so the mean over k of the coefficients' error variances is
that of the block's samples.

**Model.** Coefficients of natural pictures are Laplacian where a picture is alike everywhere (E. Y.
Lam and J. W. Goodman, "A mathematical analysis of the DCT coefficient distributions for images",
IEEE Trans. Image Process. 9, 2000), by their argument since blocks have different variances. Here
both are kept apart: coefficient k of block b has the density exp(−|c| / β) / 2β with β = s_b g_k,
a scale s of the block, one of a few levels with unknown shares π, and a scale g of the frequency.
With u = q/β, a coefficient is rounded to

    n = 0  with  1 − exp(−u/2),      n ≠ 0  with  exp(−u (|n| − ½)) (1 − exp(−u)) / 2.

π and g are those of largest likelihood (expectation maximisation), g with the weight of
`PRIOR_BLOCKS` blocks drawn to a power law of the frequency, for where all coefficients are 0.

**Errors.** Given β and n, c is distributed as its density inside the bin:

    n = 0:  E c² = 2β² − (q²/4 + qβ) e / (1 − e),  e = exp(−u/2);      u → 0: q²/12
    n ≠ 0:  E (c − nq)² = 2β² + q²/4 − qβ coth(u/2);                     u → 0: q²/12

The second is the variance q²/12 of M. A. Robertson and R. L. Stevenson ("DCT quantization noise in
compressed images", IEEE Trans. Circuits Syst. Video Technol. 15, 2005) and the square of the bias
that the slope of the density makes. The first coefficient has a flat density and q²/12. Both are
averaged over the levels that block b may have. Two roundings to integers, before the transform and
after the inverse one, add 1/12 each.

**Chroma at half resolution** was averaged over pairs of samples and is interpolated by (3, 1)/4.
With ω = π u / 8 for frequency u, an amplitude A is stored as p A, p = cos(ω/4), and with it the
aliased one of frequency 2π − ω, times sin(ω/4). By a power that falls with the square of the
frequency that has the energy a A², a = (ω / (2π − ω))². So what is stored has
E c² = (p² + a (1 − p²)) A². It comes back times G = ¾ exp(iω/4) + ¼ exp(−3iω/4): errors of
coefficients count |G|², and lost is |p G − 1|² A² + |G|² a (1 − p²) A². What lies beyond the stored
frequencies is lost as a whole: by a power law g ∝ f^−γ an octave has 2^(2 − 2γ) times the energy of
the one below it, which is the upper half of the stored block. The loss is shared among the blocks
of luma under a block of chroma by the variance that luma has in them, and is correlated between Cb
and Cr as their slopes are.

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

LEVELS = 2.0 ** np.arange(-6, 6)
"""Scales that blocks can have, beside those of frequencies: from flat ones to edges."""

PRIOR_BLOCKS = 4.0
"""Blocks that the power law of the frequencies counts as much as: few beside those of any picture,
and enough where a frequency is 0 in all of them."""

NATURAL_EXPONENT = 1.0
"""γ of natural pictures, whose power falls with the square of the frequency (D. J. Field, J. Opt.
Soc. Am. A 4, 1987): what a picture's own γ is drawn to with the weight of `PRIOR_BLOCKS`."""

SAMPLE_BLOCKS = 4096
"""Blocks that the model is fitted to, spread over the picture: its few numbers are then known to a
few per cent."""

ROUNDS = 20
"""Steps of the expectation maximisation; ten more change deviations by less than 1 %."""

SHARED_ZERO, SHARED_LOSS = 0.4, 0.6
"""Correlation, between two pictures of one view, of the errors of coefficients that are 0, and of
what chroma lost. Coefficients themselves have 0.8 in rooms under different lights; of those that
are 0 in one picture half of the energy is in such as are not 0 in another. By six rooms, qualities
50 to 98; in others the correlation that follows from them is off by up to a third."""

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
        rgb = [codes[..., c].astype(np.float32) for c in range(3)]
        planes = [row[0] * rgb[0] + row[1] * rgb[1] + row[2] * rgb[2] for row in to_ycc]
        del rgb
    found = np.zeros((*grid, 3), dtype=np.float32)
    lost, shared = [], 0.0
    for plane, steps, sampling, column in zip(
        planes, tables.steps, tables.sampling, to_rgb.T, strict=True
    ):
        errors, zeros, loss = (
            _on_grid(variances, sampling, grid)
            for variances in _of_component(plane, steps, sampling, size)
        )
        of_mean = float(np.square(column).mean())
        shared += of_mean * (SHARED_ZERO * float(zeros.mean()) + SHARED_LOSS * float(loss.mean()))
        found += errors[..., None] * np.square(column).astype(np.float32)
        if max(sampling) > 1:
            within = _shares_of_activity(planes[0], sampling)[: grid[0], : grid[1]]
            lost.append(column.astype(np.float32) * np.sqrt(within * loss)[..., None])
    for of_component in lost:
        found += np.square(of_component)
    if len(lost) == 2:
        found += 2 * _correlation(planes[1], planes[2]) * lost[0] * lost[1]
    return found, shared


def _on_grid(
    of_blocks: NDArray[np.float32], sampling: tuple[int, int], grid: tuple[int, ...]
) -> NDArray[np.float32]:
    """Values of a component's blocks at those of the picture."""
    for axis, times in enumerate(sampling):
        of_blocks = np.repeat(of_blocks, times, axis=axis)
    return of_blocks[: grid[0], : grid[1]]


def _shares_of_activity(
    luma: NDArray[np.float32], sampling: tuple[int, int]
) -> NDArray[np.float32]:
    """(rows, columns): variances of luma in blocks, over the mean of those that share a block.

    Chroma has its edges where luma has. 1 where luma is flat.
    """
    multiple = [SIDE * times for times in sampling]
    pad = [(0, -length % of) for length, of in zip(luma.shape, multiple, strict=True)]
    activity = _blocks(np.pad(luma, pad, mode="edge"), (1, 1)).var(axis=(2, 3)) + np.float32(1)
    (down, across), (rows, columns) = sampling, activity.shape
    mean = activity.reshape(rows // down, down, columns // across, across).mean(axis=(1, 3))
    return np.asarray(activity / _on_grid(mean, sampling, activity.shape))


def _correlation(one: NDArray[np.float32], other: NDArray[np.float32]) -> float:
    """Of the slopes of two planes."""
    products = np.zeros(3)
    for axis in (0, 1):
        a, b = (np.diff(plane, axis=axis).ravel() for plane in (one, other))
        products += [np.sum(p * q, dtype=np.float64) for p, q in ((a, b), (a, a), (b, b))]
    size = float(np.sqrt(products[1] * products[2]))
    return float(products[0]) / size if size > 0 else 0.0


def _of_component(
    plane: NDArray[np.float32], steps: Array, sampling: tuple[int, int], size: tuple[int, int]
) -> list[NDArray[np.float32]]:
    """(rows, columns) each: variances in the blocks of a component.

    Of its errors, of those of coefficients that are 0 alone, and of what was lost.
    """
    from scipy.fft import dctn

    gains = [
        _kept(length, small, times)
        for length, small, times in zip(plane.shape, size, sampling, strict=True)
    ]
    axes = [_Axis(times) for times in sampling]
    blocks = _blocks(plane, sampling)
    rows, columns = blocks.shape[:2]
    flat = blocks.reshape(-1, SIDE, SIDE)
    seen = steps * np.multiply.outer(axes[0].seen, axes[1].seen)
    counts = np.empty((len(flat), SIDE * SIDE - 1), dtype=np.float32)
    for first in range(0, len(flat), _CHUNK):
        chunk = slice(first, first + _CHUNK)
        coefficients = dctn(flat[chunk], axes=(1, 2), norm="ortho") / seen
        counts[chunk] = np.abs(np.rint(coefficients)).reshape(-1, SIDE * SIDE)[:, 1:]
    # What each coefficient's error, its own energy and the lost octaves add to the variance of a
    # sample, each after averaging.
    kept = np.multiply.outer(*gains)
    errors = kept * np.multiply.outer(axes[0].energy, axes[1].energy)
    constant = errors[0, 0] * steps[0, 0] ** 2 / 12 + 2 / 12 * float(kept.sum())
    model = _Model.fitted(counts, steps.ravel()[1:])
    if model is None:
        nothing = np.zeros((rows, columns), dtype=np.float32)
        return [nothing + np.float32(constant), nothing, nothing]
    aliased = np.multiply.outer(axes[0].stored, axes[1].stored)
    stored = aliased.copy()
    aliased -= np.multiply.outer(axes[0].passed, axes[1].passed) ** 2
    back = np.abs(np.multiply.outer(axes[0].back, axes[1].back) - 1) ** 2
    losses = kept * back + errors * aliased
    upper = np.zeros((SIDE, SIDE))
    octaves = 0.0
    for axis, times in enumerate(sampling):
        if times > 1:
            half = [slice(None), slice(None)]
            half[axis] = slice(SIDE // 2, None)
            upper[tuple(half)] = 1
            octaves = max(octaves, sum(model.octave**k for k in range(1, times.bit_length())))
    losses += octaves * upper * kept[-1, -1]
    losses /= stored
    parts = np.stack([errors.ravel()[1:], losses.ravel()[1:]])
    found = np.empty((3, len(flat)), dtype=np.float32)
    for first in range(0, len(flat), _CHUNK):
        chunk = slice(first, first + _CHUNK)
        found[:, chunk] = model.variances(counts[chunk], *parts)
    found[0] += np.float32(constant)
    return [each.reshape(rows, columns) for each in found]


class _Axis:
    """What happens to the 8 frequencies of a component along one axis of the picture."""

    def __init__(self, times: int) -> None:
        omega = np.pi * np.arange(SIDE) / SIDE
        whole = np.ones(SIDE)
        self.passed, self.stored, self.energy, self.seen = whole, whole, whole, whole
        self.back = whole + 0j
        if times > 1:
            gain = 0.75 * np.exp(0.25j * omega) + 0.25 * np.exp(-0.75j * omega)
            self.passed = np.cos(omega / 4)
            alias = (omega / (2 * np.pi - omega)) ** 2
            self.stored = self.passed**2 + alias * np.sin(omega / 4) ** 2
            self.back = self.passed * gain
            self.energy = np.abs(gain) ** 2
            self.seen = 0.75 + 0.25 * np.cos(omega)  # of interpolated samples averaged again


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


@dataclass(frozen=True, eq=False)
class _Model:
    """Scales of the coefficients of a component, without the first."""

    steps: Array
    """(63,): q."""
    scales: Array
    """(63,): g."""
    shares: Array
    """(levels,): π."""
    exponent: float
    """γ."""

    @property
    def octave(self) -> float:
        """Energy of an octave as a multiple of that of the one below."""
        return float(2 ** (2 - 2 * self.exponent))

    @classmethod
    def fitted(cls, counts: NDArray[np.float32], steps: Array) -> _Model | None:
        """Of |n| (blocks, 63); None where all are 0, which tells nothing."""
        total = counts.sum(axis=0, dtype=np.float64)
        if not total.any():
            return None
        used = counts[:: -(-len(counts) // SAMPLE_BLOCKS)]
        rows, columns = np.divmod(np.arange(1, SIDE * SIDE), SIDE)
        log_frequency = np.log(np.hypot(rows, columns))
        other, sums = np.count_nonzero(used, axis=0).astype(np.float64), used.sum(axis=0)
        scales = steps * (sums + 0.5) / len(used)
        law, exponent = _power_law(log_frequency, scales, other)
        found = cls(steps, np.where(other > 0, scales, law), _equal_shares(), exponent)
        for _ in range(ROUNDS):
            posterior = found._posterior(used)
            zero, inside = _means(found._u)
            blocks = posterior.sum(axis=0)[:, None]
            n_other = _product(posterior.T, used > 0)
            n_sum = _product(posterior.T, used)
            sizes = (blocks - n_other) * zero + n_sum - n_other / 2 + n_other * inside
            sums = (sizes * steps / LEVELS[:, None]).sum(axis=0)
            law, exponent = _power_law(log_frequency, found.scales, other)
            scales = (sums + PRIOR_BLOCKS * law) / (len(used) + PRIOR_BLOCKS)
            found = cls(steps, scales, posterior.mean(axis=0), exponent)
        return found

    @property
    def _u(self) -> Array:
        """(levels, 63)."""
        return self.steps / (LEVELS[:, None] * self.scales)

    def _posterior(self, counts: NDArray[np.float32]) -> Array:
        """(blocks, levels): how probable it is that a block has each."""
        half = -self._u / 2
        zero = np.log(-np.expm1(half))
        other = np.log(-np.expm1(2 * half)) - half - np.log(2)
        log = np.log(np.maximum(self.shares, 1e-12)) + zero.sum(axis=1)
        log = log + _product(counts > 0, (other - zero).T) + _product(counts, 2 * half.T)
        log -= log.max(axis=1, keepdims=True)
        found = np.exp(log)
        return np.asarray(found / found.sum(axis=1, keepdims=True))

    def variances(
        self, counts: NDArray[np.float32], errors: Array, losses: Array
    ) -> tuple[Array, Array, Array]:
        """(blocks,) each: Σ_k of E (c − nq)² times `errors`, n = 0 alone, and E c² by `losses`."""
        posterior, other = self._posterior(counts), counts > 0
        zero, inside = (squares * self.steps**2 for squares in _squares(self._u))

        def of_zeros(weights: Array) -> Array:
            parts = weights * zero
            of_levels = parts.sum(axis=1) - _product(other, parts.T)
            return np.asarray((posterior * of_levels).sum(axis=1))

        zeros = of_zeros(errors)
        found = zeros + (posterior * _product(other, (errors * inside).T)).sum(axis=1)
        if not losses.any():
            return found, zeros, np.zeros_like(found)
        stored = _product(np.square(counts), (losses * self.steps**2)[:, None])[:, 0]
        return found, zeros, of_zeros(losses) + stored


def _equal_shares() -> Array:
    return np.full(len(LEVELS), 1 / len(LEVELS))


def _product(left: NDArray[Any], right: NDArray[Any]) -> Array:
    """Matrix product without BLAS, whose bits differ from machine to machine."""
    return np.asarray(np.einsum("ij,jk->ik", left.astype(np.float64), right.astype(np.float64)))


def _power_law(log_frequency: Array, scales: Array, weights: Array) -> tuple[Array, float]:
    """A law a f^−γ for scales (63,), by least squares of logarithms with these weights, and γ."""
    log = np.log(scales)
    total = weights.sum()
    mean_x, mean_y = (weights * log_frequency).sum() / total, (weights * log).sum() / total
    x = log_frequency - mean_x
    spread = (weights * x * x).sum() + PRIOR_BLOCKS
    slope = (weights * x * (log - mean_y)).sum()
    exponent = float((PRIOR_BLOCKS * NATURAL_EXPONENT - slope) / spread)
    return np.exp(mean_y - exponent * x), exponent


_FLAT = 1e-3
"""u below which densities are flat inside their bin to better than u/5, and the formulas below lose
their digits."""


def _means(u: Array) -> tuple[Array, Array]:
    """E |c| / q for n = 0, and E |c| / q − (|n| − ½) for others."""
    flat, u = u < _FLAT, np.maximum(u, _FLAT)
    half = u / 2
    zero = 1 / u - 0.5 / np.expm1(np.minimum(half, 700))
    inside = 1 / u - 1 / np.expm1(np.minimum(u, 700))
    return np.where(flat, 0.25, zero), np.where(flat, 0.5, inside)


def _squares(u: Array) -> tuple[Array, Array]:
    """E c² / q² for n = 0, and E (c − nq)² / q² for others."""
    flat, u = u < _FLAT, np.maximum(u, _FLAT)
    zero = 2 / u**2 - (0.25 + 1 / u) / np.expm1(np.minimum(u / 2, 700))
    inside = 2 / u**2 + 0.25 - 1 / (u * np.tanh(u / 2))
    return np.where(flat, 1 / 12, zero), np.where(flat, 1 / 12, inside)
