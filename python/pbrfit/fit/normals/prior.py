"""What is thought likely of normals that are free, and of materials beside them.

Errors of estimated normals are no noise: they are alike over neighbouring pixels, and often over
the whole picture. So the tangent offsets δ = (a, b) of neighbours are drawn to each other,

    s² Σ_pq w_pq u_pq |δ_p − δ_q|² / σ²  +  s² Σ_p |δ_p|² / σ₀²

beside the sum of squared residuals, with the noise's variance s², edge-aware weights w and
u = 1/(1 + d²/c²) of Student's kind for the few large steps d = |δ_p − δ_q| / σ at outlines. The
second term is weak: lights can follow a turn that all normals have in common at little cost.

σ is found from the offsets themselves, by expectation and maximisation,

    σ² = Σ w u (|δ_p − δ_q|² + tr V_p + tr V_q) / 2 Σ w u

where V_p is the covariance of δ_p that is left.

With wrong normals held, lights bend to them, and materials to both; a fit that starts there stays
there. So normals are free from the first round of a level (`FreeNormals`), and metallic has a prior
around 0 in the first rounds: metal with a broad lobe and normals turned half way to the camera
shows what a dielectric shows, and where both are free most pixels would choose wrongly together.
Later rounds have a prior on roughness and metallic around what their segment has been found to be
made of. Without that, the many numbers of each pixel take up noise in a way that does not cancel
out over pixels, and lights end up beside the true ones however many there are.

Joint steps see the neighbours of a pixel where they were, which by itself would let errors of many
pixels in common fade only slowly. So all pixels of a patch have an offset in common that moves with
the lights: the coarse level of a two-level method.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import settings
from pbrfit.fit.levels import Level
from pbrfit.fit.misfit import variance
from pbrfit.fit.objective import Objective
from pbrfit.fit.pixels import pieces, taken
from pbrfit.fit.priors.gaussian import GaussianPrior
from pbrfit.fit.priors.mixture import prior_at
from pbrfit.fit.sampling import pairs_apart
from pbrfit.values.arrays import Array


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """Pairs of pixels, and how far their normals' changes are expected to be alike."""

    pairs: NDArray[np.intp]
    """(E, 2) indices."""
    weights: Array
    """(E,): w = e^(−|Δn|²/0.1) of the given normals, less where these are known to be unsure."""

    @classmethod
    def of(
        cls, index: NDArray[np.intp], normals: Array, normal_sigma: Array | None
    ) -> Neighbourhood:
        """Of pixels beside and below each other, by their `index` at row and column, or −1.

        Where the given normals (P, 3) of a pair are twice as unsure as the mean by `normal_sigma`
        (P,), in any unit, their changes may differ twice as far.
        """
        first, second = pairs = np.concatenate(pairs_apart(index), axis=1)
        difference = normals[first] - normals[second]
        squared = np.einsum("ed,ed->e", difference, difference)
        weights = np.exp(-squared / settings.NORMALS_EDGE_SCALE)
        if normal_sigma is not None and normal_sigma.any():
            mean = normal_sigma.mean()
            of_pairs = 0.5 * (normal_sigma[first] + normal_sigma[second])
            weights /= (np.maximum(of_pairs, settings.NORMALS_GIVEN_SIGMA_MIN * mean) / mean) ** 2
        return cls(pairs.T, weights)

    def sums(self, values: Array, weights: Array) -> Array:
        """Σ over the neighbours of each pixel of `weights` (E,) times their `values` (P, ·)."""
        first, second = self.pairs.T
        count = partial(np.bincount, minlength=len(values))
        found = np.zeros_like(values)
        for column, value in enumerate(values.T):
            found[:, column] = count(first, weights * value[second]) + count(
                second, weights * value[first]
            )
        return found


@dataclass(frozen=True, eq=False)
class TangentOffsetPrior:
    """The penalty on tangent offsets (P, 2) of some pixels, for noise of variance s²."""

    neighbourhood: Neighbourhood
    sigma: float = settings.NORMALS_OFFSET_SIGMA_START
    """σ, in radians."""
    robust_weights: Array = field(default_factory=lambda: np.ones(1))
    """(E,): u, or (1,) where all are alike."""

    def conditional(self, offsets: Array, variance: float) -> tuple[Array, Array]:
        """Mean (P, 2) and precision (P, 2) of each pixel's offset while the others stay."""
        weights = self.neighbourhood.weights / self.sigma**2 * self.robust_weights
        of_pairs = self.neighbourhood.sums(np.ones((len(offsets), 1)), weights)
        own = of_pairs + 1 / settings.NORMALS_OFFSET_SIGMA_ALONE**2
        mean = self.neighbourhood.sums(offsets, weights) / own
        return mean, np.repeat(variance * own, 2, axis=1)

    def fitted(self, offsets: Array, variances: Array) -> TangentOffsetPrior:
        """With σ and u from offsets (P, 2) and the variance that is left of each, tr V (P,)."""
        first, second = self.neighbourhood.pairs.T
        difference = offsets[second] - offsets[first]
        squared = np.einsum("ed,ed->e", difference, difference)
        squared = squared + variances[first] + variances[second]
        of_half_weight = 2 * settings.NORMALS_HALF_WEIGHT_STEP**2 * self.sigma**2
        robust_weights = 1 / (1 + squared / of_half_weight)
        weights = self.neighbourhood.weights * robust_weights
        total = float(weights.sum())
        if not total > 0:  # there are no pairs, or none that could be alike
            return self
        sigma = np.sqrt(float(weights @ squared) / (2 * total))
        sigma = float(np.clip(sigma, *settings.NORMALS_OFFSET_SIGMA_RANGE))
        return replace(self, sigma=sigma, robust_weights=robust_weights)


