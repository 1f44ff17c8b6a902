"""What is thought likely of a level's normals and materials where both are free.

With wrong normals held, lights bend to them, and materials to both; a fit that starts there stays
there. So normals are free from the first round, but alike nearby (`offset_prior`), and metallic has
a prior around 0 in the first rounds: metal with a broad lobe and normals turned half way to the
camera shows what a dielectric shows, and where both are free most pixels would choose wrongly
together. Later rounds have a prior on roughness and metallic around what their segment has been
found to be made of. Without that, the many numbers of each pixel take up noise in a way that does
not cancel out over pixels, and lights end up beside the true ones however many there are.

Joint steps see the neighbours of a pixel where they were, which by itself would let errors of many
pixels in common fade only slowly. So all pixels of a patch have an offset in common that moves with
the lights: the coarse level of a two-level method.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import settings
from pbrfit.fit.levels import Level
from pbrfit.fit.misfit import variance
from pbrfit.fit.normals.offset_prior import Neighbourhood, TangentOffsetPrior
from pbrfit.fit.objective import Objective
from pbrfit.fit.pixels import pieces, taken
from pbrfit.fit.priors.gaussian import GaussianPrior
from pbrfit.fit.priors.mixture import prior_at

Array = NDArray[np.float64]


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
        sigma, nodes = sigmas[min(later, len(sigmas) - 1)], settings.NORMALS_METALLIC_NODES
        found = prior_at(objective, x, sigma, left, np.array(nodes))
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
