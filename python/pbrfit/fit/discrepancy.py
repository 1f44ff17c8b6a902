"""How far samples are off in a pixel's likelihood: by noise, and by what the model has not.

Where pictures are the model and noise, a fit leaves noise, and nothing that neighbours share.
Errors of the model (shadows, bounces, wrong normals, another field of view, another reflection) are
smooth. Lights and materials take up what of them they can, and what is left says how much that was.
With residuals r of pixels p and q that lie a sixteenth of the picture apart on one segment,

    c² = mean of Σ ω r_p ω r_q / Σ ω, less three times its standard error, or 0

is the variance that such pixels share. A pixel's samples then are as uncertain as

    v = 3 s² + (G c)²        G c no more than half the mean radiance

s² is the variance of residuals by their degrees of freedom. It counts thrice because the same
samples have told lights, prior and pixel. G is how much more of an error is taken up
than left: one figure for all scenes and errors, measured where truth is known
(`MISFIT_AMPLIFICATION`). An error that is taken up whole leaves no trace and is in no deviation.

Where pictures show no more numbers of a pixel than there are unknowns (`independent_lights`),
nothing can be left of samples, and they are as uncertain as they can be.

Of what lights may do, `light_share` is the ratio φ of the variance that they add to a pixel's
roughness and metallic to what its own samples leave; it is common to all pixels
(`pbrfit.fit.priors.posterior`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import misfit, settings
from pbrfit.fit.independent_lights import Shown
from pbrfit.fit.normal_equations import inverted, known_materials
from pbrfit.fit.objective import Objective
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.fit.pixels import fit_level
from pbrfit.fit.priors.population import METALLIC_DEVIATION, ROUGHNESS_DEVIATION
from pbrfit.fit.priors.posterior import Pooling
from pbrfit.fit.sampling import Pixels, evenly_spaced, pairs_apart, pixel_index
from pbrfit.values.arrays import Array


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """Of a scene under some lights, in units of x, for samples of weight 1."""

    variance: float
    """s²."""
    shared: float
    """c: standard deviation that neighbours surely share."""
    modes: Array
    """(R, N, K, C): how lights may move, of noise 1; R is 0 where they are known."""
    light_share: float
    """φ."""
    picture_effect: float = 1.0
    """As of `NoiseModel`."""
    channels: int = 3
    """Of the pictures."""
    shown: Shown | None = None
    uses: float = settings.SAMPLE_USES
    """What the same samples have told: lights, prior and pixel, and normals that were refined."""

    @property
    def misfit(self) -> float:
        """G c: standard deviation of a sample by what the model does not have."""
        largest = settings.MISFIT_SHARE_MAX * settings.MEAN_RADIANCE
        return min(settings.MISFIT_AMPLIFICATION * self.shared, largest)

    @property
    def of_noise(self) -> float:
        """The part of samples: `uses` times s²."""
        return self.uses * self.variance * self.picture_effect

    @property
    def of_pixel(self) -> float:
        """v: the variance in a pixel's likelihood."""
        return self.of_noise + self.misfit**2

    @property
    def effective_share(self) -> float:
        """s²/v: the share of the samples that would say as much if they were independent noise."""
        return self.variance / self.of_pixel

    @property
    def pooling(self) -> Pooling:
        """How much pixels of one material tell together."""
        tempering = self.uses * self.of_pixel / self.of_noise
        return Pooling(self.light_share, tempering, self.channels)

    def in_words(self) -> str:
        """For a stage's note."""
        return (
            f"noise {self.variance**0.5:.2g}, model error {self.misfit:.2g}; "
            f"light share {self.light_share:.2g}"
        )


