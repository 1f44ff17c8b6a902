"""The common scale of albedo and lights: its step, and its deviation.

Lights that are e^t times as bright with albedos e^−t times as large leave what a dielectric
reflects diffusely as it is. Only its highlight, whose F0 is fixed at 0.04, tells t: it is the
softest direction of a fit, and what is a small bias elsewhere is a large one here.

**Bias.** Where lights are found with each pixel's roughness at its best, of many possible
highlights the best one is the one that suits the noise best. So lights are a little off, with
however many pixels (J. Neyman and E. Scott, Econometrica 16, 1948). With the material prior they
are found once more, with a prior of pixels that has no data in it. Where roughness and metallic v
of a pixel are summed over instead, lights have no such bias (J. Kiefer and J. Wolfowitz, Ann. Math.
Stat. 27, 1956). By Laplace's method that is

    −2 ln L(lights) = Σ_p min over v of [‖r‖²/s² + prior] + ln det H_p,    H = (Jᵀ(1 − P)J + A)/s²

with J the derivatives of the residuals r by v, albedos solved for (P projects on what they can do),
and A the precision of the prior. Its minimum is that of the first term, and a step of Newton's
method further: with t = a L the scale of each channel's lights, to first order in their change,

    t = −½ s² C g      C = a S⁻¹ aᵀ      g = d/dt Σ_p ln det H_p

along the directions V = S⁻¹ aᵀ C⁻¹ in which all lights go best with a change of t (S as in
`pbrfit.fit.joint`; the derivative is a central difference). The measure is that of ln albedo, in
which albedo's own determinant does not change with t. The scale of lights is that of the
irradiance, a ∝ A_l² L with the band factors A_l of a diffuse surface. A fit without a prior has t
as an error.

Such a bias goes with how few samples a pixel has, and Laplace's method has errors of its own, so
the step is taken where samples are few (`takes_step`).

**Deviation.** Noise that is independent gives the variance s² C. What residuals share, and segments
whose material was not found, show as groups b of pixels that pull the scale further apart. From the
scores s_b and the share S_b of S that groups have, the jackknife that leaves out one at a time is

    (B − 1)/B Σ_b u_b²      u_b = (a S⁻¹ s_b + ½ s² C g_b)/(1 − a S⁻¹ S_b S⁻¹ aᵀ/C), less their mean

(J. MacKinnon and H. White, J. Econometrics 29, 1985; for groups R. Bell and D. McCaffrey, Survey
Methodology 28, 2002). Groups are segments (without them clusters of the prior), or square patches;
the largest of the three variances counts. Few groups tell a variance badly: with ν = (Σ u²)²/Σ u⁴
degrees of freedom (F. Satterthwaite, Biometrics Bulletin 2, 1946) the deviation is that whose
double is the 95 % of Student's t. And the prior is one of several that describe the same pixels:
the lights before it was without data, and without the step, are another answer. Two answers that
are d apart, and equally likely, have the standard deviation d/2 (D. Draper, J. R. Statist. Soc.
B 57, 1995).

**References.** Where the albedo of some pixels is known, it tells t, and lights move along V until
it is met.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.fit import misfit, settings
from pbrfit.fit.joint import JointFit, SharedFit, Stop, minimize
from pbrfit.fit.light_prior import LightPrior, as_in_core
from pbrfit.fit.normal_equations import albedo_solved_for, as_in_x
from pbrfit.fit.objective import Objective
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.fit.pixels import Pixels, fit_all
from pbrfit.fit.priors.gaussian import GaussianPrior
from pbrfit.fit.priors.mixture import prior_without_data
from pbrfit.fit.sampling import evenly_spaced, evenly_spaced_over

Array = NDArray[np.float64]
Labels = NDArray[np.intp]

IRRADIANCE = np.repeat([np.pi, 2 * np.pi / 3, np.pi / 4, 0.0], [1, 3, 5, 7])
"""A_l of each coefficient of a light."""


@dataclass(frozen=True, eq=False)
class Scale:
    """What is known of the common scale."""

    deviation: Array
    """(light channels,): relative standard deviation."""
    assumed: str
    """What it rests on, in words, for `Result.assumed`."""
    note: str = ""
    """For the stage."""
    referred: bool = False
    """Whether it rests on pixels of known albedo."""


def find(
    objective: Objective, x: Array, strength: float, variance: float, shared: SharedFit, stop: Stop
) -> tuple[Array, Scale] | None:
    """X with lights that some pixels find with a prior without data, from those with the prior.

    Where samples are few, they take their step. `strength` and `variance` as for the material
    prior. None if stopped before.
    """
    labels = objective.layout.segments
    no_labels = np.zeros(objective.pixels, np.intp)
    pixels = evenly_spaced_over(no_labels if labels is None else labels, settings.SCALE_PIXELS)
    few, part = objective.restricted(pixels), objective.part_of(x, pixels)
    prior = prior_without_data(few, part, strength, variance)
    if stop():
        return None
    sum_sq = few.put_best_albedo(part, np.arange(few.pixels, dtype=np.uint64))
    fit = shared.joint_fit(few, part, sum_sq, prior=prior, stop=stop)
    before = part[few.layout.maps.stop :].copy()
    minimize(fit, settings.SCALE_STEPS, settings.GAIN_MIN)
    if stop():
        return None
    with_step, of_step = takes_step(objective), ""
    curve = _Curve.of(fit, variance, slopes=with_step)
    if with_step:
        step = np.clip(curve.step, -settings.SCALE_STEP_MAX, settings.SCALE_STEP_MAX)
        part[few.layout.lighting] += as_in_x(step @ curve.directions, few.layout)
        of_step = f", of it {_percent(step)} by the marginal likelihood"
    moved = change(part[few.layout.maps.stop :], before, few)
    by_group = curve.variances(groupings(objective.layout, pixels, prior.cluster))
    variances = by_group + (moved / 2) ** 2
    x = x.copy()
    x[objective.layout.maps.stop :] = part[few.layout.maps.stop :]
    deviation = np.sqrt(variances)
    note = (
        f"{few.pixels} pixels; lights {_percent(moved)}{of_step}; "
        f"standard deviation {_percent(deviation, '')}"
    )
    said = "by the highlights of dielectrics, with the material prior"
    return x, Scale(deviation, said, note)


def takes_step(objective: Objective) -> bool:
    """Whether samples are so few that lights take the step of the marginal likelihood."""
    most = settings.SCALE_SAMPLES_OF_UNKNOWN * objective.layout.maps.stop
    return bool(objective.samples < most)


def judge(
    objective: Objective, x: Array, prior: GaussianPrior | None, picture_effect: float
) -> Scale:
    """What is known of the scale of a fit at x, which has had no step of its own.

    Without a prior, roughness and metallic are taken to be uniform in [0, 1]. What the step would
    be is an error of these lights. `picture_effect` as of the noise of samples.
    """
    fit, variance, pixels = _at_end(objective, x, prior, settings.SCALE_PIXELS)
    curve = _Curve.of(fit, variance * picture_effect)
    variances = curve.variances(groupings(objective.layout, pixels)) + curve.step**2
    said = "by the highlights of dielectrics" + ("" if prior is not None else ", without priors")
    return Scale(np.sqrt(variances), said)


def refer(
    objective: Objective, x: Array, prior: GaussianPrior | None, white: tuple[float, float, float]
) -> tuple[Array, Scale]:
    """X with lights whose scale gives the pixels at (column, row) the albedo that is the third."""
    x, (column, row, value) = x.copy(), white
    region = reference_region(objective.layout.valid, column, row)
    everything = np.arange(objective.pixels, dtype=np.uint64)
    held = None if prior is None else GaussianPrior(prior.prior_mean(x), prior.precision)
    means, moved = np.empty(0), np.zeros(objective.layout.light_channels)
    for _ in range(settings.WHITE_STEPS_MAX):
        albedo = x[objective.albedo].reshape(objective.channels, -1)[:, region]
        means = albedo.mean(axis=1)
        wanted = np.log(np.maximum(means, settings.WHITE_ALBEDO_MIN) / value)
        if objective.layout.light_channels < objective.channels:
            wanted = wanted.mean(keepdims=True)
        if np.abs(wanted).max() < settings.WHITE_ERROR:
            break
        fit, variance, _ = _at_end(objective, x, held, settings.COARSE_PIXELS)
        largest = settings.SCALE_STEP_MAX
        step = np.clip(wanted, -largest, largest)
        directions = _Curve.of(fit, variance, slopes=False).directions
        x[objective.layout.lighting] += as_in_x(step @ directions, objective.layout)
        moved += step
        fit_all(objective, x, starts=0, prior=held)
    matrices, _, sum_sq = objective.problem.normal_equations(objective.for_core(x), everything)
    noise = misfit.variance(objective, sum_sq)
    own = np.einsum("pcc->pc", matrices[region, : objective.channels, : objective.channels])
    of_pixels = noise / np.maximum(own, np.finfo(np.float64).tiny).sum(axis=0)
    variances = of_pixels / value**2 + settings.WHITE_TOLERANCE**2
    if objective.layout.light_channels < objective.channels:
        variances = variances.mean(keepdims=True)
    said = reference_in_words(white, len(region), moved)
    return x, Scale(np.sqrt(variances), said, referred=True)


def groupings(
    layout: ParameterLayout, pixels: Pixels, cluster: Labels | None = None
) -> list[Labels]:
    """Groups (Q,) of some pixels: patches of the picture, and segments, or else clusters (Q,)."""
    rows, columns = (of_all[pixels] for of_all in np.nonzero(layout.valid))
    side = max(1, round(max(layout.valid.shape) / settings.SCALE_PATCHES))
    found = [rows // side * layout.valid.shape[1] + columns // side]
    if layout.segments is not None:
        cluster = layout.segments[pixels]
    return found if cluster is None else [*found, cluster]


def checked_white(
    white: tuple[float, float, float], valid: NDArray[np.bool_], size: tuple[int, int]
) -> tuple[float, float, float]:
    """The same in pixels of the working picture, from those of pictures of `size` (height, width).

    Raises
    ------
    InputError
        If it is outside the picture or its mask.
    """
    x, y, value = white
    if not (0 <= x < size[1] and 0 <= y < size[0]):
        raise InputError(
            f"white: expected x below {size[1]} and y below {size[0]}, found {x:g}, {y:g}"
        )
    height, width = valid.shape
    x, y = (int((x + 0.5) * width / size[1]), int((y + 0.5) * height / size[0]))
    if not valid[y, x]:
        raise InputError(
            f"white: expected a pixel inside the mask, found {white[0]:g}, {white[1]:g}"
        )
    return x, y, value


def reference_in_words(white: tuple[float, float, float], pixels: int, moved: Array) -> str:
    """What a scale rests on: a reference of so many pixels, by which lights have moved (C,)."""
    column, row, value = white
    return (
        f"by the reference at x {column:g}, y {row:g}: {pixels} pixels of albedo {value:g}; "
        f"lights {_percent(moved)}"
    )


def reference_region(valid: NDArray[np.bool_], column: float, row: float) -> Pixels:
    """Which of the valid pixels are around one, or the nearest one."""
    rows, columns = np.nonzero(valid)
    far = np.maximum(np.abs(rows - row), np.abs(columns - column))
    near = max(settings.WHITE_RADIUS, float(far.min()))
    return np.flatnonzero(far <= near).astype(np.uint64)


def _at_end(
    objective: Objective, x: Array, prior: GaussianPrior | None, at_most: int
) -> tuple[JointFit, float, Pixels]:
    """A joint fit of some pixels that ended at x, s² of a pixel's likelihood, and the pixels."""
    pixels = evenly_spaced(objective.pixels, at_most)
    few, part = objective.restricted(pixels), objective.part_of(x, pixels)
    _, _, sum_sq = few.problem.normal_equations(
        few.for_core(part), np.arange(few.pixels, dtype=np.uint64)
    )
    noise = misfit.variance(few, sum_sq)
    if prior is None:
        shape = few.pixels, len(few.layout.roughness_metallic)
        prior = GaussianPrior(
            np.full(shape, 0.5), np.full(shape, settings.UNIFORM_PRECISION * noise)
        )
    else:
        prior = GaussianPrior(prior.prior_mean(x)[pixels], prior.precision[pixels])
    shared = SharedFit(LightPrior.around(few, part).weighing(noise, noise, few.pixels))
    fit = shared.joint_fit(few, part, sum_sq, prior=prior)
    return fit, noise / misfit.independent_share(few, part), pixels


