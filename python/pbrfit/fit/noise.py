"""Noise of single samples: what each weighs in a fit, from what the fit leaves of all.

Least squares is right for samples of one variance and a normal distribution. Those of cameras and
files have neither: a picture may be darker, moved, or of something else; bright samples have more
noise than dark ones; some are hot, or show a highlight that the model does not have. So a residual
r of picture i at radiance m has a distribution with tails (`pbrfit.fit.tails`) and the variance of
an ordinary sample

    V = s_i² φ(m, f),      φ = c_0 + c_1 m/m̄ + c_2 (m/m̄)² + c_3 f/f̄,      c ≥ 0, mean of φ = 1

with read noise, shot noise, what grows with radiance (the model's own errors), and the variance f
that the file's encoding left (`Scene.noise_floor`). s_i, c and the tails are those of the largest
likelihood, by expectation–maximisation (K. Lange, R. Little and J. Taylor, "Robust statistical
modeling using the t distribution", J. Am. Stat. Assoc. 84, 1989; the variance function as in R.
Carroll and D. Ruppert, "Transformation and Weighting in Regression", 1988): with the weights w of
the tails

    s_i² = Σ w r²/φ / Σ (1 − h)        c from w r²/s_i² against φ

A fit takes up some of the noise: h is the leverage of a sample on its own residual, by its pixel's
unknowns and its picture's lights. Without it, pictures that weigh more would be fitted better, and
weigh more still. In squares a sample then weighs w/V.

A clipped sample says that radiance is at least (or at most) so much: it weighs what others do where
the model is on the wrong side, and nothing where it is not.

What a JPEG file lost is lost in all n pictures of the view alike, with the correlation ρ of their
files' errors. It weighs on a pixel's materials as if it were 1 + (n − 1) ρ times as much (L. Kish's
design effect of clusters), of which nothing shows in residuals, because materials take it up.

Where weights vary so little that equal ones cost almost nothing, and none is an outlier's, all are
equal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import settings
from pbrfit.fit.normal_equations import by_unknowns, products
from pbrfit.fit.objective import Objective
from pbrfit.fit.pixels import pieces
from pbrfit.fit.sampling import Pixels, slices
from pbrfit.fit.tails import StudentT, Tails, likeliest
from pbrfit.io.limits import AT_LEAST, AT_MOST
from pbrfit.threads import in_pieces
from pbrfit.values.arrays import Array, Codes, Mask


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Of a scene's pictures, in units of x."""

    variances: Array
    """s_i², (N,): of an ordinary sample of each picture."""
    shares: Array
    """c, (4,)."""
    mean_radiance: float
    mean_file_variance: float
    """m̄ and f̄; the latter is 0 where files left nothing."""
    tails: Tails
    is_even: bool
    """Whether equal weights are as good."""
    file_correlation: float = 0.0
    """ρ."""

    def sample_variances(self, samples: _Samples) -> Array:
        """V, (N, Q, C)."""
        relative = samples.radiance / self.mean_radiance
        found = self.shares[0] + relative * (self.shares[1] + self.shares[2] * relative)
        if samples.of_file is not None and self.mean_file_variance > 0:
            found += self.shares[3] / self.mean_file_variance * samples.of_file
        return np.asarray(found * self.variances[:, None, None])

    @property
    def picture_effect(self) -> float:
        """How much larger the variance of a pixel's materials is than by independent samples."""
        return 1 + (len(self.variances) - 1) * self.file_correlation * float(self.shares[3])

    def weights(
        self, objective: Objective, x: Array | None, *, first: bool = False
    ) -> NDArray[np.float32] | None:
        """(N, P, C) for squares around x, at most 1; None where all are equal.

        Without x those of samples that lie where the model has them. `first` is for an x that was
        fitted to outliers too: sound samples may be as far from it as these, and so both weigh by
        Student's t, which lets go of none.
        """
        if self.is_even and not objective.has_limits:
            return None
        wide = StudentT(min(self.tails.freedom, settings.NOISE_FREEDOM_START))
        tails = wide if first and self.tails.has_outliers else self.tails
        # What V over w is at least: that of a sample of weight 1.
        least = float(self.variances.min() * self.shares[0] / self.tails.largest_weight)
        found = np.empty((len(self.variances), objective.pixels, objective.channels), np.float32)

        def fill(part: tuple[Pixels, Array]) -> None:
            samples = _Samples.of(objective, *part)
            variances = self.sample_variances(samples)
            squares = np.square(samples.residuals) / variances
            weights = tails.weights(squares) / (tails.largest_weight / self.tails.largest_weight)
            if samples.limits is not None:  # a hot pixel at its maximum must not pull
                bounded = samples.limits > 0
                weights[bounded] = wide.weights(squares[bounded]) / wide.largest_weight
                weights[satisfied(samples.limits, samples.residuals)] = 0.0
            weights *= least / variances
            weights[~samples.used] = 0.0
            found[:, part[0]] = weights

        for pixels in pieces(objective.everything):
            left = _residuals(objective, pixels, x)
            parts = slices(len(pixels), settings.PIXELS_AT_ONCE)
            in_pieces(objective.threads, fill, [(pixels[one], left[:, one]) for one in parts])
        return found

    def deviance(self, objective: Objective, x: Array) -> float:
        """−2 ln of the likelihood of a sample at x, in the mean, less a constant."""
        total, count = 0.0, 0
        for pixels in pieces(objective.everything):
            samples = _Samples.of(objective, pixels, _residuals(objective, pixels, x))
            variances = self.sample_variances(samples)[samples.ordinary]
            squares = np.square(samples.residuals[samples.ordinary]) / variances
            total += float(self.tails.deviances(squares).sum() + np.log(variances).sum())
            count += variances.size
        return total / max(count, 1)

    def in_words(self) -> str:
        """For a stage's note."""
        sigmas = np.sqrt(self.variances)
        size = f"{sigmas.min():.2g} to {sigmas.max():.2g}"
        return f"deviations {size} of the pictures, {self.tails.in_words()}"

    def remarks(self, names: Sequence[str], exposures: Array | None) -> str:
        """Which pictures weigh less than the others and why, for `Result.assumed`; may be empty."""
        deviations = np.sqrt(self.variances / np.median(self.variances))
        found = [
            f"{name} weighs 1/{ratio**2:.3g} of the others: what is left of it is "
            f"{ratio:.2g} times as large" + ("" if exposures is None else ", at its own exposure")
            for name, ratio in zip(names, deviations, strict=True)
            if ratio > settings.PICTURE_DEVIATION_NAMED
        ]
        return "; ".join(filter(None, [*found, self.tails.remark()]))


