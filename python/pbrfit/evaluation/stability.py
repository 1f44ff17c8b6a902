"""Numerical stability of the core: measurements against exact or float64 references.

Each function measures one thing and returns a frozen dataclass: its checks, which state a worst
figure and its bound, and the curves that a report may draw. Nothing here draws or writes.

The bounds on the fast objective hold for float32 arithmetic in any order with sums in blocks of up
to about a thousand terms and float64 beyond. They name nothing of how it is done.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from pbrfit import _core
from pbrfit.evaluation.double_precision import Case, Pixels, evaluate, sums
from pbrfit.evaluation.exact_bands import ExactBands, exact_bands, paper_rule
from pbrfit.evaluation.extreme_pixels import (
    KINDS,
    MANY_PICTURES,
    make_case,
    random_lights,
    random_pixels,
    random_targets,
)
from pbrfit.model import ggx_band_weights, shade_vjp

Array = NDArray[np.float64]

ROUNDING = 2.0**-24
"""u: the largest relative error of rounding to float32."""

SMALLEST_NORMAL = float(np.finfo(np.float32).tiny)

BAND_BOUND = 1e-14
SLOPE_BOUND = 5e-14
SLOPE_RELATIVE_BOUND = 1e-14
LOSS_BOUND = 5e-7
ENTRY_BOUND = 2e-6
BLOCK_BOUND = 1e-6
LIGHT_ENTRY_BOUND = 5e-7

BRANCH = 0.4
CLAMP = 1e-4


@dataclass(frozen=True)
class Check:
    """One figure and what it may be.

    Attributes
    ----------
    key
        Name in `summary.json`.
    what
        What is measured, in words.
    worst
        The figure.
    bound
        At most this; None = reported only.
    why
        A sentence on the bound.
    where
        Where the worst was found.
    """

    key: str
    what: str
    worst: float
    bound: float | None
    why: str
    where: str = ""

    @property
    def passed(self) -> bool:
        """Whether the bound holds; a figure that is not a number holds none."""
        return self.bound is None or self.worst <= self.bound


@dataclass(frozen=True)
class Effort:
    """How much is measured."""

    name: str
    band_points: int
    pixels_of_a_kind: int
    pictures: int
    branch_pixels: int
    scan_points: int
    residual_pixels: int
    summed_pixels: tuple[int, ...]
    summed_pictures: int
    summed_many: tuple[int, int]
    draws: int
    subnormal_pixels: int
    repeated: tuple[tuple[int, int], ...]


FULL = Effort(
    name="full",
    band_points=12_000,
    pixels_of_a_kind=393_216,
    pictures=8,
    branch_pixels=64,
    scan_points=201,
    residual_pixels=65_536,
    summed_pixels=tuple(4**k for k in range(3, 11)),
    summed_pictures=16,
    summed_many=(65_536, 256),
    draws=32,
    subnormal_pixels=65_536,
    repeated=((1, 1), (17, 3), (1000, 5), (70_001, 4), (300_000, 2)),
)

QUICK = Effort(
    name="quick",
    band_points=2_000,
    pixels_of_a_kind=8_192,
    pictures=8,
    branch_pixels=32,
    scan_points=41,
    residual_pixels=4_096,
    summed_pixels=tuple(4**k for k in range(3, 9)),
    summed_pictures=16,
    summed_many=(4096, 256),
    draws=8,
    subnormal_pixels=8_192,
    repeated=((1, 1), (17, 3), (1000, 5), (20_001, 4)),
)


@dataclass(frozen=True, eq=False)
class Stability:
    """All measurements."""

    effort: Effort
    seed: int
    bands: BandErrors
    kernel: KernelErrors
    branches: BranchPoints
    cancellation: Cancellation
    accumulation: Accumulation
    tiny: TinyNumbers
    determinism: Determinism

    @property
    def checks(self) -> tuple[Check, ...]:
        """Those of all sections."""
        sections = (
            self.bands,
            self.kernel,
            self.branches,
            self.cancellation,
            self.accumulation,
            self.tiny,
            self.determinism,
        )
        return tuple(check for section in sections for check in section.checks)

    @property
    def passed(self) -> bool:
        """Whether every bound holds."""
        return all(check.passed for check in self.checks)


def measure(
    effort: Effort,
    *,
    seed: int = 0,
    threads: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> Stability:
    """Measure everything.

    Parameters
    ----------
    effort
        `FULL` or `QUICK`.
    seed
        Of pixels, lights and pictures; each section draws its own, whatever the others do.
    threads
        Of the fast objective, 0 = one for each processor.
    progress
        Called with the name of each section before it starts.
    """

    def begin(number: int, name: str) -> Generator:
        progress(name)
        return np.random.default_rng([seed, number])

    # Small matrices: more BLAS threads only get into each other's way, and change the last bits.
    with threadpool_limits(1):
        begin(1, SECTIONS[0])
        bands = band_errors(effort)
        return Stability(
            effort,
            seed,
            bands,
            kernel_errors(effort, begin(2, SECTIONS[1]), threads),
            branch_points(effort, begin(3, SECTIONS[2]), threads),
            cancellation(effort, begin(4, SECTIONS[3]), threads),
            accumulation(effort, begin(5, SECTIONS[4]), threads),
            tiny_numbers(effort, begin(6, SECTIONS[5]), threads),
            determinism(effort, begin(7, SECTIONS[6])),
        )


SECTIONS = (
    "band weights",
    "fast objective",
    "branch points",
    "cancellation",
    "accumulated error",
    "tiny numbers",
    "determinism",
)


# 1. Band weights


@dataclass(frozen=True, eq=False)
class BandErrors:
    """Largest error over the four bands at every r, (M,), by three rules; NaN where one fails."""

    checks: tuple[Check, ...]
    r: Array
    value: dict[str, Array]
    slope: dict[str, Array]


RULES = ("pbrfit", "paper's rule, float64", "the same, float32")


def band_errors(effort: Effort) -> BandErrors:
    """h_l(r) and dh_l/dr over [0, 1] against 150-digit arithmetic."""
    exact = exact_bands(_roughness_grid(effort.band_points))
    r = exact.r
    found = {
        RULES[0]: ggx_band_weights(r),
        RULES[1]: paper_rule(r, np.float64),
        RULES[2]: paper_rule(r, np.float32),
    }
    value, slope = {}, {}
    checks = []
    for rule, (h, dh) in found.items():
        value[rule] = np.abs(exact.weight_errors(h))
        slope[rule] = np.abs(exact.slope_errors(dh))
    for key, errors, bound, why in (
        (
            "value",
            value,
            BAND_BOUND,
            "Weights are at most 4, whose float64 spacing is 9·10⁻¹⁶: a dozen roundings.",
        ),
        (
            "slope",
            slope,
            SLOPE_BOUND,
            "Slopes reach 10, and 25 terms of a series with its roundings make a few 10⁻¹⁴.",
        ),
    ):
        name = "h" if key == "value" else "dh/dr"
        worst, where = _worst_band(r, errors[RULES[0]])
        checks.append(Check(f"{key}_error", f"{name}, absolute error", worst, bound, why, where))
    checks.append(_relative_slope(exact, found[RULES[0]][1]))
    for key, name, errors in (("value", "h", value), ("slope", "dh/dr", slope)):
        for rule, short in zip(RULES[1:], ("paper_float64", "paper_float32"), strict=True):
            worst, where = _worst_band(r, errors[rule])
            checks.append(
                Check(
                    f"{short}_{key}_error",
                    f"for comparison, {rule}: {name}",
                    worst,
                    None,
                    "What the package would do if it took that rule.",
                    where + _failures(r, errors[rule]),
                )
            )
    return BandErrors(
        tuple(checks),
        r,
        {rule: errors.max(axis=-1) for rule, errors in value.items()},
        {rule: errors.max(axis=-1) for rule, errors in slope.items()},
    )


def _roughness_grid(count: int) -> Array:
    """All of [0, 1], denser towards 0, 0.4, 1 and the paper's switch."""
    part = count // 5
    steps = np.arange(-16, 17)
    near = 10.0 ** np.linspace(-17, -2, part // 2)
    switch = (1 - 1e-3) ** 0.25
    return np.unique(
        np.clip(
            np.concatenate(
                [
                    np.linspace(0, 1, 2 * part),
                    10.0 ** np.linspace(-12, -1, part),
                    10.0 ** np.linspace(-323, -12, part // 2),
                    [0, 5e-324, 2.2250738585072014e-308, 1e-300, 1e-81, 1e-80, 1.0],
                    BRANCH + near,
                    BRANCH - near,
                    BRANCH + np.spacing(BRANCH) * steps,
                    1 - 10.0 ** np.linspace(-17, -1, part),
                    1 - np.spacing(0.5) * np.abs(steps),
                    switch + 0.1 * near,
                    switch - 0.1 * near,
                ]
            ),
            0,
            1,
        )
    )


def _worst_band(r: Array, errors: Array) -> tuple[float, str]:
    """Largest finite error and where."""
    finite = np.where(np.isfinite(errors), errors, -1.0)
    point, band = np.unravel_index(np.argmax(finite), finite.shape)
    return float(finite[point, band]), f"h_{band} at r = {r[point]:.6g}"


def _failures(r: Array, errors: Array) -> str:
    failed = r[~np.isfinite(errors).all(axis=-1)]
    return f"; no number up to r = {failed.max():.1e}" if failed.size else ""


def _relative_slope(exact: ExactBands, dh: NDArray[np.floating[Any]]) -> Check:
    """Near r = 0 slopes fall like r³, so that an absolute bound says nothing."""
    below = (exact.r < BRANCH) & (np.abs(exact.slope).min(axis=-1) > 1e-300)
    relative = np.abs(exact.slope_errors(dh)[below] / exact.slope[below])
    point, band = np.unravel_index(np.argmax(relative), relative.shape)
    return Check(
        "slope_relative_error",
        "dh/dr for r < 0.4, relative error",
        float(relative[point, band]),
        SLOPE_RELATIVE_BOUND,
        "Terms of one sign and a logarithm: some ten roundings of 10⁻¹⁶ each, though slopes fall "
        "like r³.",
        f"h_{band} at r = {exact.r[below][point]:.6g}",
    )


# 2. The fast objective against float64


@dataclass(frozen=True, eq=False)
class KernelErrors:
    """Errors of loss and gradient by kind of pixel.

    `of_sum` are relative to the loss, or to the norm of a block of the gradient; `of_entry` is the
    worst entry relative to its natural scale. Both: quantity to one figure a kind.
    """

    checks: tuple[Check, ...]
    kinds: tuple[str, ...]
    pixels: int
    of_sum: dict[str, list[float]]
    of_entry: dict[str, list[float]]


QUANTITIES = ("loss", "albedo", "roughness", "metallic", "lights")


def kernel_errors(effort: Effort, rng: Generator, threads: int) -> KernelErrors:
    """Loss and gradient of random and extreme pixels against the float64 path."""
    of_sum: dict[str, list[float]] = {name: [] for name in QUANTITIES}
    of_entry: dict[str, list[float]] = {name: [] for name in QUANTITIES}
    pixels = 0
    for kind in (*KINDS, MANY_PICTURES):
        count, pictures = effort.pixels_of_a_kind, effort.pictures
        if kind is MANY_PICTURES:
            count, pictures = count // 32, pictures * 32
        case = make_case(rng, kind, count, pictures)
        pixels += count
        for name, whole, entry in _compare(case, threads):
            of_sum[name].append(whole)
            of_entry[name].append(entry)
    kinds = tuple(kind.name for kind in (*KINDS, MANY_PICTURES))

    def check(key: str, what: str, figures: list[float], bound: float, why: str) -> Check:
        worst = int(np.argmax(figures))
        return Check(key, what, figures[worst], bound, why, kinds[worst])

    checks = [
        check(
            "loss_error",
            "loss, relative error",
            of_sum["loss"],
            LOSS_BOUND,
            "8 u; single residuals are off by a few u of the signal, at random, and residuals are "
            "as large as the signal here.",
        )
    ]
    for name in QUANTITIES[1:]:
        checks.append(
            check(
                f"{name}_block_error",
                f"gradient by {name}: error over norm of the block",
                of_sum[name],
                BLOCK_BOUND,
                "17 u; rounding of some 60 operations a number adds up at random to about √60 u, "
                "twice that where terms cancel.",
            )
        )
    for name in QUANTITIES[1:]:
        bound = LIGHT_ENTRY_BOUND if name == "lights" else ENTRY_BOUND
        why = (
            "8 u; sums over very many pixels, in which roundings average out."
            if name == "lights"
            else "34 u; the worst of millions, still below the 60 u or more that so many "
            "operations could add up to."
        )
        checks.append(
            check(
                f"{name}_entry_error",
                f"gradient by {name}: worst entry over its natural scale",
                of_entry[name],
                bound,
                why,
            )
        )
    return KernelErrors(tuple(checks), kinds, pixels, of_sum, of_entry)


def _compare(case: Case, threads: int) -> list[tuple[str, float, float]]:
    """Quantity, error relative to the whole, worst error relative to natural scale."""
    loss, gradient = case.problem(threads).value_and_grad(case.x)
    truth = evaluate(case)
    error = abs(loss - truth.loss)
    found = [("loss", _ratio(error, truth.loss), _ratio(error, truth.loss_scale))]
    for name, block in case.blocks().items():
        errors = gradient[block] - truth.gradient[block]
        whole = _ratio(float(np.linalg.norm(errors)), float(np.linalg.norm(truth.gradient[block])))
        found.append((name, whole, _worst_entry(errors, truth.gradient_scale[block])))
    return found


def _ratio(error: float, size: float) -> float:
    """Error relative to a size, where nothing is allowed of nothing."""
    if error == 0:
        return 0.0
    return error / size if size else math.inf


def _worst_entry(errors: Array, scale: Array) -> float:
    errors = np.abs(errors)
    relative = np.divide(errors, scale, out=np.full_like(errors, np.inf), where=scale > 0)
    relative[(errors == 0) & (scale == 0)] = 0
    return float(relative.max())


# 3. Branch points


@dataclass(frozen=True, eq=False)
class Scan:
    """Float32 noise of the objective while all pixels cross a branch point together.

    `loss` is relative to the loss; `gradient` that of the derivative by roughness along the sweep,
    relative to its natural scale.
    """

    branch: str
    offset: Array
    loss: Array
    gradient: Array


@dataclass(frozen=True, eq=False)
class BranchPoints:
    """Jumps at branch points against the width of the step, and noise across them."""

    checks: tuple[Check, ...]
    steps: Array
    jumps: dict[str, Array]
    scans: tuple[Scan, ...]


STEPS = 10.0 ** np.arange(-15.0, -5.5, 0.5)
SCAN_STEPS = (1e-9, 1e-8, 1e-7, 1e-6)
DRAWN_STEP = 1e-8
DIFFERENCE_STEP = 1e-4


def branch_points(effort: Effort, rng: Generator, threads: int) -> BranchPoints:
    """Sweeps across r = 0, 0.4 and 1, and across the clamp of n·v at 10⁻⁴."""
    sweeps = _sweeps(effort.branch_pixels, rng)
    checks, jumps = _band_jumps()
    more_checks, more_jumps = _shading_jumps(sweeps, rng)
    checks += more_checks
    checks += _differences(sweeps, threads)
    noise = [
        _scan(sweep, step, effort.scan_points, threads) for sweep in sweeps for step in SCAN_STEPS
    ]
    checks += _noise_checks(noise)
    drawn = tuple(scan for scan, step in noise if step == DRAWN_STEP)
    return BranchPoints(tuple(checks), STEPS, jumps | more_jumps, drawn)


@dataclass(frozen=True, eq=False)
class _Sweep:
    """Pixels that cross a branch point together; offsets outside [low, high] leave the model."""

    branch: str
    case: Case
    at: Callable[[float], Pixels]
    low: float
    high: float
    in_roughness: bool

    def moved(self, offset: float) -> Case:
        return replace(self.case, pixels=self.at(offset))

    def center(self, reach: float) -> float:
        """The offset nearest the branch point with room for `reach` on both sides."""
        return min(max(0.0, self.low + reach), self.high - reach)


def _sweeps(count: int, rng: Generator) -> list[_Sweep]:
    pixels = random_pixels(rng, count)
    case = Case(pixels, random_lights(rng, 4), random_targets(rng, 4, count))

    def at_roughness(branch: float) -> Callable[[float], Pixels]:
        return lambda offset: replace(pixels, roughness=np.full(count, branch + offset))

    across = np.cross(pixels.views, rng.normal(size=(count, 3)))
    across /= np.linalg.norm(across, axis=-1, keepdims=True)

    def at_cosine(offset: float) -> Pixels:
        cosine = CLAMP + offset
        return replace(
            pixels, normals=cosine * pixels.views + math.sqrt(1 - cosine * cosine) * across
        )

    return [
        _Sweep("r = 0", case, at_roughness(0.0), 0.0, 1.0, True),
        _Sweep("r = 0.4", case, at_roughness(BRANCH), -BRANCH, 1 - BRANCH, True),
        _Sweep("r = 1", case, at_roughness(1.0), -1.0, 0.0, True),
        _Sweep("n·v = 10⁻⁴", case, at_cosine, -1.0, 1 - CLAMP, False),
    ]


def _band_jumps() -> tuple[list[Check], dict[str, Array]]:
    """Jump of the bands' error across 0.4: what they jump beyond what they should."""
    above, below = exact_bands(BRANCH + STEPS), exact_bands(BRANCH - STEPS)
    (h_above, dh_above), (h_below, dh_below) = (ggx_band_weights(b.r) for b in (above, below))
    value = np.abs(above.weight_errors(h_above) - below.weight_errors(h_below)).max(axis=-1)
    slope = np.abs(above.slope_errors(dh_above) - below.slope_errors(dh_below)).max(axis=-1)
    checks = [
        Check(
            "band_jump",
            "h across r = 0.4, jump beyond the true change",
            float(value.max()),
            2 * BAND_BOUND,
            "Twice the bound on the error, one for each side.",
            f"step {STEPS[np.argmax(value)]:.0e}",
        ),
        Check(
            "band_slope_jump",
            "dh/dr across r = 0.4, jump beyond the true change",
            float(slope.max()),
            2 * SLOPE_BOUND,
            "Twice the bound on the error, one for each side.",
            f"step {STEPS[np.argmax(slope)]:.0e}",
        ),
    ]
    return checks, {"h at r = 0.4": value, "dh/dr at r = 0.4": slope}


def _shading_jumps(sweeps: list[_Sweep], rng: Generator) -> tuple[list[Check], dict[str, Array]]:
    """Jumps of a random combination of the weights, pixel by pixel, relative to its terms."""
    jumps = {}
    cotangent = rng.normal(size=(len(sweeps[0].case.pixels), 3, 16))
    for sweep in sweeps:
        rows = []
        for step in STEPS:
            center = sweep.center(step)
            before, after = (sweep.at(center - step), sweep.at(center + step))
            low, high = before.shade(), after.shade()
            change = np.sum(cotangent * (high - low), axis=(-2, -1))
            if sweep.in_roughness:
                # A smooth function changes by the mean of its slopes times the way, up to step³.
                change -= step * (_slope(before, cotangent) + _slope(after, cotangent))
            rows.append(np.max(np.abs(change) / np.sum(np.abs(cotangent * high), axis=(-2, -1))))
        jumps[f"weights at {sweep.branch}"] = np.array(rows)
    smooth = [name for name in jumps if "n·v" not in name]
    worst = max(smooth, key=lambda name: jumps[name].max())
    at_clamp = jumps["weights at n·v = 10⁻⁴"]
    checks = [
        Check(
            "weight_jump",
            "float64 weights across r = 0, 0.4, 1: change less slope times step",
            float(jumps[worst].max()),
            BAND_BOUND,
            "No jump beyond the bands' own errors, relative to the sum of the terms' sizes.",
            worst,
        ),
        Check(
            "clamp_jump",
            f"float64 weights across n·v = 10⁻⁴, from {STEPS[0]:.0e} below to as much above",
            float(at_clamp[0]),
            2e-11,
            "Weights may go with the clamped cosine, of which the step is 10⁻¹¹ and the rounding "
            "of n·v some 10⁻¹²; a jump would stay as the step shrinks.",
            "relative to the sum of the terms' sizes",
        ),
    ]
    return checks, jumps


def _slope(pixels: Pixels, cotangent: Array) -> Array:
    p = pixels
    return shade_vjp(p.normals, p.views, p.albedo, p.roughness, p.metallic, cotangent)[1]


def _differences(sweeps: list[_Sweep], threads: int) -> list[Check]:
    """Slope of the objective by all roughnesses at once against central differences in float64."""
    exact, fast = {}, {}
    for sweep in sweeps:
        if not sweep.in_roughness:
            continue
        h = DIFFERENCE_STEP
        center = sweep.center(2 * h)
        losses = [evaluate(sweep.moved(center + k * h)).loss for k in (-2, -1, 1, 2)]
        difference = (losses[0] - 8 * losses[1] + 8 * losses[2] - losses[3]) / (12 * h)
        case = sweep.moved(center)
        block = case.blocks()["roughness"]
        truth = evaluate(case)
        gradient = case.problem(threads).value_and_grad(case.x)[1]
        size = truth.loss + float(np.sum(truth.gradient_scale[block]))
        exact[sweep.branch] = abs(float(truth.gradient[block].sum()) - difference) / size
        fast[sweep.branch] = abs(float(gradient[block].sum()) - difference) / size
    worst_exact, worst_fast = max(exact, key=exact.__getitem__), max(fast, key=fast.__getitem__)
    return [
        Check(
            "slope_against_difference",
            "analytic slope, float64, against a central difference",
            exact[worst_exact],
            1e-10,
            "Fourth-order difference with step 10⁻⁴: truncation and rounding both stay near "
            "10⁻¹², relative to the loss and the natural scale of the slope.",
            worst_exact,
        ),
        Check(
            "fast_slope_against_difference",
            "analytic slope, fast objective, against the same difference",
            fast[worst_fast],
            LOSS_BOUND,
            "8 u, as for the loss.",
            worst_fast,
        ),
    ]


def _scan(sweep: _Sweep, step: float, points: int, threads: int) -> tuple[Scan, float]:
    """Fast minus float64 along a sweep of equal steps."""
    half = points // 2
    offsets: Array = sweep.center(half * step) + step * np.arange(-half, half + 1.0)
    loss, gradient = [], []
    problem = sweep.case.problem(threads)
    block = sweep.case.blocks()["roughness"]
    for offset in offsets:
        case = sweep.moved(float(np.clip(offset, sweep.low, sweep.high)))
        if not sweep.in_roughness:
            problem = case.problem(threads)
        found, slope = problem.value_and_grad(case.x)
        truth = evaluate(case)
        loss.append((found - truth.loss) / truth.loss)
        scale = float(truth.gradient_scale[block].sum())
        error = float(slope[block].sum() - truth.gradient[block].sum())
        gradient.append(math.copysign(_ratio(abs(error), scale), error))
    return Scan(sweep.branch, offsets, np.array(loss), np.array(gradient)), step


def _noise_checks(noise: list[tuple[Scan, float]]) -> list[Check]:
    checks = []
    for key, what, series in (
        ("loss", "noise of the loss, relative", [scan.loss for scan, _ in noise]),
        (
            "gradient",
            "noise of the slope by roughness, of its natural scale",
            [scan.gradient for scan, _ in noise],
        ),
    ):
        level = [float(np.max(np.abs(values))) for values in series]
        jump = [float(np.max(np.abs(np.diff(values)))) for values in series]
        for name, figures, text in (
            ("noise", level, f"fast objective, {what}"),
            ("jump", jump, f"fast objective, {what}: largest change from step to step"),
        ):
            worst = int(np.argmax(figures))
            scan, step = noise[worst]
            checks.append(
                Check(
                    f"fast_{key}_{name}",
                    text,
                    figures[worst],
                    LOSS_BOUND,
                    "8 u, as away from branch points; float32 makes the objective a staircase "
                    "whose steps no smaller change of x can resolve.",
                    f"{scan.branch}, steps of {step:.0e}",
                )
            )
    return checks


# 4. Cancellation in the loss


@dataclass(frozen=True, eq=False)
class Cancellation:
    """Fast objective near a perfect fit.

    Attributes
    ----------
    residual
        True root mean square residual relative to that of the signal, by form of the residuals.
    reported
        What the fast loss says it is.
    gradient_error
        Error of the whole gradient over its norm, materials and lights apart.
    """

    checks: tuple[Check, ...]
    residual: dict[str, Array]
    reported: dict[str, Array]
    gradient_error: dict[str, Array]


RESIDUALS = 10.0 ** -np.arange(1.0, 9.25, 0.5)
MEANINGFUL = 0.1
"""The loss means something while it is off by less than this fraction."""


def cancellation(effort: Effort, rng: Generator, threads: int) -> Cancellation:
    """Pictures that differ from the rendered ones by 10⁻¹ to 10⁻⁹ of the signal."""
    pixels = random_pixels(rng, effort.residual_pixels)
    lighting = random_lights(rng, effort.pictures)
    signal = pixels.render(lighting, threads)
    size = math.sqrt(float(np.mean(signal**2)))
    residual: dict[str, Array] = {}
    reported: dict[str, Array] = {}
    gradient_error: dict[str, Array] = {}
    for form, noise in (
        (RANDOM, rng.normal(size=signal.shape)),
        (ONE_SIGN, np.ones(signal.shape)),
    ):
        true, found = [], []
        errors: dict[str, list[float]] = {"materials": [], "lights": []}
        for level in RESIDUALS:
            case = Case(pixels, lighting, (signal * (1 + level * noise)).astype(np.float32))
            loss, gradient = case.problem(threads).value_and_grad(case.x)
            truth = evaluate(case)
            true.append(math.sqrt(truth.loss) / size)
            found.append(math.sqrt(loss) / size)
            lights = case.blocks()["lights"]
            for name, block in (("materials", slice(lights.start)), ("lights", lights)):
                error = np.linalg.norm(gradient[block] - truth.gradient[block])
                errors[name].append(float(error / np.linalg.norm(truth.gradient[block])))
        residual[form], reported[form] = np.array(true), np.array(found)
        for name, values in errors.items():
            gradient_error[f"{name}, {form}"] = np.array(values)
    checks = _cancellation_checks(residual, reported, gradient_error)
    return Cancellation(tuple(checks), residual, reported, gradient_error)


def _cancellation_checks(
    residual: dict[str, Array],
    reported: dict[str, Array],
    gradient_error: dict[str, Array],
) -> list[Check]:
    gaps = {form: float(np.max(np.abs(reported[form] - residual[form]))) for form in residual}
    widest = max(gaps, key=gaps.__getitem__)
    relative = {form: np.abs((reported[form] / residual[form]) ** 2 - 1) for form in residual}

    def at(level: float) -> tuple[float, str]:
        index = int(np.argmin(np.abs(RESIDUALS - level)))
        form = max(relative, key=lambda name: relative[name][index])
        return float(relative[form][index]), form

    lost = {
        form: max(
            (r for r, off in zip(residual[form], relative[form], strict=True) if off > MEANINGFUL),
            default=0.0,
        )
        for form in residual
    }
    last = max(lost, key=lost.__getitem__)
    at_seventh = int(np.argmin(np.abs(RESIDUALS - 1e-7)))
    at_third = int(np.argmin(np.abs(RESIDUALS - 1e-3)))
    gradient = {name: float(values[at_third]) for name, values in gradient_error.items()}
    averaged = gradient.pop(f"lights, {RANDOM}")
    worst_gradient = max(gradient, key=gradient.__getitem__)
    return [
        Check(
            "residual_floor",
            "reported less true residual, as RMS over the signal's RMS",
            gaps[widest],
            5e-7,
            "8 u: rounding adds to the residuals a few u of the terms, and the triangle "
            "inequality turns that into this.",
            widest,
        ),
        Check(
            "loss_error_at_1e-5",
            "loss at residuals of 10⁻⁵, relative error",
            at(1e-5)[0],
            0.02,
            "Residuals of 10⁻⁵ are off by some 10⁻⁷, one part in a hundred; the loss by twice that "
            "if all are off the same way.",
            at(1e-5)[1],
        ),
        Check(
            "loss_lost_at",
            "largest residual at which the loss is off by 10 %",
            lost[last],
            3e-6,
            "10 % of the square is 5 % of the residual, and a floor of a few u is that below 10⁻⁶.",
            last,
        ),
        Check(
            "reported_at_1e-7",
            "residual reported at a true one of 10⁻⁷",
            float(max(values[at_seventh] for values in reported.values())),
            6e-7,
            "The residual itself and the floor.",
            max(reported, key=lambda form: reported[form][at_seventh]),
        ),
        Check(
            "gradient_error_at_1e-3",
            "gradient at residuals of 10⁻³, error over norm of the block",
            gradient[worst_gradient],
            1e-3,
            "Residuals of 10⁻³ carry an error of about 10⁻⁷, 10⁻⁴ of them; terms cancel in the "
            "sum over pictures, which may cost another factor of ten.",
            worst_gradient,
        ),
        Check(
            "lights_gradient_error_random_at_1e-3",
            f"gradient by lights at residuals of 10⁻³ with {RANDOM}",
            averaged,
            None,
            "No bound: random residuals average out over the pixels, the rounding of a light, "
            "which is the same in all of them, does not. So it grows with the root of their "
            "number.",
        ),
    ]


# 5. Accumulated error


@dataclass(frozen=True, eq=False)
class Accumulation:
    """Errors of the sums over all samples against their number, by form of the residuals.

    Attributes
    ----------
    samples
        Pixels times pictures.
    loss
        Relative error of the loss.
    lights
        Worst error of the gradient by the lights, relative to the sum of its terms' sizes.
    naive
        Relative error of the loss when all squares are added up one by one in float32.
    """

    checks: tuple[Check, ...]
    samples: NDArray[np.int64]
    loss: dict[str, Array]
    lights: dict[str, Array]
    naive: dict[str, Array]


RANDOM, ONE_SIGN, ALIKE = FORMS = ("random signs", "one sign", "one sign, all pixels alike")

EQUAL_TERMS_BOUND = 256 * ROUNDING
EQUAL_TERMS_MANY_BOUND = 1024 * ROUNDING

FEW_PIXELS = 1024
MANY = 256
"""Pixels and pictures of the problems in which equal terms are looked for a bad value."""


def accumulation(effort: Effort, rng: Generator, threads: int) -> Accumulation:
    """Loss and light gradients of up to 16 million samples against exact sums."""
    samples = np.array([pixels * effort.summed_pictures for pixels in effort.summed_pixels])
    loss: dict[str, list[float]] = {form: [] for form in FORMS}
    lights: dict[str, list[float]] = {form: [] for form in FORMS}
    naive: dict[str, list[float]] = {form: [] for form in FORMS}
    for form in FORMS:
        for pixels in effort.summed_pixels:
            case = _summed_case(form, pixels, effort.summed_pictures, rng, threads)
            of_loss, of_lights, truth = _sum_errors(case, threads)
            loss[form].append(of_loss)
            lights[form].append(of_lights)
            naive[form].append(_naive_error(case, truth, threads))
    bounds = {
        ("loss", RANDOM): (LOSS_BOUND, "8 u, as for few samples: float64 takes over early."),
        ("loss", ONE_SIGN): (
            ENTRY_BOUND,
            "34 u; residuals are 3/10 of the signal here, and the rounding of a light is the same "
            "in all pixels: a few u of the signal are three times as many of the residual, and "
            "twice that in its square.",
        ),
        ("lights", RANDOM): (ENTRY_BOUND, "34 u, as for the entries of the gradient."),
        ("lights", ONE_SIGN): (ENTRY_BOUND, "34 u, as for the entries of the gradient."),
    }
    checks = []
    for quantity, what, figures in (
        ("loss", "loss, relative error", loss),
        ("lights", "gradient by lights: worst entry over its terms", lights),
    ):
        for form, short in ((RANDOM, "random"), (ONE_SIGN, "one_sign")):
            worst = int(np.argmax(figures[form]))
            bound, why = bounds[quantity, form]
            checks.append(
                Check(
                    f"{quantity}_error_{short}",
                    f"{what}, {form}",
                    figures[form][worst],
                    bound,
                    why,
                    f"{samples[worst]:,} samples",
                )
            )
    checks += _equal_terms(effort, rng, threads, max(loss[ALIKE]), max(lights[ALIKE]))
    pixels, pictures = effort.summed_many
    errors = _sum_errors(_summed_case(RANDOM, pixels, pictures, rng, threads), threads)
    checks.append(
        Check(
            "error_many_pictures",
            f"loss and lights, {RANDOM}, {pictures} pictures of {pixels:,} pixels",
            max(errors[:2]),
            ENTRY_BOUND,
            "34 u, however samples are divided into pixels and pictures.",
            "loss" if errors[0] > errors[1] else "lights",
        )
    )
    return Accumulation(
        tuple(checks),
        samples,
        {form: np.array(values) for form, values in loss.items()},
        {form: np.array(values) for form, values in lights.items()},
        {form: np.array(values) for form, values in naive.items()},
    )


def _equal_terms(
    effort: Effort, rng: Generator, threads: int, of_loss: float, of_lights: float
) -> list[Check]:
    """The worst of many values for terms that are all equal."""
    many = 0.0
    for _ in range(effort.draws):
        case = _summed_case(ALIKE, FEW_PIXELS, effort.summed_pictures, rng, threads)
        loss, lights, _ = _sum_errors(case, threads)
        of_loss, of_lights = max(of_loss, loss), max(of_lights, lights)
        case = _summed_case(ALIKE, FEW_PIXELS, MANY, rng, threads)
        loss, lights, _ = _sum_errors(case, threads)
        many, of_lights = max(many, loss), max(of_lights, lights)
    why = (
        "256 u; equal terms round equally. A float32 sum of n equal terms is off by up to n/4 u, "
        "and blocks hold up to a thousand."
    )
    where = f"{effort.draws} draws"
    return [
        Check(
            "loss_error_equal",
            f"loss, relative error, {ALIKE}, {effort.summed_pictures} pictures",
            of_loss,
            EQUAL_TERMS_BOUND,
            why,
            where,
        ),
        Check(
            "loss_error_equal_many",
            f"loss, relative error, {ALIKE}, {MANY} pictures",
            many,
            EQUAL_TERMS_MANY_BOUND,
            "1024 u; where a block's sum of squares runs over its pictures too, it may have 4096 "
            "equal terms.",
            where,
        ),
        Check(
            "lights_error_equal",
            f"gradient by lights: worst entry over its terms, {ALIKE}",
            of_lights,
            EQUAL_TERMS_BOUND,
            why,
            where,
        ),
    ]


def _sum_errors(case: Case, threads: int) -> tuple[float, float, float]:
    """Error of the loss, of the gradient by lights, and the true loss."""
    found, gradient = case.problem(threads).value_and_grad(case.x)
    truth = sums(case)
    errors = gradient[case.blocks()["lights"]] - truth.by_lights
    return (
        abs(found - truth.loss) / truth.loss,
        _worst_entry(errors, truth.by_lights_scale),
        truth.loss,
    )


def _summed_case(form: str, count: int, pictures: int, rng: Generator, threads: int) -> Case:
    pixels = random_pixels(rng, count)
    lighting = random_lights(rng, pictures, variation=0.5 if form == RANDOM else 0.1)
    if form == RANDOM:
        return Case(pixels, lighting, random_targets(rng, pictures, count))
    if form == ALIKE:
        pixels = pixels[np.zeros(count, dtype=np.intp)]
        lighting = np.repeat(lighting[:1], pictures, axis=0)
    images = np.empty((pictures, count, 3), dtype=np.float32)
    step = 16384
    for start in range(0, count, step):
        rows = slice(start, start + step)
        images[:, rows] = 0.7 * pixels[rows].render(lighting, threads)
    return Case(pixels, lighting, images)


def _naive_error(case: Case, loss: float, threads: int) -> float:
    """Error of a float32 running sum of the squared residuals."""
    total = np.float32(0)
    step = 65536
    for start in range(0, len(case.pixels), step):
        rows = slice(start, start + step)
        residual = case.pixels[rows].render(case.lighting, threads) - case.images[:, rows]
        squares = np.square(residual.astype(np.float32)).ravel()
        # numpy's sums are pairwise, its running sums are not.
        total = np.cumsum(np.concatenate([[total], squares]), dtype=np.float32)[-1]
    return abs(float(total) / case.images.size - loss) / loss


# 6. Tiny numbers


@dataclass(frozen=True, eq=False)
class TinyNumbers:
    """Subnormal inputs, and the loss over the range of exposures.

    Attributes
    ----------
    exposure
        Factor on lights and pictures.
    loss_error
        Relative error of the loss at that exposure.
    """

    checks: tuple[Check, ...]
    exposure: Array
    loss_error: Array


EXPOSURES = 10.0 ** np.arange(-30.0, 18.5, 1.0)
BOUNDED = np.abs(np.log10(EXPOSURES)) < 15.5
"""Exposures from 1e-15 to 1e15, at which the loss has to be right."""


def tiny_numbers(effort: Effort, rng: Generator, threads: int) -> TinyNumbers:
    """Radiance, lights, roughness, albedo and metallic in the subnormal ranges."""
    count, pictures = effort.subnormal_pixels, effort.pictures
    plain = Case(
        random_pixels(rng, count),
        random_lights(rng, pictures),
        random_targets(rng, pictures, count),
    )
    p = plain.pixels
    tiny64, tiny32 = (10.0 ** rng.uniform(*span, count) for span in ((-323, -308), (-45, -38)))
    subnormal = Case(p, 1e-40 * plain.lighting, (1e-40 * plain.images).astype(np.float32))
    black = np.zeros_like(plain.images)
    tiny_r = replace(plain, pixels=replace(p, roughness=tiny64))
    cases = {
        "radiance and lights of 10⁻⁴⁰": subnormal,
        "lights of 10⁻³¹⁰, black pictures": Case(p, 1e-310 * plain.lighting, black),
        "roughness of 10⁻³²³ to 10⁻³⁰⁸": tiny_r,
        "roughness of 10⁻⁴⁵ to 10⁻³⁸": replace(plain, pixels=replace(p, roughness=tiny32)),
        "albedo and metallic of 10⁻³²³ to 10⁻³⁰⁸": replace(
            plain, pixels=replace(p, albedo=np.stack([tiny64] * 3, axis=-1), metallic=tiny64)
        ),
        "no light, black pictures": Case(p, np.zeros_like(plain.lighting), black),
        "no light": replace(plain, lighting=np.zeros_like(plain.lighting)),
    }
    results = {
        name: (case, *case.problem(threads).value_and_grad(case.x)) for name, case in cases.items()
    }
    infinite = {
        name: int(np.count_nonzero(~np.isfinite(gradient)) + (not math.isfinite(loss)))
        for name, (_, loss, gradient) in results.items()
    }
    errors = {name: _absolute(*result) for name, result in results.items()}
    worst_error = max(errors, key=errors.__getitem__)

    def nonzero(name: str, block: str | None = None) -> int:
        case, loss, gradient = results[name]
        entries = gradient if block is None else gradient[case.blocks()[block]]
        return int(np.count_nonzero(entries)) + (block is None and loss != 0)

    materials = [
        nonzero("no light", block) for block in ("albedo", "roughness", "metallic")
    ]  # no light: nothing depends on the material
    zeros = {
        "all of it, no light and black pictures": nonzero("no light, black pictures"),
        "materials, no light": sum(materials),
        "materials, lights of 10⁻³¹⁰": sum(
            nonzero("lights of 10⁻³¹⁰, black pictures", block)
            for block in ("albedo", "roughness", "metallic")
        ),
        "roughness, roughness of 10⁻³²³ to 10⁻³⁰⁸": nonzero(
            "roughness of 10⁻³²³ to 10⁻³⁰⁸", "roughness"
        ),
    }
    worst_zero = max(zeros, key=zeros.__getitem__)
    mirror = replace(plain, pixels=replace(p, roughness=np.zeros(count)))
    loss, gradient = mirror.problem(threads).value_and_grad(mirror.x)
    _, tiny_loss, tiny_gradient = results["roughness of 10⁻³²³ to 10⁻³⁰⁸"]
    differing = int(np.count_nonzero(gradient != tiny_gradient)) + (loss != tiny_loss)
    exposure_error = np.array([_exposed(plain, factor, threads) for factor in EXPOSURES])
    worst_exposure = int(np.argmax(np.where(BOUNDED, exposure_error, -1)))
    slower = {
        "radiance and lights of 10⁻⁴⁰": _time_ratio(subnormal, plain, threads),
        "roughness of 10⁻³²³ to 10⁻³⁰⁸": _time_ratio(tiny_r, plain, threads),
    }
    slowest = max(slower, key=slower.__getitem__)
    checks = (
        Check(
            "not_finite",
            "results that are infinite or not a number",
            sum(infinite.values()),
            0,
            "Every input is finite and small.",
            f"{len(cases)} cases",
        ),
        Check(
            "entry_error",
            "worst entry, error over natural scale + 10⁻³⁸",
            errors[worst_error],
            ENTRY_BOUND,
            "As for other pixels, but below 1.2·10⁻³⁸, the smallest normal float32, an error of "
            "that size times the same bound is allowed.",
            worst_error,
        ),
        Check(
            "nonzero",
            "entries of the gradient that should be 0 and are not",
            sum(zeros.values()),
            0,
            "Nothing depends on materials without light, and r³ underflows for r below 10⁻¹⁰⁸.",
            worst_zero if zeros[worst_zero] else f"{len(zeros)} cases",
        ),
        Check(
            "differs_from_mirror",
            "numbers that differ between r = 0 and subnormal r",
            differing,
            0,
            "r⁴ underflows, so the two are the same surface to the last bit.",
            f"{len(gradient) + 1:,} compared",
        ),
        Check(
            "exposure_error",
            "loss for exposures from 10⁻¹⁵ to 10¹⁵, relative error",
            float(exposure_error[worst_exposure]),
            LOSS_BOUND,
            "8 u, as at exposure 1: squares of 10⁻¹⁵ and 10¹⁵ lie well inside float32's range.",
            f"exposure {EXPOSURES[worst_exposure]:.0e}",
        ),
        Check(
            "time_ratio",
            "time of an evaluation over that with ordinary numbers",
            slower[slowest],
            None,
            "Some processors take a hundred cycles for a subnormal operand; a clock decides no "
            "verdict.",
            slowest,
        ),
    )
    return TinyNumbers(checks, EXPOSURES, exposure_error)


def _absolute(case: Case, loss: float, gradient: Array) -> float:
    """Worst error over natural scale plus the smallest normal float32."""
    truth = evaluate(case)
    return max(
        abs(loss - truth.loss) / (truth.loss_scale + SMALLEST_NORMAL),
        float(np.max(np.abs(gradient - truth.gradient) / (truth.gradient_scale + SMALLEST_NORMAL))),
    )


def _exposed(case: Case, factor: float, threads: int) -> float:
    """Relative error of the loss with lights and pictures times a factor."""
    few = slice(0, 512)
    exposed = Case(
        case.pixels[few],
        factor * case.lighting,
        (factor * case.images[:, few]).astype(np.float32),
    )
    loss, _ = exposed.problem(threads).value_and_grad(exposed.x)
    truth = evaluate(exposed).loss
    return abs(loss - truth) / truth


def _time_ratio(case: Case, plain: Case, threads: int) -> float:
    """Best time of one over best time of the other, taken in turns."""
    runs = [(c.problem(threads), c.x) for c in (case, plain)]
    best = [math.inf, math.inf]
    for _ in range(7):
        for i, (problem, x) in enumerate(runs):
            start = time.perf_counter()
            problem.value_and_grad(x)
            best[i] = min(best[i], time.perf_counter() - start)
    return best[0] / best[1]


# 7. Determinism


@dataclass(frozen=True, eq=False)
class Determinism:
    """Differences between evaluations of one problem."""

    checks: tuple[Check, ...]
    evaluations: int


THREADS = (1, 2, 3, 8)
REPEATS = 3


def determinism(effort: Effort, rng: Generator) -> Determinism:
    """Every bit of loss and gradient at different numbers of threads, and again and again."""
    between_threads = between_calls = evaluations = 0
    sizes = []
    for count, pictures in effort.repeated:
        case = Case(
            random_pixels(rng, count),
            random_lights(rng, pictures),
            random_targets(rng, pictures, count),
        )
        first = _bits(case.problem(THREADS[0]), case.x)
        for threads in THREADS:
            problem = case.problem(threads)
            calls = [_bits(problem, case.x) for _ in range(REPEATS)]
            evaluations += len(calls)
            between_threads += int(np.count_nonzero(calls[0] != first))
            between_calls += sum(int(np.count_nonzero(bits != calls[0])) for bits in calls[1:])
        sizes.append(f"{count} × {pictures}")
    where = "pixels × pictures: " + ", ".join(sizes)
    checks = (
        Check(
            "differs_between_threads",
            f"numbers that differ between {', '.join(map(str, THREADS))} threads",
            between_threads,
            0,
            "Sums are taken in an order that does not depend on the threads, to the last bit.",
            where,
        ),
        Check(
            "differs_between_calls",
            f"numbers that differ between {REPEATS} calls",
            between_calls,
            0,
            "An evaluation depends on its input alone.",
            where,
        ),
    )
    return Determinism(checks, evaluations)


def _bits(problem: _core.Problem, x: Array) -> NDArray[np.uint64]:
    loss, gradient = problem.value_and_grad(x)
    return np.concatenate([[loss], gradient]).view(np.uint64)
