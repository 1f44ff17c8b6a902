"""The stability suite as rows, verdicts, tables and plots."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from pbrfit_evaluation.jobs import Values
from pbrfit_evaluation.stability.bounds import (
    BAND_BOUND,
    BLOCK_BOUND,
    ENTRY_BOUND,
    EQUAL_TERMS_BOUND,
    LOSS_BOUND,
    SECTIONS,
    SLOPE_BOUND,
)
from pbrfit_evaluation.stability.branches import STEPS
from pbrfit_evaluation.stability.run import Task
from pbrfit_evaluation.stability.stiff_fits import MAPS
from pbrfit_evaluation.stability.tiny import BOUNDED, EXPOSURES
from pbrfit_evaluation.suite import (
    Mark,
    Panel,
    Plot,
    Results,
    Row,
    Section,
    Series,
    Table,
    Verdict,
    digits,
)

NOTHING = 1e-18
"""Where an error of 0 is drawn on a logarithmic axis."""


def verdicts(results: Results[Task], _: Sequence[Row] = ()) -> list[Verdict]:
    """Every figure and its bound."""
    return [
        Verdict(what, value, most, where, part=task.section)
        for task, values in results.finished
        for key, (what, most) in SECTIONS[task.section].bounds.items()
        if key in values["figures"]
        for value, where in [values["figures"][key]]
    ]


def figures(results: Results[Task]) -> list[Row]:
    """A row a section: figures, their bounds, and how many fail."""
    rows = []
    for task, record in results.pairs:
        of = results.of(section=task.section)
        failed = sum(not verdict.holds for verdict in verdicts(of))
        metrics: dict[str, float | None] = {}
        found = (record.values or {}).get("figures", {})
        for key, (_, most) in SECTIONS[task.section].bounds.items():
            if key in found:
                metrics[key] = found[key][0]
                if most is not None:
                    metrics[f"{key}_bound"] = most
        status = record.error or ("not held" if failed else "ok")
        rows.append(Row(task.section, 0, None, metrics | {"failed": failed}, status=status))
    return rows


def sections(results: Results[Task], _: Sequence[Row]) -> Iterator[Section]:
    """What was measured, why the bounds are what they are, and plots."""
    for task, values in results.finished:
        of = SECTIONS[task.section]
        tables = [_fits(values)] if "fits" in values else []
        draw = PLOTS.get(task.section)
        plots = draw(values) if draw else []
        text = f"{of.text}\n\nWhy these bounds: {of.why}"
        yield Section(task.section.capitalize(), text, tables, plots)


def _fits(values: Values) -> Table:
    columns = ["scene", "solver", "residual / RMS", *(f"{name}\nRMSE" for name in MAPS)]
    columns += [f"{name}:\nshare flagged\nor on a bound" for name in MAPS]
    columns += ["iterations", "evaluations", "seconds", "ended by"]
    rows = [
        [
            *(fit["scene"], fit["solver"], fit["recon"]),
            *(fit["errors"][name] for name in MAPS),
            *(fit["undetermined"][name] for name in MAPS),
            *(float(fit[name]) for name in ("iterations", "evaluations", "seconds")),
            fit["status"].replace("_", " "),
        ]
        for fit in values["fits"]
    ]
    return Table(columns, rows, "Errors are of the pixels that the model can explain.")


# ------------------------------------------------------------------------------------- plots


def _drawn(errors: Sequence[float], least: float = NOTHING) -> list[float]:
    """For a logarithmic axis: 0 on its lower edge, what is no number nowhere."""
    return [max(e, least) if math.isfinite(e) else math.nan for e in errors]


def _bands(values: Values) -> list[Plot]:
    panels = []
    for key, name, bound, top in (
        ("value", "h", BAND_BOUND, 1e9),
        ("slope", "dh/dr", SLOPE_BOUND, 1e13),
    ):
        for part, label, span in (
            ("zero", "roughness r", (1e-90, 0.1)),
            ("all", "roughness r", (0, 1)),
            ("one", "1 − r", (0.1, 1e-16)),
        ):
            series = []
            for look, (rule, curves) in enumerate(values["curves"][key].items()):
                of = curves[part]
                series.append(Series(rule, of["x"], _drawn(of["error"]), look=look))
                failed = [top / 100**look if f else math.nan for f in of["failed"]]
                if any(of["failed"]):
                    series.append(
                        Series(f"{rule}: no number", of["x"], failed, look=look, empty=True)
                    )
            panels.append(
                Panel(
                    "steps",
                    series,
                    label,
                    f"error of {name}",
                    log="y" if part == "all" else "xy",
                    marks=[Mark(bound, "bound")],
                    x_range=span,
                    y_range=(NOTHING, 30 * top),
                )
            )
    caption = (
        "Largest error over the four bands. Left: towards r = 0, middle: all of [0, 1], right: "
        "towards r = 1. Errors below 10⁻¹⁸ lie on the lower edge; where a rule gives no number at "
        "all there is a dotted line at the top."
    )
    return [Plot("bands", caption, panels, columns=3, share_y="row", size=(3.8, 3.1))]


def _kernel(values: Values) -> list[Plot]:
    panels = [
        Panel(
            "dots",
            [
                Series(name, _drawn(list(of.values()), 1e-10), list(of))
                for name, of in values[figure].items()
            ],
            label,
            log="x",
            marks=[Mark(bound, "bound", axis="x")],
            x_range=(1e-10, 5e-6),
        )
        for figure, label, bound in (
            ("of_sum", "error / loss, error / norm of block", BLOCK_BOUND),
            ("of_entry", "worst entry: error / natural scale", ENTRY_BOUND),
        )
    ]
    caption = (
        "Error by kind of pixel. Left: relative to the loss or the norm of the block. Right: worst "
        "entry relative to its natural scale; the bound is that of the materials."
    )
    return [Plot("kernel", caption, panels, columns=2, share_y="all")]


def _branches(values: Values) -> list[Plot]:
    jumps = Panel(
        "lines",
        [Series(name, STEPS.tolist(), _drawn(j, 1e-17)) for name, j in values["jumps"].items()],
        "half the width of the step (in r; in n·v)",
        "unexplained change",
        log="xy",
        y_range=(5e-18, 1),
    )
    scans = values["scans"]
    sizes = np.abs([[scan["loss"], scan["gradient"]] for scan in scans.values()])
    span = 1.2e8 * float(np.max(sizes, where=np.isfinite(sizes), initial=1e-9))
    noise = [
        Panel(
            "steps",
            [
                Series(label, _times(1e6, scan["offset"]), _times(1e8, scan[key]))
                for label, key in (("loss", "loss"), ("slope by roughness", "gradient"))
            ],
            "offset / 10⁻⁶",
            "float32 − float64\n(relative, in 10⁻⁸)",
            title=branch,
            marks=[Mark(0, axis="x")],
            y_range=(-span, span),
        )
        for branch, scan in scans.items()
    ]
    return [
        Plot(
            "jumps",
            "Change from just below to just above a branch point, less what the true function or "
            "its slope accounts for, against the width of the step: rounding, and nothing that "
            "grows with the step. By n·v there is no slope to subtract; a jump would level out.",
            [jumps],
            size=(8.5, 4.2),
        ),
        Plot(
            "noise",
            "Fast objective less float64 path while all pixels cross a branch point in steps of "
            "10⁻⁸. Bounds lie at ±5·10⁻⁷, outside the drawing.",
            noise,
            columns=4,
            share_y="all",
            size=(2.7, 2.8),
        ),
    ]


def _times(factor: float, values: Sequence[float]) -> list[float]:
    return [factor * value for value in values]


def _cancellation(values: Values) -> list[Plot]:
    residual, span = values["residual"], [1e-8, 0.3]
    label = "true residual, RMS over the signal's RMS"
    reported = [
        Series(f"residuals of {form}", residual[form], of)
        for form, of in values["reported"].items()
    ]
    errors = [
        Series(name, residual[name.partition(", ")[2]], of)
        for name, of in values["gradient_error"].items()
    ]
    panels = [
        Panel(
            "lines",
            [*reported, Series("exact", span, span, look=7)],
            label,
            "reported residual",
            log="xy",
            x_range=(1e-8, 0.3),
            y_range=(1e-8, 0.3),
        ),
        Panel(
            "lines",
            errors,
            label,
            "error of the gradient / its norm",
            log="xy",
            marks=[Mark(1)],
            x_range=(1e-8, 0.3),
            y_range=(1e-7, 1e3),
        ),
    ]
    caption = (
        "Left: residual that the fast loss reports against the true one. Right: error of the "
        "gradient over its norm; above the dotted line it means nothing. Random residuals average "
        "out in the gradient by the lights, rounding errors do not all, so its error is larger the "
        "more pixels there are."
    )
    return [Plot("cancellation", caption, panels, columns=2, size=(5.5, 4))]


def _accumulation(values: Values) -> list[Plot]:
    def lines(key: str, name: str = "{}", empty: bool = False) -> list[Series]:
        return [
            Series(
                *(name.format(form), values["samples"], _drawn(of, 1e-10)), look=look, empty=empty
            )
            for look, (form, of) in enumerate(values[key].items())
        ]

    bounds = {LOSS_BOUND: "random", ENTRY_BOUND: "one sign", EQUAL_TERMS_BOUND: "alike"}
    marks = [Mark(bound, f"bound, {form}") for bound, form in bounds.items()]
    loss = [*lines("loss"), *lines("naive", "running float32 sum, {}", empty=True)]
    panels = [
        Panel("lines", series, "samples", name, log="xy", marks=of, y_range=(1e-10, 3))
        for series, name, of in (
            (loss, "relative error of the loss", marks),
            (lines("lights"), "worst entry: error / sum of sizes", marks[1:]),
        )
    ]
    caption = (
        "Error against the number of samples. Left: of the loss, and of a running float32 sum of "
        "the same squares. Right: of the gradient by the lights, worst entry over the sum of its "
        "terms' sizes."
    )
    return [Plot("accumulation", caption, panels, columns=2, size=(5.5, 4))]


def _exposures(values: Values) -> list[Plot]:
    bounded = EXPOSURES[BOUNDED]
    errors = values["exposure_error"]
    marks = [Mark(LOSS_BOUND, "bound"), Mark(bounded[0], axis="x", to=bounded[-1])]
    refused = [e for e, error in zip(EXPOSURES, errors, strict=True) if not math.isfinite(error)]
    if refused:
        marks.append(Mark(refused[0], f"refused from {digits(refused[0])}", axis="x"))
    panel = Panel(
        "lines",
        [Series("", EXPOSURES.tolist(), _drawn(errors, 1e-12))],
        "exposure: factor on lights and pictures",
        "relative error of the loss",
        log="xy",
        marks=marks,
        y_range=(1e-13, 10),
    )
    caption = (
        "Relative error of the loss when lights and pictures are multiplied by a factor. Grey: the "
        "range in which the bound has to hold."
    )
    return [Plot("exposures", caption, [panel], size=(8, 3.4))]


PLOTS: dict[str, Callable[[Values], list[Plot]]] = {
    "band weights": _bands,
    "fast objective": _kernel,
    "branch points": _branches,
    "cancellation": _cancellation,
    "accumulated error": _accumulation,
    "tiny numbers": _exposures,
}