@dataclass(frozen=True, eq=False)
class _Samples:
    """Of some pixels, (N, Q, C)."""

    residuals: Array
    radiance: Array
    """The model's; the pictures' where nothing has been fitted."""
    of_file: Array | None
    """Variances that the encoding left."""
    used: Mask
    """Which have weight, limits or not."""
    limits: Codes | None

    @classmethod
    def of(cls, objective: Objective, pixels: Pixels, residuals: Array) -> _Samples:
        pictures, weights = objective.pictures(pixels), objective.weights
        used = np.True_ if weights is None else weights[:, pixels] > 0
        return cls(
            residuals,
            (pictures + residuals).clip(0),
            objective.file_variances(pixels),
            np.broadcast_to(used, residuals.shape),
            objective.limits(pixels),
        )

    @property
    def ordinary(self) -> Mask:
        """Which tell the radiance."""
        return self.used if self.limits is None else self.used & (self.limits == 0)


def satisfied(limits: Codes, excess: Array) -> Mask:
    """Which samples are at a limit that a model, by its excess over them, is not inside of."""
    above = (limits == AT_LEAST) & (excess >= 0)
    return np.asarray(above | ((limits == AT_MOST) & (excess <= 0)))


def _residuals(objective: Objective, pixels: Pixels, x: Array | None) -> Array:
    """(N, Q, C): of some pixels at x; 0 without."""
    if x is None:
        return np.zeros((objective.layout.pictures, len(pixels), objective.channels))
    return objective.problem.residuals(objective.for_core(x), pixels).astype(np.float64)