def find(
    objective: Objective, x: Array, picture_effect: float = 1.0, *, modes: Array | None = None
) -> Discrepancy:
    """From some pixels under the lights of x, each with its best materials.

    `modes` are those of the lights where these are held, though not known, because normals have
    been found by these pictures.
    """
    refined = modes is not None
    pairs = neighbours(objective.layout)
    pixels = np.unique(pairs)
    if not pairs.size:
        pixels = evenly_spaced(objective.pixels, settings.COARSE_PIXELS)
    few, part = objective.restricted(pixels), objective.part_of(x, pixels)
    maps = objective.layout.maps.stop
    unknowns = few.layout.maps.stop + (objective.size - maps) * few.pixels / objective.pixels
    variance = misfit.variance(few, fit_level(few, part), unknowns)
    shown = Shown.by(
        few.pictures(few.everything),
        variance,
        few.sample_weights,
        maps / objective.pixels + 2 * refined,
        (objective.size - maps) / objective.layout.pictures / objective.pixels,
    )
    if shown.is_nothing or objective.samples <= objective.size:
        variance = (settings.MISFIT_SHARE_MAX * settings.MEAN_RADIANCE) ** 2
    shared = _shared(few, part, np.searchsorted(pixels, pairs)) if pairs.size else 0.0
    if modes is None:
        modes = light_modes(few, part, of_pixels=objective.pixels)
    share = _light_share(few, part, variance, modes)
    uses = settings.SAMPLE_USES + 2 * refined
    return Discrepancy(
        variance, shared, modes, share, picture_effect, objective.channels, shown, uses
    )


def neighbours(layout: ParameterLayout) -> Pixels:
    """(2, Q): pairs of pixels of a segment, a sixteenth of the picture apart, evenly spread."""
    step, found = max(1, round(max(layout.valid.shape) / settings.MISFIT_STEPS)), []
    for pairs in pairs_apart(pixel_index(layout.valid), step):
        if layout.segments is not None:
            pairs = pairs[:, np.equal(*layout.segments[pairs])]
        found.append(pairs[:, evenly_spaced(pairs.shape[1], settings.MISFIT_PAIRS)])
    return np.concatenate(found, axis=1).astype(np.uint64)


def _shared(objective: Objective, x: Array, pairs: NDArray[np.intp]) -> float:
    """c, from pairs (2, Q) of the objective's pixels."""
    of_core = objective.problem.residuals(objective.for_core(x), objective.everything)
    residuals = of_core.astype(np.float64)
    weighed = objective.sample_weights
    weights = np.broadcast_to(1.0 if weighed is None else weighed, residuals.shape)
    one, other = pairs
    # A picture that is not of this scene has little weight, but all that is left of it is shared.
    common = weights[:, one] * weights[:, other]
    products = (common * residuals[:, one] * residuals[:, other]).sum(axis=(0, 2))
    if len(products) < 2:
        return 0.0
    # Each pixel is in two pairs or so, which are not independent.
    error = float(products.std()) / np.sqrt(len(products) / 2)
    surely = float(products.mean()) - settings.MISFIT_ERRORS * error
    samples = float(np.sqrt(common).sum()) / len(products)
    return float(np.sqrt(max(surely, 0.0) / max(samples, np.finfo(np.float64).tiny)))


def _light_share(objective: Objective, x: Array, variance: float, modes: Array) -> float:
    """φ, the mean over pixels and both values; 0 where nothing may move."""
    if not len(modes):
        return 0.0
    for_core, channels = objective.for_core(x), objective.channels
    matrices, _, _ = objective.problem.normal_equations(for_core, objective.everything)
    precision = prior_precision(matrices.shape[1], channels, variance)
    alone = inverted(matrices, precision)
    own = np.einsum("pii->pi", alone)
    moves, _ = objective.problem.moves_with_lights(for_core, objective.everything, alone, modes)
    return float(np.nan_to_num(moves / own)[:, channels:].mean())