@dataclass(eq=False)
class FreeNormals:
    """The prior of a level from round to round."""

    offsets: TangentOffsetPrior
    patches: NDArray[np.intp]
    """(P,): which patch each pixel of the level is in, from 0."""
    _variances: Array | None = field(default=None, init=False)
    """(P,): tr V of the offsets, after the last round."""

    @classmethod
    def of(cls, level: Level, given: Array, normal_sigma: Array | None) -> FreeNormals:
        """With given normals (P, 3) of the level, and how unsure they are, (P,), in any unit."""
        neighbourhood = Neighbourhood.of(level.index, given, normal_sigma)
        patches = np.empty(len(given), np.intp)
        for number, patch in enumerate(level.patches(settings.NORMALS_PATCH_SIDE)):
            patches[patch] = number
        return cls(TangentOffsetPrior(neighbourhood), patches)

    def is_settled(self, number: int) -> bool:
        """Whether the priors of that round and all later ones are alike."""
        sigmas = settings.NORMALS_MATERIAL_SIGMAS_MIN
        return number + 1 >= settings.NORMALS_DIELECTRIC_ROUNDS + len(sigmas)

    def prior(self, objective: Objective, x: Array, number: int) -> GaussianPrior:
        """On roughness, metallic and tangent offset of each pixel, in a round."""
        left = variance(objective, pixel_sums(objective, x))
        layout = objective.layout
        mean, precision = self._of_materials(objective, x, number, left)
        offset_mean, offset_precision = self.offsets.conditional(offsets_of(objective, x), left)
        assert layout.tangent_offsets is not None
        first, count = layout.tangent_offsets.start, objective.pixels
        blocks = [slice(first, first + count), slice(first + count, first + 2 * count)]
        return GaussianPrior(
            np.concatenate([mean, offset_mean], axis=1),
            np.concatenate([precision, offset_precision], axis=1),
            self.patches,
            (*layout.roughness_metallic, *blocks),
        )

    def _of_materials(
        self, objective: Objective, x: Array, number: int, left: float
    ) -> tuple[Array, Array]:
        columns = len(objective.layout.roughness_metallic)
        later = number - settings.NORMALS_DIELECTRIC_ROUNDS
        if later < 0:
            # As good as no prior on roughness; without any its offset would be undetermined.
            precision = np.full((objective.pixels, columns), 1e-6 * left)
            precision[:, 1:] = left / settings.NORMALS_DIELECTRIC_SIGMA**2
            return np.zeros_like(precision), precision
        sigmas = settings.NORMALS_MATERIAL_SIGMAS_MIN
        sigma = sigmas[min(later, len(sigmas) - 1)]
        found = prior_at(objective, x, sigma, left)
        return found.mean, found.precision

    def learn(self, objective: Objective, x: Array, prior: GaussianPrior, left: float) -> None:
        """How alike neighbours are, from offsets and what is uncertain of them; not at first."""
        variances = offset_variances(objective, x, prior.precision, left)
        if self._variances is not None:
            self.offsets = self.offsets.fitted(offsets_of(objective, x), variances)
        self._variances = variances


def offsets_of(objective: Objective, x: Array) -> Array:
    """Tangent offsets (P, 2)."""
    return taken(objective, x, slice(None))[:, -2:]


def noise_variance(objective: Objective, sum_sq_residuals: Array) -> float:
    """s² of samples of weight 1, as the better half of the pixels has it, from their sums (P,)."""
    samples = objective.samples / objective.pixels
    left = samples - objective.layout.maps.stop / objective.pixels
    left = max(left, settings.DEGREES_OF_FREEDOM_SHARE_MIN * samples)
    return float(max(np.median(sum_sq_residuals) / left, settings.NOISE_VARIANCE_MIN))


def pixel_sums(objective: Objective, x: Array) -> Array:
    """Summed squared residuals Σ ω (I − T)² of each pixel, (P,)."""
    found = np.empty(objective.pixels)
    for chunk in pieces(objective.everything):
        found[chunk] = objective.problem.normal_equations(objective.for_core(x), chunk)[2]
    return found


def offset_variances(objective: Objective, x: Array, precision: Array, variance: float) -> Array:
    """Tr V of each pixel's tangent offset, its other unknowns free and its neighbours held, (P,).

    `precision` (P, F + 2) is that of the priors on roughness, metallic and the tangent offset, for
    noise of this `variance`.
    """
    found = np.empty(objective.pixels)
    channels = objective.channels
    for chunk in pieces(objective.everything):
        matrices, _, _ = objective.problem.normal_equations(objective.for_core(x), chunk)
        diagonal = np.einsum("pii->pi", matrices)
        diagonal[:, channels:] += precision[chunk]
        diagonal *= 1 + 1e-9
        diagonal += np.finfo(np.float64).tiny + 1e-12 * diagonal.max()
        covariance = np.linalg.inv(matrices)
        found[chunk] = variance * np.einsum("pii->p", covariance[:, -2:, -2:])
    return found