@dataclass(frozen=True, eq=False)
class _Curve:
    """The marginal likelihood along the scale, where a joint fit has ended."""

    fit: JointFit
    measures: Array
    """(C, all that is shared): a, padded."""
    solved: Array
    """The same: a S⁻¹."""
    variance: float
    slopes: Array
    """(P, C): g of each pixel."""

    @classmethod
    def of(cls, fit: JointFit, variance: float, *, slopes: bool = True) -> _Curve:
        """Of a fit, with s² in the likelihood of a pixel."""
        fit.renew_preconditioner()
        a = measures(fit.objective, fit.x)
        a = np.pad(a, ((0, 0), (0, fit.shared.size - a.shape[1])))
        solved = np.stack([fit.solved(one) for one in a])
        found = cls(fit, a, solved, variance, np.zeros((fit.objective.pixels, len(a))))
        if not slopes:
            return found
        prior = fit.pixel_prior(fit.offsets)
        of_each = [_slope(fit, one, prior, variance) for one in found.directions]
        return replace(found, slopes=np.stack(of_each, axis=-1))

    @property
    def covariance(self) -> Array:
        """C."""
        return self.solved @ self.measures.T

    @property
    def directions(self) -> Array:
        """(C, M): V, of the lights alone."""
        found = np.linalg.solve(self.covariance, self.solved)
        return np.asarray(found[:, : self.fit.lights.mean.size], np.float64)

    @property
    def step(self) -> Array:
        """(C,): t."""
        return np.asarray(-0.5 * self.variance * self.covariance @ self.slopes.sum(axis=0))

    def variances(self, groupings: list[Labels]) -> Array:
        """(C,): the largest of those by noise and by each grouping (P,) of the pixels."""
        found = [self.variance * np.diag(self.covariance)]
        found += [self._jackknife(labels) for labels in groupings]
        return np.asarray(np.max(found, axis=0))

    def _jackknife(self, labels: Labels) -> Array:
        """(C,): variances by groups."""
        from scipy.special import stdtrit

        order = np.argsort(labels, kind="stable").astype(np.uint64)
        starts = np.flatnonzero(np.diff(labels[order], prepend=labels.min() - 1))
        groups = np.split(order, starts[1:])
        count = len(groups)
        if count < settings.PATCHES_MIN:
            return np.zeros(len(self.solved))
        moves, shares = map(np.array, zip(*map(self._moves, groups), strict=True))
        moves /= 1 - np.minimum(shares, settings.GROUP_LEVERAGE_MAX)
        moves -= moves.mean(axis=0)
        squares = np.square(moves).sum(axis=0)
        freedom = squares**2 / np.maximum((moves**4).sum(axis=0), np.finfo(np.float64).tiny)
        wider = stdtrit(np.maximum(freedom, settings.FREEDOM_MIN), 0.975) / 1.96
        return np.asarray((count - 1) / count * squares * wider**2)

    def _moves(self, group: Pixels) -> tuple[Array, Array]:
        """(C,) each: u of a group before it is divided, and the share of S it has."""
        fit = self.fit
        objective, options = fit.objective, fit.options(fit.objective, fit.x, group, group)
        products = [
            objective.problem.schur_product(objective.for_core(fit.x), group, one, **options)
            for one in self.solved
        ]
        score = self.solved @ products[0][1]
        bias = 0.5 * self.variance * self.slopes[group].sum(axis=0) @ self.covariance
        own = [one @ product for one, (product, _) in zip(self.solved, products, strict=True)]
        return score + bias, np.array(own) / np.diag(self.covariance)


