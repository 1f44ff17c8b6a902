"""The common scale of albedo and lights: how uncertain it is, and scales by a reference.

Lights that are e^t times as bright with albedos e^−t times as large leave what a dielectric
reflects diffusely as it is. Only its highlight, whose F0 is fixed at 0.04, tells t: it is the
softest direction of a fit. The scale of lights is that of the irradiance, a ∝ A_l² L with the band
factors A_l of a diffuse surface, so that t = a · (change of the lights).

**Deviation.** With S the Gauss–Newton matrix of the lights, pixels eliminated (`pbrfit.fit.joint`),
and residuals of the variance s², independent noise gives t the variance s² C, C = a S⁻¹ aᵀ. What
residuals share, and materials that were not found, show as groups b of pixels that pull the scale
further apart. From the scores s_b and the share S_b of S that groups have, the jackknife that
leaves out one at a time is

    (B − 1)/B Σ_b u_b²      u_b = a S⁻¹ s_b/(1 − a S⁻¹ S_b S⁻¹ aᵀ/C), less their mean

(J. MacKinnon and H. White, J. Econometrics 29, 1985; for groups R. Bell and D. McCaffrey, Survey
Methodology 28, 2002). Groups are segments, and square patches; the largest of the variances counts.
Few groups tell a variance badly: with ν = (Σ u²)²/Σ u⁴ degrees of freedom (F. Satterthwaite,
Biometrics Bulletin 2, 1946) the deviation is that whose double is the 95 % of Student's t.

**References.** Where the albedo of some pixels is known, it tells t, and lights move along the
directions S⁻¹ aᵀ C⁻¹, in which all lights go best with a change of t, until it is met.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pbrfit._core import InputError
from pbrfit.fit import misfit, settings
from pbrfit.fit.joint import JointFit, SharedFit
from pbrfit.fit.light_prior import LightPrior
from pbrfit.fit.normal_equations import as_in_x
from pbrfit.fit.objective import Objective, in_channels
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.fit.pixels import fit_all
from pbrfit.fit.priors.gaussian import GaussianPrior
from pbrfit.fit.sampling import Labels, Pixels, evenly_spaced, groups_of
from pbrfit.values.arrays import Array, Mask

IRRADIANCE = np.repeat([np.pi, 2 * np.pi / 3, np.pi / 4, 0.0], [1, 3, 5, 7])
"""A_l of each coefficient of a light."""


@dataclass(frozen=True, eq=False)
class Scale:
    """What is known of the common scale."""

    deviation: Array
    """(light channels,): relative standard deviation."""
    assumed: str
    """What it rests on, in words, for `Result.assumed`."""
    referred: bool = False
    """Whether it rests on pixels of known albedo."""


def judge(
    objective: Objective, x: Array, prior: GaussianPrior | None, picture_effect: float
) -> Scale:
    """What is known of the scale of a fit that ended at x.

    Without a prior, roughness and metallic are taken to be uniform in [0, 1]. `picture_effect` is
    that of the noise of samples.
    """
    fit, variance, pixels = _at_end(objective, x, prior, settings.SCALE_PIXELS)
    curve = _Curve.of(fit, variance * picture_effect)
    variances = curve.variances(groupings(objective.layout, pixels))
    beside = "without priors" if prior is None else "with the material prior"
    return Scale(np.sqrt(variances), f"by the highlights of dielectrics, {beside}")


def refer(
    objective: Objective, x: Array, prior: GaussianPrior | None, white: tuple[float, float, float]
) -> tuple[Array, Scale]:
    """X with lights whose scale gives the pixels at (column, row) the albedo that is the third."""
    x, (column, row, value) = x.copy(), white
    region = reference_region(objective.layout.valid, column, row)
    held = None if prior is None else prior.held(x)
    moved = np.zeros(objective.layout.light_channels)
    for _ in range(settings.WHITE_STEPS_MAX):
        albedo = x[objective.albedo].reshape(objective.channels, -1)[:, region]
        means = albedo.mean(axis=1)
        wanted = np.log(np.maximum(means, settings.WHITE_ALBEDO_MIN) / value)
        wanted = in_channels(wanted, objective.layout.light_channels)
        if np.abs(wanted).max() < settings.WHITE_ERROR:
            break
        fit, variance, _ = _at_end(objective, x, held, settings.COARSE_PIXELS)
        step = np.clip(wanted, -settings.SCALE_STEP_MAX, settings.SCALE_STEP_MAX)
        directions = _Curve.of(fit, variance).directions
        x[objective.layout.lighting] += as_in_x(step @ directions, objective.layout)
        moved += step
        fit_all(objective, x, starts=0, prior=held)
    for_core = objective.for_core(x)
    matrices, _, sum_sq = objective.problem.normal_equations(for_core, objective.everything)
    noise = misfit.variance(objective, sum_sq)
    own = np.einsum("pcc->pc", matrices[region, : objective.channels, : objective.channels])
    of_pixels = noise / np.maximum(own, np.finfo(np.float64).tiny).sum(axis=0)
    variances = of_pixels / value**2 + settings.WHITE_TOLERANCE**2
    variances = in_channels(variances, objective.layout.light_channels)
    said = reference_in_words(white, len(region), moved)
    return x, Scale(np.sqrt(variances), said, referred=True)


def groupings(layout: ParameterLayout, pixels: Pixels) -> list[Labels]:
    """Groups (Q,) of some pixels: patches of the picture, and segments."""
    rows, columns = (of_all[pixels] for of_all in np.nonzero(layout.valid))
    side = max(1, round(max(layout.valid.shape) / settings.COMPARE_PATCHES))
    found = [rows // side * layout.valid.shape[1] + columns // side]
    return found if layout.segments is None else [*found, layout.segments[pixels]]


def checked_white(
    white: tuple[float, float, float], valid: Mask, size: tuple[int, int]
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
    by = ", ".join(f"{100 * share:+.2g} %" for share in moved)
    at = f"x {column:g}, y {row:g}"
    return f"by the reference at {at}: {pixels} pixels of albedo {value:g}; lights {by}"


def reference_region(valid: Mask, column: float, row: float) -> Pixels:
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
    _, _, sum_sq = few.problem.normal_equations(few.for_core(part), few.everything)
    noise = misfit.variance(few, sum_sq)
    if prior is None:
        shape = few.pixels, len(few.layout.roughness_metallic)
        prior = GaussianPrior(
            np.full(shape, 0.5), np.full(shape, settings.UNIFORM_PRECISION * noise)
        )
    else:
        prior = prior.held(x).rows(pixels)
    shared = SharedFit(LightPrior.around(few, part).weighing(noise, noise, few.pixels))
    fit = JointFit(few, part, sum_sq, shared, prior)
    return fit, noise / misfit.independent_share(few, part), pixels


@dataclass(frozen=True, eq=False)
class _Curve:
    """The scale of lights where a joint fit has ended."""

    fit: JointFit
    measures: Array
    """(C, all that is shared): a, padded."""
    solved: Array
    """The same: a S⁻¹."""
    variance: float
    """s² in the likelihood of a pixel."""

    @classmethod
    def of(cls, fit: JointFit, variance: float) -> _Curve:
        """Of a fit."""
        fit.renew_preconditioner()
        a = measures(fit.objective, fit.x)
        a = np.pad(a, ((0, 0), (0, fit.shared.size - a.shape[1])))
        solved = [fit.shared.solved(fit.objective, one) for one in a]
        return cls(fit, a, np.stack(solved), variance)

    @property
    def covariance(self) -> Array:
        """C."""
        return self.solved @ self.measures.T

    @property
    def directions(self) -> Array:
        """(C, M): S⁻¹ aᵀ C⁻¹, of the lights alone."""
        found = np.linalg.solve(self.covariance, self.solved)
        return np.asarray(found[:, : self.fit.lights.mean.size], np.float64)

    def variances(self, groupings: list[Labels]) -> Array:
        """(C,): the largest of those by noise and by each grouping (P,) of the pixels."""
        found = [self.variance * np.diag(self.covariance)]
        found += [self._jackknife(labels) for labels in groupings]
        return np.asarray(np.max(found, axis=0))

    def _jackknife(self, labels: Labels) -> Array:
        """(C,): variances by groups."""
        from scipy.special import stdtrit

        groups = groups_of(labels)
        count = len(groups)
        if count < settings.PATCHES_MIN:
            return np.zeros(len(self.solved))
        moves, shares = map(np.array, zip(*map(self._moves, groups), strict=True))
        moves /= 1 - np.minimum(shares, settings.GROUP_LEVERAGE_MAX)
        moves -= moves.mean(axis=0)
        squares = np.square(moves).sum(axis=0)
        freedom = squares**2 / np.maximum((moves**4).sum(axis=0), np.finfo(np.float64).tiny)
        wider = stdtrit(np.maximum(freedom, settings.PATCHES_MIN - 1), 0.975) / 1.96
        return np.asarray((count - 1) / count * squares * wider**2)

    def _moves(self, group: Pixels) -> tuple[Array, Array]:
        """(C,) each: u of a group before it is divided, and the share of S it has."""
        kept = self.fit.kept_system(group)
        own = [one @ kept.product(one) for one in self.solved]
        return self.solved @ kept.gradient, np.array(own) / np.diag(self.covariance)


def measures(objective: Objective, x: Array) -> Array:
    """(light channels, M), a: the change of each channel's scale by the lights of x."""
    lights = objective.lights_in_core(x)
    weighed = IRRADIANCE[: lights.shape[2]] ** 2 * lights
    sizes = (weighed * lights).sum(axis=(1, 2))
    found = np.zeros((len(lights), *lights.shape))
    for channel, size in enumerate(sizes):
        found[channel, channel] = weighed[channel] / max(size, np.finfo(np.float64).tiny)
    return found.reshape(len(lights), -1)