def estimated(objective: Objective, x: Array, *, outliers: bool = False) -> NoiseModel:
    """From what is left of a level's pixels at x, which minimises its (weighted) squares.

    Without `outliers` no sample is taken for one: sound ones may be as far from an x that is on its
    way, and Student's t lets go of none.
    """
    every = objective.everything
    samples = _Samples.of(objective, every, _residuals(objective, every, x))
    used, of_file = samples.ordinary, samples.of_file
    counts = used.sum(axis=(1, 2))
    mean_radiance = float(samples.radiance[used].mean()) or settings.MEAN_RADIANCE
    mean_of_file = 0.0 if of_file is None else float(of_file[used].mean())
    relative = samples.radiance / mean_radiance
    terms = [np.ones_like(relative), relative, relative**2]
    if of_file is not None and mean_of_file > 0:
        terms.append(of_file / mean_of_file)
    features = np.stack([term[used] for term in terms], axis=-1)
    picture = np.broadcast_to(np.arange(len(used))[:, None, None], used.shape)[used]
    squares = np.square(samples.residuals[used])
    kept = 1 - _leverages(objective, x)[used]
    in_pictures = np.maximum(np.bincount(picture, kept, len(used)), 1.0)
    least = float(np.finfo(np.float32).eps) ** 2

    shares = np.zeros(features.shape[1])
    shares[0] = 1.0
    variances = np.array([_by_median(squares[picture == i], least) for i in range(len(used))])
    tails: Tails = StudentT(settings.NOISE_FREEDOM_START)
    for _ in range(settings.NOISE_ESTIMATION_STEPS):
        shape = features @ shares
        scaled = squares / (variances[picture] * shape)
        effective = tails.weights(scaled) * squares
        sums = np.bincount(picture, effective / shape, len(used))
        variances = np.maximum(sums / in_pictures, least)
        middle = float(np.median(variances[counts > 0]))
        variances = np.maximum(variances, settings.NOISE_VARIANCE_RATIO_MIN * middle)
        variances[counts == 0] = middle
        shares = _shares(features, effective / (variances[picture] * kept), shape)
        scaled = squares / (variances[picture] * (features @ shares))
        tails = likeliest(scaled, outliers=outliers)
    inverse = tails.weights(scaled) / (variances[picture] * (features @ shares))
    spread = float(np.square(inverse).mean() / inverse.mean() ** 2 - 1)
    return NoiseModel(
        variances,
        np.append(shares, np.zeros(4 - len(shares))),
        mean_radiance,
        mean_of_file,
        tails,
        spread < settings.EVEN_WEIGHTS_LOSS_MAX and not tails.has_outliers,
        objective.file_correlation,
    )


def _by_median(squares: Array, least: float) -> float:
    """A variance that outliers hardly move: half of normal noise is below 0.6745 σ in size."""
    return max(float(np.median(squares)) / 0.6745**2, least) if squares.size else least


def _shares(features: Array, squares: Array, shape: Array) -> Array:
    """The c ≥ 0 of squares, whose own variance is that of χ²: 2 φ²."""
    from scipy.optimize import nnls

    scaled = features / shape[:, None]
    gram, right = scaled.T @ scaled, scaled.T @ (squares / shape)
    factor = np.linalg.cholesky(gram + 1e-9 * np.trace(gram) * np.eye(len(gram)))
    found = nnls(factor.T, np.linalg.solve(factor, right))[0]
    # What no term explains is read noise: nothing is known for sure.
    found[0] = max(found[0], settings.NOISE_READ_SHARE_MIN)
    return np.asarray(found / (features @ found).mean())


def _leverages(objective: Objective, x: Array) -> Array:
    """H, (N, P, C)."""
    for_core = objective.for_core(x)
    derivatives, _, weights = objective.problem.derivatives(for_core, objective.everything)
    rows = by_unknowns(derivatives, objective.layout)
    pixels, unknowns = len(rows), rows.shape[-1]
    weighted = rows * weights[..., None]
    gram = products(rows, weights)
    gram += 1e-9 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(unknowns)
    gram += np.finfo(np.float64).tiny * np.eye(unknowns)
    solved = np.linalg.solve(gram, weighted.reshape(pixels, -1, unknowns).transpose(0, 2, 1))
    found = np.einsum("psd,pds->ps", rows.reshape(pixels, -1, unknowns), solved)
    found = found.reshape(weights.shape).transpose(1, 0, 2)
    if objective.lighting is not None:
        found = found + objective.coefficients / pixels
    return np.asarray(np.minimum(found, settings.LEVERAGE_MAX))
