"""Convergence as rows, tables, plots and CSV files."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from pbrfit.report.notation import scientific
from pbrfit.synthetic.exposure import MEAN_RADIANCE
from pbrfit_evaluation.convergence.cases import chosen
from pbrfit_evaluation.convergence.measure import (
    QUANTITIES,
    Point,
    Quantity,
    first_reached,
    median_reached,
)
from pbrfit_evaluation.convergence.solvers import RACE_SIZE, SOLVERS
from pbrfit_evaluation.jobs import Values
from pbrfit_evaluation.suite import (
    Column,
    Line,
    Mark,
    Panel,
    Plot,
    Results,
    Row,
    Section,
    Series,
    Table,
    Verdict,
)

if TYPE_CHECKING:
    from pbrfit_evaluation.convergence.solvers import Task

SHOWN: tuple[tuple[Quantity, float], ...] = (
    ("recon", 1e-2),
    ("recon", 3e-3),
    ("recon", 1e-3),
    ("albedo", 0.05),
    ("albedo_scaled", 0.02),
    ("roughness", 0.05),
    ("metallic", 0.05),
    ("relight", 0.05),
    ("relight", 0.02),
)
"""Errors whose time is asked for. `recon` and `relight` in picture units, mean radiance 0.4."""

SOONEST = 1e-2
"""Seconds at which the axis of times begins."""

RACER, MARK = "gauss-newton", "lbfgsb-paper"

SOONER: tuple[tuple[str, tuple[str, ...], float], ...] = (
    ("lbfgsb", (MARK, "lbfgsb"), 20.0),
    ("torch", ("torch-lbfgs",), 10.0),
)
"""How many times sooner Gauss-Newton is, at least, on large pictures where the paper's recipe ends:
than whom, the solvers of which the soonest counts, and the bar."""


Runs = dict[str, Sequence[Point]]
"""Checkpoints on one scene by solver."""


def _ends(found: Sequence[Values]) -> dict[str, float | None]:
    """Medians over runs: what the last states have and cost, and times to reach errors."""
    last = [values["points"][-1] for values in found]
    metrics: dict[str, float | None] = {
        name: statistics.median(end[name] for end in last)
        for name in (*QUANTITIES, "seconds", "evaluations")
    }
    metrics["condition"] = statistics.median(values["condition"] for values in found)
    for quantity, target in SHOWN:
        reached = [first_reached(values["points"], quantity, target) for values in found]
        times = [point["seconds"] if point else None for point in reached]
        metrics[f"seconds_to_{quantity}_{target:g}"] = median_reached(times)
    return metrics


def rows(results: Results[Task]) -> list[Row]:
    """A row for each case and solver, those without a run included."""
    made = []
    for case in chosen(results.options):
        for solver in SOLVERS:
            of = results.of(solver=solver.name, case=case)
            found = [values for _, values in of.finished]
            status = solver.why_not(case.model, case.size) or of.status("runs")
            metrics = _ends(found) if found else {}
            made.append(Row(case.name, len(found), solver.name, metrics, status=status))
    return made


def csvs(results: Results[Task], _: Sequence[Row]) -> Mapping[str, Sequence[Line]]:
    """A line for every checkpoint."""
    lines: list[Line] = []
    for task, found in results.finished:
        case = task.case
        head = {"case": case.name, "size": case.size, "noise": case.noise, "lights": case.lights}
        head |= {"condition": found["condition"], "solver": task.solver, "seed": task.seed}
        lines += [head | point for point in found["points"]]
    return {"curves.csv": lines}


def sections(results: Results[Task], rows: Sequence[Row]) -> Iterator[Section]:
    """Errors at the end, times to errors, curves, and what the solvers are."""
    cost = [Column("seconds"), Column("evaluations"), Column("condition", "condition\nof lights")]
    yield Section(
        "Errors at the end",
        "Medians over seeds.",
        [Table.of(rows, [*(Column(name, best="low") for name in QUANTITIES), *cost])],
    )
    times = [
        Column(f"seconds_to_{name}_{target:g}", f"{name}\n{scientific(target)}", "low")
        for name, target in SHOWN
    ]
    yield Section(
        "Seconds until an error was first reached",
        "Medians over seeds; “–”: not in most.",
        [Table.of([row for row in rows if row.scenes], times)],
    )
    finished = [values for _, values in results.finished]
    if finished:
        loads = sorted(values["load"] for values in finished)
        yield Section(
            "Curves",
            f"Load average of the last minute when runs began: {loads[0]:.1f} to {loads[-1]:.1f}, "
            f"median {statistics.median(loads):.1f}; a quiet machine shows at most its number of "
            f"threads ({finished[0]['threads']} a run), and times from a busy one are of little "
            "use.",
            figures=[_plot(results, quantity) for quantity in QUANTITIES],
        )
    roster = [[s.name, s.what, s.why_not(results.options.model) or "ok"] for s in SOLVERS]
    yield Section("Solvers", tables=[Table(["solver", "what it is", "status"], roster)])


def _plot(results: Results[Task], quantity: Quantity) -> Plot:
    panels = []
    for case in chosen(results.options):
        floor = case.noise * MEAN_RADIANCE
        marks = [Mark(floor, "noise")] if quantity == "recon" and case.noise else []
        for cost, label in (("seconds", "wall time / s"), ("evaluations", "evaluations")):
            series = [
                Series(
                    solver.name,
                    [max(point[cost], SOONEST) for point in values["points"]],
                    [point[quantity] for point in values["points"]],
                    look=place,
                    empty=solver is SOLVERS[-1],
                )
                for place, solver in enumerate(SOLVERS)
                for _, values in results.of(solver=solver.name, case=case).finished
            ]
            y = f"{quantity.replace('_', ', ')} RMSE"
            panels.append(Panel("lines", series, label, y, title=case.title, log="xy", marks=marks))
    return Plot(
        quantity,
        f"Error of {quantity.replace('_', ', ')} against wall time and against evaluations, a line "
        "a seed.",
        panels,
        columns=2,
        share_x="col",
        share_y="row",
        size=(5.5, 2.6),
    )


# ------------------------------------------------------------------------------------- the race


def verdicts(results: Results[Task], _: Sequence[Row]) -> Iterator[Verdict]:
    """Gauss-Newton is much sooner where the paper's recipe ends, on large pictures."""
    for case in chosen(results.options):
        if case.size < RACE_SIZE:
            continue
        runs: dict[int, Runs] = {}
        for task, values in results.of(case=case).finished:
            runs.setdefault(task.seed, {})[task.solver] = values["points"]
        for other, rivals, bar in SOONER:
            speeds = {
                seed: speed(of, RACER, there)
                for seed, of in runs.items()
                if MARK in of and RACER in of
                if (there := [of[name] for name in rivals if name in of])
            }
            if not speeds:
                continue
            ratios = [ratio for ratio, _ in speeds.values()]
            where = f"from {min(ratios):.3g} to {max(ratios):.3g}"
            if never := [str(seed) for seed, (_, reached) in speeds.items() if not reached]:
                where += f"; {other} never reached it on {', '.join(never)}: at least so much"
            what = f"{RACER}: times sooner at the mark than {other}, median of {len(ratios)}"
            yield Verdict(what, statistics.median(ratios), bar, where, at_least=True)


def speed(of: Runs, solver: str, rivals: Sequence[Sequence[Point]]) -> tuple[float, bool]:
    """How many times sooner a solver had reached the mark than the soonest of its rivals.

    0 if it never did. False if no rival did: then the seconds after which the last gave up count.
    """
    mark = of[MARK][-1]["recon"]

    def seconds(points: Sequence[Point]) -> float:
        at = first_reached(points, "recon", mark)
        return at["seconds"] if at else math.inf

    soonest = min(map(seconds, rivals))
    reached = math.isfinite(soonest)
    if not reached:
        soonest = max(points[-1]["seconds"] for points in rivals)
    return soonest / seconds(of[solver]), reached
