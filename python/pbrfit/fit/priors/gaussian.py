"""A Gaussian prior on roughness and metallic of pixels, with offsets that clusters share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.sampling import Pixels
from pbrfit.fit.settings import OFFSET_PRECISION_SHARE
from pbrfit.lazy import lazy
from pbrfit.values.arrays import Array


@dataclass(frozen=True, eq=False)
class GaussianPrior:
    """Σ_pf a_pf (v_pf − c_pf − δ_g(p)f)² + s Σ_gf (Σ_{p in g} a_pf) δ_gf², a term of the objective.

    v are F unknowns of each pixel p: roughness and metallic, or the first alone where metallic is
    known. The offset δ of a cluster g lets its pixels move together; s is `OFFSET_PRECISION_SHARE`.
    As a penalty it has the best offsets for x, δ = Σ a (v − c) / ((1 + s) Σ a), so that x alone
    decides; the derivative by them vanishes there, and ∂/∂v = 2 a (v − c − δ).
    """

    mean: Array
    precision: Array
    """(P, F): c, and a in units of squared residuals."""
    cluster: NDArray[np.intp] | None = None
    """(P,): which offset a pixel has, from 0; None = there are no offsets."""
    blocks: tuple[slice, ...] = ()
    factor: float = 1.0
    """As a penalty: where v lies in x, by f, and what the sum is multiplied by."""
    name: str = "material"
    """Of the prior that it belongs to."""

    @lazy
    def clusters(self) -> int:
        """Number of clusters."""
        return 0 if self.cluster is None else int(self.cluster.max(initial=-1)) + 1

    @lazy
    def cluster_precision(self) -> Array:
        """Σ a over the pixels of each cluster, (clusters, F)."""
        return self.sums(self.precision)

    def sums(self, values: Array) -> Array:
        """Sums of values (P, F) over the pixels of each cluster, (clusters, F)."""
        assert self.cluster is not None
        columns = [
            np.bincount(self.cluster, weights=column, minlength=self.clusters)
            for column in values.T
        ]
        return np.stack(columns, axis=-1)

    def rows(self, pixels: Pixels | slice) -> GaussianPrior:
        """The mean and precision of some pixels, without clusters."""
        return GaussianPrior(self.mean[pixels], self.precision[pixels])

    def offsets(self, x: Array) -> Array:
        """The best offsets for x, δ: (clusters, F)."""
        deviation = np.stack([x[block] for block in self.blocks], axis=-1) - self.mean
        sums = self.sums(self.precision * deviation)
        return sums / ((1 + OFFSET_PRECISION_SHARE) * self.cluster_precision)

    def held(self, x: Array) -> GaussianPrior:
        """The mean with the best offsets for x, c + δ, and the precision, without clusters."""
        offsets = 0.0 if self.cluster is None else self.offsets(x)[self.cluster]
        return GaussianPrior(self.mean + offsets, self.precision)

    def cost(self, values: Array) -> float:
        """Σ a (v − c)² at values (P, F)."""
        return float((self.precision * (values - self.mean) ** 2).sum())

    def value_and_grad(self, x: Array, gradient: Array) -> float:
        """See `Penalty`."""
        total, offsets = 0.0, None if self.cluster is None else self.offsets(x)
        for f, block in enumerate(self.blocks):
            precision, deviation = self.precision[:, f], x[block] - self.mean[:, f]
            of_offsets = 0.0
            if offsets is not None:
                deviation -= offsets[self.cluster, f]
                of_clusters = self.cluster_precision[:, f] * offsets[:, f] ** 2
                of_offsets = OFFSET_PRECISION_SHARE * float(of_clusters.sum())
            total = total + float((precision * deviation**2).sum()) + of_offsets
            gradient[block] += 2 * self.factor * precision * deviation
        return self.factor * total
