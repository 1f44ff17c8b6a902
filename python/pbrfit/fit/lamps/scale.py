"""How uncertain the scale between lamps and albedo is, where highlights alone tell it.

S is what a joint fit knows of the lights, pixels eliminated, C = S⁻¹, and t = a · (change of the
lights) the relative change of the lamps' colours c, a = c/|c|². Samples with independent errors
give t the variance aᵀ C a. But what is wrong with highlights is shared by the pixels around them.
Blocks b, of scores s_b, want to move the scale by u_b = −a C s_b, so that

    variance = aᵀ C a + (Σ u_b)² + B/(B − 1) Σ (u_b − ū)²

Steps leave the scale as it is until next to nothing is left (`Freedom.scale`), so Σ u_b, which is
how far a step would take it, need not be 0. The last term is the variance of such sums (P. J.
Huber, 1967).

Albedos of pictures tell the scale, too: ln t ~ N(0, s²). Where both differ by d, more than v + s²,
one is wrong by τ, τ² = d² − v − s² (J. Mandel, R. Paule, 1970: the variance between measurements),
and t by |exp(∓τ) − 1|: an albedo that is found too dark may be many times as bright.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.lamps.joint import ALBEDO_SPREAD, JointLamps
from pbrfit.fit.lamps.samples import blocks_of
from pbrfit.fit.settings import PATCHES_MIN

Array = NDArray[np.float64]


def measure(fit: JointLamps) -> Array:
    """(M,): a, of all that pixels share."""
    lamps = fit.state.lamps
    found = np.zeros(6 * len(lamps) + 3 * fit.pixels.pictures)
    size = max(float(np.square(lamps.colors).sum()), np.finfo(np.float64).tiny)
    found[3 * len(lamps) : 6 * len(lamps)] = lamps.colors.ravel() / size
    return found


def deviation(fit: JointLamps, covariance: Array) -> float:
    """Relative, of the lamps with a covariance (M, M)."""
    a = measure(fit)
    return float(np.sqrt(np.maximum(a @ covariance @ a, 0.0)))


def with_pulls(covariance: Array, fit: JointLamps, width: int) -> Array:
    """The covariance (M, M) of a fit's lights, with what blocks of pictures of a width do."""
    a = measure(fit)
    seen = covariance @ a
    own = float(a @ seen)
    if not own > 0:  # known colours
        return covariance
    _, blocks = np.unique(blocks_of(np.divmod(fit.pixels.places, width)), return_inverse=True)
    count = int(blocks.max()) + 1
    each, of_priors = fit.scores(seen)
    pulls = np.bincount(blocks, each, count)
    more = float(pulls.sum() + of_priors) ** 2
    if count >= PATCHES_MIN:
        more += count / (count - 1) * float(np.square(pulls - pulls.mean()).sum())
    apart = ALBEDO_SPREAD * float(fit.scale_of(fit.state.lamps)[0])
    between = np.sqrt(max(apart**2 - own - more - ALBEDO_SPREAD**2, 0.0))
    more += float(np.expm1(np.copysign(between, apart))) ** 2
    return covariance + more / own**2 * np.outer(seen, seen)
