"""What a fit leaves of the pictures: how much of it is noise, and what the rest does to a fit.

Pictures are never the model plus independent noise. What the model does not have (shadows, bounces,
wrong normals, another field of view) leaves residuals that neighbours, channels and pictures share.
As many squares that fall together say less than as many that are independent, and lights are far
less certain than the residuals' variance says. Three figures of a level of pixels tell how far:

- the variance s² of a residual, by the degrees of freedom;
- the **design effect** on the lights, κ: how much larger their variance is than with independent
  residuals. With the score of a patch of pixels s_b = Σ_p Bᵀ (1 − P) r, its pixels solved for, and
  S as in `pbrfit.fit.joint`,

      κ = Σ_b s_bᵀ S⁻¹ s_b / (s² M)

  over the patches, their mean removed: the mean diagonal of the sandwich S⁻¹ (Σ_b s_b s_bᵀ) S⁻¹
  against s² S⁻¹ (P. J. Huber, 1967; the name is L. Kish's, 1965). Noise gives 0.6 to 1;
- the **independent share** τ of a pixel's samples: (tr C)²/‖C‖² of the covariance C of its samples
  over pixels, residuals of a pixel scaled to length 1, over its degrees of freedom. ‖C‖² is taken
  less what so many pixels leave of it by chance. Noise gives 1.

κ s² is what the prior on lights weighs (`pbrfit.fit.light_prior`), s²/τ the variance in a pixel's
likelihood, which the mixture prior rests on. No threshold tells misfit from noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pbrfit.fit import settings
from pbrfit.fit.objective import Objective
from pbrfit.values.arrays import Array


@dataclass(frozen=True)
class Misfit:
    """What is left of a level, in units of x."""

    variance: float
    """s², of samples of weight 1."""
    design_effect: float = 1.0
    independent_share: float = 1.0
    """κ and τ."""
    picture_effect: float = 1.0
    """As of `NoiseModel`: what pictures share, which residuals do not show."""

    @property
    def of_camera(self) -> float:
        """κ s², no less than s², times what pictures share: they all see through one camera."""
        return self.variance * max(self.design_effect, 1.0) * self.picture_effect

    def in_words(self) -> str:
        """For a stage's note."""
        independent = f"independent share {self.independent_share:.2f}"
        return f"design effect {self.design_effect:.2g}, {independent}"

    @property
    def of_likelihood(self) -> float:
        """s² max(κ, 1)/τ, times what pictures share: in the likelihood of a pixel among others."""
        return self.of_camera / self.independent_share


def variance(objective: Objective, sum_sq: Array, unknowns: float | None = None) -> float:
    """s², from the sums of squared residuals (P,) and the freedom that unknowns leave.

    Without `unknowns` they are those of all pixels and the lights.
    """
    least = settings.DEGREES_OF_FREEDOM_SHARE_MIN * objective.samples
    unknowns = objective.size if unknowns is None else unknowns
    freedom = max(objective.samples - unknowns, least)
    return max(float(sum_sq.sum()) / freedom, settings.NOISE_VARIANCE_MIN)


def independent_share(objective: Objective, x: Array) -> float:
    """τ."""
    count = objective.pixels
    found = objective.problem.residuals(objective.for_core(x), objective.everything)
    of_pixels = found.transpose(1, 0, 2).reshape(count, -1).astype(np.float64)
    weights = objective.sample_weights
    if weights is not None:
        shares = np.sqrt(np.broadcast_to(weights, found.shape)).transpose(1, 0, 2)
        of_pixels *= shares.reshape(count, -1)
    samples = of_pixels.shape[1]
    size = np.sqrt(np.square(of_pixels).mean(axis=1))
    of_pixels /= np.maximum(size, np.finfo(np.float64).tiny)[:, None]
    covariance = of_pixels.T @ of_pixels / count
    trace = float(np.trace(covariance))
    by_chance = float(np.square(np.square(of_pixels).sum(axis=1)).sum()) / count**2
    square = max(float(np.square(covariance).sum()) - by_chance, trace**2 / samples)
    freedom = max(1.0, samples - objective.layout.maps.stop / count)
    if not square > 0:
        return 1.0
    return float(np.clip(trace**2 / square / freedom, 1 / freedom, 1.0))