def measures(objective: Objective, x: Array) -> Array:
    """(light channels, M), a: the change of each channel's scale by the lights of x."""
    lights = as_in_core(x[objective.layout.lighting], objective)
    weighed = IRRADIANCE[: lights.shape[2]] ** 2 * lights
    sizes = (weighed * lights).sum(axis=(1, 2))
    found = np.zeros((len(lights), *lights.shape))
    for channel, size in enumerate(sizes):
        found[channel, channel] = weighed[channel] / max(size, np.finfo(np.float64).tiny)
    return found.reshape(len(lights), -1)


def change(after: Array, before: Array, objective: Objective) -> Array:
    """(light channels,): by what share the scale of lights (of x, both) has changed."""
    x = np.concatenate([np.zeros(objective.layout.maps.stop), before])
    change = as_in_core(after - before, objective).ravel()
    return np.asarray(measures(objective, x) @ change)


def _percent(shares: Array, sign: str = "+") -> str:
    return ", ".join(f"{100 * share:{sign}.2g} %" for share in shares)


def _slope(fit: JointFit, direction: Array, prior: GaussianPrior | None, variance: float) -> Array:
    """(P,): d/dt ln det H along a direction of the lights, pixels at their best.

    0 where H is singular, as it can be where rounding alone is left.
    """
    objective, layout = fit.objective, fit.objective.layout
    ends = []
    for sign in (-1, 1):
        x = fit.x.copy()
        x[layout.lighting] += as_in_x(sign * settings.SCALE_DIFFERENCE * direction, layout)
        fit_all(objective, x, starts=0, steps=settings.DESCENT_STEPS_AFTER_JOINT, prior=prior)
        ends.append(_log_determinants(objective, x, prior, variance))
    found = np.zeros(objective.pixels)
    np.subtract(ends[1], ends[0], out=found, where=np.isfinite(ends[0]) & np.isfinite(ends[1]))
    return np.asarray(found / (2 * settings.SCALE_DIFFERENCE))


def _log_determinants(
    objective: Objective, x: Array, prior: GaussianPrior | None, variance: float
) -> Array:
    """(P,): ln det H."""
    left, _ = albedo_solved_for(objective, x)
    if prior is not None:
        np.einsum("pff->pf", left)[:] += prior.precision
    return np.asarray(np.linalg.slogdet(left / variance)[1])