def light_modes(objective: Objective, x: Array, of_pixels: int | None = None) -> Array:
    """(R, N, K, C): the lights' covariance, of noise 1, as independent modes of deviation 1.

    From their spectrum over some pixels of a fit; those modes that matter to materials. None, R is
    0, where lights are known. `of_pixels` is how many pixels saw them, if not those of the
    objective alone.

    With G the information on the lights if materials were known, and S what is left of it where the
    pixels are eliminated (`pbrfit.fit.joint`), directions of the light are scaled to the same
    effect on the pictures, √(vᵀ G v). In these units S has eigenvalues λ in [0, 1]: the share of
    information that is left. Few are much below 1, however many pictures there are: those
    directions that materials can imitate. All of them lie in the span of the lights over the
    pictures (`Objective.light_basis`); beyond it λ is 1.

    The mode of λ adds (1 − λ)/λ to the sum over pixels of their variances in units of A⁻¹. That
    ranks the modes and bounds what those left out would add. A direction that materials can make up
    for completely has the least λ that is not rounding.
    """
    layout = objective.layout
    if objective.lighting is None:
        return np.zeros((0, layout.pictures, layout.coefficients, layout.channels))
    pixels = evenly_spaced(layout.pixels, settings.COARSE_PIXELS)
    few, part = objective.restricted(pixels), objective.part_of(x, pixels)
    channels, k = layout.light_channels, layout.coefficients
    alone = known_materials(few, part)
    basis, problem, for_core = few.light_basis(part), few.problem, few.for_core(part)
    if basis is None:
        basis = np.broadcast_to(np.eye(layout.pictures), (channels, *2 * (layout.pictures,)))
    else:  # sums of the pictures, whose samples have their mean weights
        problem, for_core = few.combined(part, basis)
        alone = np.broadcast_to(alone.mean(axis=0), (basis.shape[2], *alone.shape[1:]))
    rank = basis.shape[2]
    left, _ = problem.schur_complement(for_core, few.everything, mono=channels < layout.channels)
    # T with Tᵀ G T = 1, a block for each light in a channel.
    blocks = np.einsum("nckcl->cnkl", alone.reshape(rank, channels, k, channels, k))
    sizes, directions = np.linalg.eigh(blocks.reshape(-1, k, k))
    seen = sizes > 1e-12 * sizes.max()  # by some pixel
    scale = np.where(seen, 1 / np.sqrt(np.where(seen, sizes, 1.0)), 0.0)
    units = directions * scale[:, None]
    left = left.reshape(len(units), k, len(units), k)
    scaled = np.einsum("aki,akbl,blj->aibj", units, left, units, optimize=True)
    scaled = scaled.reshape(len(units) * k, -1)
    unseen = ~seen.ravel()
    scaled[unseen, unseen] = 1.0
    shares, vectors = np.linalg.eigh(scaled)  # λ rises
    shares = np.clip(shares, settings.LIGHT_INFORMATION_MIN, 1.0)
    # What the other pixels know of the lights is taken to be like what these know.
    more = (of_pixels or layout.pixels) / few.pixels
    remaining = np.cumsum(((1 - shares) / shares)[::-1])[::-1]
    remaining /= more * few.layout.maps.stop
    used = int(np.count_nonzero(remaining > settings.OMITTED_VARIANCE_SHARE_MAX))
    modes = (vectors / np.sqrt(more * shares))[:, :used].reshape(len(units), k, used)
    modes = (units @ modes).reshape(channels, rank, k, used)
    found = np.einsum("cnj,cjkm->mnkc", basis, modes, optimize=True)
    return np.ascontiguousarray(np.repeat(found, layout.channels // channels, axis=-1))


def prior_precision(unknowns: int, channels: int, variance: float) -> Array:
    """(D,): of a pixel's albedo, roughness and metallic before any picture, beside sums of squares.

    `variance` is that of a sample.
    """
    deviations = [settings.ALBEDO_DEVIATION] * channels
    deviations += [ROUGHNESS_DEVIATION, METALLIC_DEVIATION]
    return variance / np.square(deviations[:unknowns])
