"""The stability suite as files: page, plots, summary."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from pbrfit.report.notation import percent, scientific
from pbrfit_evaluation import page, summary
from pbrfit_evaluation.page import Cell, Section, Table
from pbrfit_evaluation.stability import SECTIONS, Check, Stability, plots
from pbrfit_evaluation.stability.exact_bands import DIGITS
from pbrfit_evaluation.stability.stiff_fits import MAPS, StiffFits

CONTAINS = (summary.FILE, page.FILE)
"""Files by which an output folder is known for one of this suite."""

PROTOCOL = "pbrfit-stability-1"
"""Under one name, with the same effort and seed, the same things are measured in the same way."""


def write(folder: Path, measured: Stability) -> None:
    """Write `report.html`, its plots and `summary.json` into an existing folder."""
    sections = _sections(measured)
    page.write_page(folder, "Numerical stability", _opening(measured), sections)
    rows = [
        summary.Row(name, scenes=0, solver=None, metrics=_metrics(checks))
        for name, checks in zip(SECTIONS, measured.by_section, strict=True)
    ]
    summary.write_summary(folder, f"{PROTOCOL}, {measured.effort.name}", rows)


def _metrics(checks: Sequence[Check]) -> dict[str, float | None]:
    """Figures, their bounds, and how many fail."""
    metrics: dict[str, float | None] = {}
    for check in checks:
        metrics[check.key] = check.worst
        if check.bound is not None:
            metrics[f"{check.key}_bound"] = check.bound
    metrics["failed"] = sum(not check.passed for check in checks)
    return metrics


def verdict(measured: Stability) -> str:
    """How many bounds hold, in words."""
    bounded = [check for check in measured.checks if check.bound is not None]
    failed = [check for check in bounded if not check.passed]
    if not failed:
        return f"all {len(bounded)} bounds hold"
    return f"{len(failed)} of {len(bounded)} bounds fail"


def _opening(measured: Stability) -> list[str]:
    on = summary.machine()
    return [
        f"{verdict(measured).capitalize()}.",
        "pbrfit computes what depends on a material alone in float64, and the products with "
        "lights and residuals, which are nearly all of the work, in float32. This page "
        "says how far the results are from exact ones, and where they stop meaning anything. "
        "Every figure is the worst of all that was tried; u = 2⁻²⁴ = 6·10⁻⁸ is the largest "
        "relative error of one rounding to float32.",
        f"pbrfit {version('pbrfit')}, effort “{measured.effort.name}”, seed {measured.seed}; "
        f"{on['processor']}, {on['cores']} cores, {on['system']}, Python {on['python']}, "
        f"numpy {on['numpy']}.",
    ]


def _sections(measured: Stability) -> list[Section]:
    m = measured
    return [
        Section(
            "1. Band weights",
            [
                "The GGX band weights h_l(r), l = 0 to 3, and their slopes dh_l/dr, in float64, "
                f"against the closed form with {DIGITS} digits at {len(m.bands.r):,} roughnesses "
                "over all of [0, 1], denser towards 0, the switch of the method at 0.4, and 1. "
                "Beside them what two other rules would have given: that of the paper whose model "
                "this is (closed form, and a Taylor series about r = 1 where 1 − r⁴ < 10⁻³) in "
                "float64, and the same in float32.",
            ],
            _table(m.bands.checks),
            [
                page.Figure(
                    "bands",
                    plots.draw_bands(m.bands),
                    "Largest error over the four bands. Left: towards r = 0, middle: all of "
                    "[0, 1], right: towards r = 1. Errors below 10⁻¹⁸, among them 0, lie on the "
                    "lower edge; a rule that gives no number at all has no line there, but a bar "
                    "at the top.",
                )
            ],
        ),
        Section(
            "2. Fast objective against float64",
            [
                f"Loss and gradient of {m.kernel.pixels / 1e6:.2g} million pixels, random and "
                "extreme, against the same objective in float64 throughout. Targets are random, so "
                "residuals are as large as the signal.",
                "Two measures. One compares the error with the result: of the loss with the loss, "
                "of a block of the gradient with the block's norm. The other compares each entry "
                "with its natural scale: the same sum with every term replaced by its size, every "
                "residual I − T by the sizes of the terms of I and of T, and every basis function "
                "by the largest value in its band. That is what rounding errors are proportional "
                "to; the entry itself may be anything, because its terms cancel.",
            ],
            _table(m.kernel.checks),
            [
                page.Figure(
                    "kernel",
                    plots.draw_kernel(m.kernel),
                    "Error by kind of pixel. Left: relative to the loss or the norm of the block. "
                    "Right: worst entry relative to its natural scale. Dashed: bounds; on the "
                    "right that of the materials.",
                )
            ],
        ),
        Section(
            "3. Branch points",
            [
                "Formulas change at r = 0.4, where series take over from the closed form; at the "
                "ends r = 0 and 1; and where n·v is clamped, at 10⁻⁴. Here all pixels cross such a "
                "point together. A jump in the value or slope there would stop a line search. "
                "First jumps of the float64 path, then analytic slopes against differences of "
                "values, then what float32 adds: noise.",
            ],
            _table(m.branches.checks),
            [
                page.Figure(
                    "jumps",
                    plots.draw_jumps(m.branches),
                    "Change from just below to just above a branch point, less the change that "
                    "the true function (h, dh/dr) or its slope (weights) accounts for, against the "
                    "width of the step: rounding, and nothing that grows with the step. By n·v "
                    "there is no slope to subtract; the change falls with the step, as that of a "
                    "continuous function must, where a jump would level out.",
                ),
                page.Figure(
                    "noise",
                    plots.draw_noise(m.branches),
                    "Fast objective less float64 path while all pixels cross a branch point in "
                    "steps of 10⁻⁸. In black the loss, in orange its slope by roughness relative "
                    "to its natural scale. Bounds lie at ±5·10⁻⁷, outside the drawing.",
                ),
            ],
        ),
        Section(
            "4. Cancellation near a perfect fit",
            [
                "Pictures equal what the point renders, but for residuals of 10⁻¹ to 10⁻⁹ of the "
                "signal. A residual is a difference of two nearly equal numbers, so float32 leaves "
                "an error of about 10⁻⁷ of the signal in it. Pictures are float32 too: their own "
                "rounding keeps the true residual above 2·10⁻⁸, and the comparison is with the "
                "true residual of the rounded pictures.",
            ],
            _table(m.cancellation.checks),
            [
                page.Figure(
                    "cancellation",
                    plots.draw_cancellation(m.cancellation),
                    "Left: residual that the fast loss reports against the true one. Right: error "
                    "of the gradient over its norm; above the dotted line it means nothing. Random "
                    "residuals average out in the gradient by the lights, rounding errors do not "
                    "all, so its error is larger the more pixels there are.",
                )
            ],
        ),
        Section(
            "5. Accumulated error",
            [
                f"Sums over up to {m.accumulation.samples[-1]:,} samples (pixels times pictures; "
                "times three channels) against float64 sums over short pieces, themselves added "
                "without rounding. Float32 sums drift as terms are added; here they may cover a "
                "block only, so that the error must not grow with the count. The hard case is "
                "residuals of one sign, whose errors cannot cancel, hardest when all pixels are "
                "alike, so that every addition rounds the same way.",
            ],
            _table(m.accumulation.checks),
            [
                page.Figure(
                    "accumulation",
                    plots.draw_accumulation(m.accumulation),
                    "Error against the number of samples. Left: of the loss, and of a running "
                    "float32 sum of the same squares. Right: of the gradient by the lights, worst "
                    "entry over the sum of its terms' sizes.",
                )
            ],
        ),
        Section(
            "6. Tiny numbers",
            [
                "Radiance, lights, roughness, albedo and metallic in the subnormal ranges of "
                "float32 (below 1.2·10⁻³⁸) and float64 (below 2.2·10⁻³⁰⁸): results are finite, "
                "zero where they should be, and as accurate as the format allows. And the range "
                "of exposures over which the loss is right: its float32 squares vanish for very "
                "small radiance and overflow for very large, which is refused with an error. The "
                "solver scales pictures to a mean of 0.4 first.",
            ],
            _table(m.tiny.checks),
            [
                page.Figure(
                    "exposures",
                    plots.draw_exposures(m.tiny),
                    "Relative error of the loss when lights and pictures are multiplied by a "
                    "factor. Grey: the range in which the bound has to hold.",
                )
            ],
        ),
        Section(
            "7. Determinism",
            [
                f"Loss and gradient bit for bit, in {m.determinism.evaluations} evaluations of "
                "problems large and small.",
            ],
            _table(m.determinism.checks),
        ),
        Section(
            "8. Stiff and extreme fits",
            [
                f"Whole fits of rooms of {m.effort.fit_size} × {m.effort.fit_size} pixels, "
                f"{m.effort.fit_pictures} pictures unless the name says otherwise, without noise, "
                f"rounded to float32, at most {m.effort.fit_iterations} iterations, without "
                "priors where none are named: lights that hardly differ, too few pictures, "
                "materials at the ends of their ranges, samples that the model cannot explain. The "
                "answer may be poor where the pictures do not tell it, but it has to be finite and "
                "say so.",
            ],
            [*_table(m.fits.checks), _fits(m.fits)],
        ),
    ]


def _fits(measured: StiffFits) -> Table:
    columns = [Cell("Scene", "name"), Cell("Solver", "name")]
    heads = ["recon / RMS", *(f"{name}\nRMSE" for name in MAPS)]
    heads += [f"{name}:\nuntold" for name in MAPS]
    heads += ["iterations", "evaluations", "seconds"]
    columns += [Cell(head, "number") for head in heads]
    columns.append(Cell("ended by", "name"))
    rows = []
    scene = ""
    for fit in measured.fits:
        figures = [scientific(fit.recon)]
        figures += [scientific(fit.errors[name]) for name in MAPS]
        figures += [percent(fit.undetermined[name]) for name in MAPS]
        figures += [str(fit.iterations), str(fit.evaluations), f"{fit.seconds:.2f}"]
        rows.append(
            [
                Cell("" if fit.scene == scene else fit.scene, "name"),
                Cell(fit.solver, "name"),
                *(Cell(text, "number") for text in figures),
                Cell(fit.status.replace("_", " "), "name"),
            ]
        )
        scene = fit.scene
    return Table(
        columns,
        rows,
        "Errors are of the pixels that can be explained. “Untold”: share of these that are flagged "
        "as not determined, or lie on a bound.",
    )


_COLUMNS = (
    Cell("What"),
    Cell("Worst", "number"),
    Cell("Bound", "number"),
    Cell("Verdict"),
    Cell("Where"),
    Cell("Why this bound"),
)


def _table(checks: Sequence[Check]) -> list[Table]:
    return [Table(_COLUMNS, [_row(check) for check in checks])]


def _row(check: Check) -> list[Cell]:
    bounded = check.bound is not None
    verdict = Cell("pass", "pass") if check.passed else Cell("FAIL", "fail")
    return [
        Cell(check.what),
        Cell(scientific(check.worst), "number"),
        Cell(scientific(check.bound) if check.bound is not None else "", "number"),
        verdict if bounded else Cell("reported", "note"),
        Cell(check.where),
        Cell(check.why, "why"),
    ]
