"""Convergence as rows, tables, plots and CSV files."""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from pbrfit.report.notation import scientific
from pbrfit.synthetic.exposure import MEAN_RADIANCE
from pbrfit_evaluation.convergence.cases import CASES, Case
from pbrfit_evaluation.convergence.measure import (
    QUANTITIES,
    TARGETS,
    Point,
    Quantity,
    first_reached,
    median_reached,
    on_grid,
)
from pbrfit_evaluation.convergence.solvers import SOLVERS
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
"""Times in tables and the summary; times.csv has them all."""

BELOW_NOISE = 0.9
"""Share of the noise below which a reconstruction error is out of reach: a fit of as many unknowns
as these ends at 0.95 of it."""

GRID = 16
"""Costs at which curves are drawn."""

FINEST = {"seconds": 1e-2, "evaluations": 1.0}
"""Where the axes begin."""


def _cases(results: Results[Task]) -> list[Case]:
    return [CASES[name] for name in results.options.cases]


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
    for case in _cases(results):
        for solver in SOLVERS:
            of = results.of(solver=solver.name)
            pairs = [(task, one) for task, one in of.pairs if task.case.name == case.name]
            of = Results(results.options, pairs)
            found = [values for _, values in of.finished]
            status = solver.why_not(results.options.model) or of.status("runs")
            metrics = _ends(found) if found else {}
            made.append(Row(case.name, len(found), solver.name, metrics, status=status))
    return made


def csvs(results: Results[Task], _: Sequence[Row]) -> Mapping[str, Sequence[Line]]:
    """A line for every checkpoint, and one for every run and error asked for."""
    curves: list[Line] = []
    times: list[Line] = []
    for task, found in results.finished:
        case = task.case
        head = {"case": case.name, "size": case.size, "noise": case.noise, "lights": case.lights}
        head |= {"condition": found["condition"], "solver": task.solver, "seed": task.seed}
        curves += [head | point for point in found["points"]]
        head = {"case": case.name, "solver": task.solver, "seed": task.seed}
        times += [
            head | _time(found, case, quantity, target)
            for quantity in QUANTITIES
            for target in TARGETS[quantity]
        ]
    return {"curves.csv": curves, "times.csv": times}


def _time(found: Values, case: Case, quantity: Quantity, target: float) -> dict[str, object]:
    """When a run first had an error, and whether its last state still had it.

    Errors of maps go up and down, and restarts throw a fit back: no user can see the moment at
    which the maps were best.
    """
    points: Sequence[Point] = found["points"]
    reached = first_reached(points, quantity, target)
    floor = BELOW_NOISE * case.noise * MEAN_RADIANCE
    below = quantity == "recon" and target < floor
    return {
        "quantity": quantity,
        "target": target,
        "status": "reached" if reached else "below the noise" if below else "not reached",
        "seconds": reached["seconds"] if reached else None,
        "evaluations": reached["evaluations"] if reached else None,
        "kept": "yes" if reached and points[-1][quantity] <= target else "no",
    }


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
    for case in _cases(results):
        floor = case.noise * MEAN_RADIANCE
        marks = [Mark(floor, "noise")] if quantity == "recon" and case.noise else []
        for cost, label in (("seconds", "wall time / s"), ("evaluations", "evaluations")):
            series = []
            for place, solver in enumerate(SOLVERS):
                runs = [
                    values["points"]
                    for task, values in results.of(solver=solver.name).finished
                    if task.case.name == case.name
                ]
                if runs:
                    series.append(_series(runs, quantity, cost, solver.name, place))
            y = f"{quantity.replace('_', ', ')} RMSE"
            panels.append(Panel("lines", series, label, y, title=case.title, log="xy", marks=marks))
    return Plot(
        quantity,
        f"Error of {quantity.replace('_', ', ')} against wall time and against evaluations. "
        "Lines: medians over seeds, held where a run had ended; shaded: least to largest.",
        panels,
        columns=2,
        share_x="col",
        share_y="row",
        size=(5.5, 2.6),
    )


def _series(
    runs: Sequence[Sequence[Point]], quantity: Quantity, cost: str, name: str, place: int
) -> Series:
    """Median of the runs' errors, from the first cost that all have to the last of any."""
    costs = [[point[cost] for point in run] for run in runs]
    first = max(max(of_run[0] for of_run in costs), FINEST[cost])
    last = max(of_run[-1] for of_run in costs)
    grid = np.geomspace(first, max(last, first * 1.01), GRID)
    errors = np.stack(
        [
            on_grid(grid, of_run, [point[quantity] for point in run])
            for of_run, run in zip(costs, runs, strict=True)
        ]
    )
    shown = np.isfinite(errors).all(axis=0)
    grid, errors = grid[shown], errors[:, shown]
    low, high = (errors.min(axis=0), errors.max(axis=0)) if len(runs) > 1 else ((), ())
    middle = np.median(errors, axis=0).tolist()
    known = name == SOLVERS[-1].name
    return Series(name, grid.tolist(), middle, low=low, high=high, look=place, empty=known)
