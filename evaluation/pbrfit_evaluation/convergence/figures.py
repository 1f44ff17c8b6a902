"""Error against run time as rows, tables and plots."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from pbrfit.commands.arguments import choice, value
from pbrfit.commands.fit_options import MODEL_OF_PICTURES
from pbrfit.model.reflection import MODELS
from pbrfit_evaluation.convergence.measure import (
    CASES,
    QUANTITIES,
    Case,
    Point,
    Quantity,
    chosen,
    first_reached,
    median_reached,
)
from pbrfit_evaluation.convergence.solvers import SOLVERS, Task, asked, run, tasks
from pbrfit_evaluation.jobs import Values
from pbrfit_evaluation.options import Setting, count, fixed, several
from pbrfit_evaluation.plots import draw, dress, mark, panels, png
from pbrfit_evaluation.suite import Column, Picture, Results, Row, Section, Suite, Table, Verdict

PLOTTED: tuple[Quantity, ...] = ("recon", "relight")

Ends = dict[str, float | None]

RACE_SIZE = 512
"""Side of pictures from which seconds are held against each other."""

SOONEST = 1e-2
"""Seconds at which the axis of times begins."""

RACER, MARK = "gauss-newton", "lbfgsb-paper"

SOONER: tuple[tuple[str, tuple[str, ...], float], ...] = (
    ("lbfgsb", (MARK, "lbfgsb"), 20.0),
    ("torch", ("torch-lbfgs", "torch-adam"), 10.0),
)
"""How many times sooner Gauss-Newton is, at least, on large pictures where the paper's recipe ends:
than whom, the solvers of which the soonest counts, and the bar."""

NEAR = 1.01
"""An error at most so many times the least of all solvers on the scene is as good as that."""

COSTS = {"seconds": "wall time / s", "processor": "processor time / s"}

Runs = dict[str, Sequence[Point]]
"""Checkpoints on one scene by solver."""


def _targets(case: Case, runs: Mapping[str, Sequence[Point]]) -> dict[str, float]:
    """Errors of a scene whose time is asked for: near the least of all, and that of the truth."""
    found = [point[case.judged] for points in runs.values() for point in points]
    known = [error for error in found if math.isfinite(error)]
    targets = {"near": NEAR * min(known)} if known else {}
    return targets | ({"floor": case.floor} if case.floor else {})


def _ends(case: Case, solver: str, scenes: Sequence[Runs], found: Sequence[Values]) -> Ends:
    """Medians over runs: what the last states have and cost, and times to reach errors."""
    last = [values["points"][-1] for values in found]
    metrics: Ends = {
        name: statistics.median(end[name] for end in last)
        for name in (*QUANTITIES, *COSTS, "evaluations")
    }
    for target in ("near", "floor"):
        reached = [
            first_reached(runs[solver], case.judged, targets[target])
            for runs in scenes
            if solver in runs and target in (targets := _targets(case, runs))
        ]
        for cost in COSTS:
            times = [point[cost] if point else None for point in reached]
            metrics[f"{cost}_to_{target}"] = median_reached(times)
    return metrics


def _scenes(results: Results[Task], case: Case) -> list[Runs]:
    """What ran on each scene of a case."""
    runs: dict[int, Runs] = {}
    for task, values in results.of(case=case).finished:
        runs.setdefault(task.seed, {})[task.solver] = values["points"]
    return list(runs.values())


def rows(results: Results[Task]) -> list[Row]:
    """A row for each case and solver, those without a run included."""
    made = []
    for case in chosen(results.options):
        for solver in asked(results.options):
            of = results.of(solver=solver.name, case=case)
            found = [values for _, values in of.finished]
            status = solver.why_not(case.model) or of.status("runs")
            metrics = _ends(case, solver.name, _scenes(results, case), found) if found else {}
            made.append(Row(case.name, len(found), solver.name, metrics, status=status))
    return made


def sections(results: Results[Task], rows: Sequence[Row]) -> Iterator[Section]:
    """Times to errors, curves, every figure, and what the solvers are."""
    done = [row for row in rows if row.scenes]
    times = [
        Column(f"{cost}_to_{target}", f"{label} {COSTS[cost].partition(' ')[0]} s", "low")
        for target, label in (("near", "within 1 %:"), ("floor", "to the noise floor:"))
        for cost in COSTS
    ]
    yield Section(
        "Time to the end",
        "Seconds until the reconstruction, of real pictures the held-out error, was within 1 % of "
        "the least that any solver reached on the scene, and no larger than that of the truth. "
        "Medians over seeds; “–”: not in most, nor where a solver is not listed.",
        [Table.of([row for row in done if _arrived(row)], times)],
    )
    finished = [values for _, values in results.finished]
    cases = [case for case in chosen(results.options) if results.of(case=case).finished]
    if finished:
        loads = sorted(values["load"] for values in finished)
        yield Section(
            "Curves",
            f"Load average of the last minute when runs began: {loads[0]:.1f} to {loads[-1]:.1f}, "
            f"median {statistics.median(loads):.1f}; a quiet machine shows at most its number of "
            f"threads ({finished[0]['threads']} a run), and times from a busy one are of little "
            "use.",
            figures=[_plot(quantity, results, cases) for quantity in PLOTTED],
        )
    yield Section("At the end", "Medians over seeds.", [Table.of(done)])
    solvers = asked(results.options)
    roster = [[s.name, s.what, s.why_not(results.options.model) or "ok"] for s in solvers]
    yield Section("Solvers", tables=[Table(["solver", "what it is", "status"], roster)])


def _arrived(row: Row) -> bool:
    """Whether it has a time at all: whether it came near the least, or to the noise floor."""
    return any(
        math.isfinite(seconds)
        for name, seconds in row.metrics.items()
        if "_to_" in name and seconds is not None
    )


def _plot(quantity: Quantity, results: Results[Task], cases: Sequence[Case]) -> Picture:
    size = (5.5, 2.6)
    figure, grid = panels(2 * len(cases), 2, size, sharex="col", sharey="row")
    pairs = [(case, cost) for case in cases for cost in COSTS]
    for axes, (case, cost) in zip(grid, pairs, strict=True):
        shown: Quantity = "held_out" if case.folder else quantity
        for place, solver in enumerate(asked(results.options)):
            for _, values in results.of(solver=solver.name, case=case).finished:
                x = [max(point[cost], SOONEST) for point in values["points"]]
                draw(axes, x, [point[shown] for point in values["points"]], place, solver.name)
        if quantity == "recon" and case.floor:
            mark(axes, case.floor, "noise")
        dress(axes, COSTS[cost], f"{shown.replace('_', ' ')} RMSE", case.title, log="xy")
    caption = (
        f"Error of {quantity}, of real pictures that of held-out ones, against wall time and "
        "against processor time, a line a seed."
    )
    return Picture(quantity, caption, png(figure))


# ------------------------------------------------------------------------------------- the race


def verdicts(results: Results[Task], _: Sequence[Row]) -> Iterator[Verdict]:
    """Gauss-Newton is much sooner where the paper's recipe ends, on large pictures."""
    for case in chosen(results.options):
        if case.size < RACE_SIZE:
            continue
        runs = _scenes(results, case)
        for other, rivals, bar in SOONER:
            speeds = {
                seed: speed(of, RACER, there)
                for seed, of in enumerate(runs)
                if MARK in of and RACER in of
                if (there := [of[name] for name in rivals if name in of])
            }
            if not speeds:
                continue
            ratios = [ratio for ratio, _ in speeds.values()]
            where = f"from {min(ratios):.3g} to {max(ratios):.3g}"
            if never := [seed for seed, (_, reached) in speeds.items() if not reached]:
                where += f"; {other} never reached it on {len(never)}: at least so much"
            what = (
                f"{case.name}: times sooner {RACER} is where the paper's recipe ends than {other}, "
                f"median of {len(ratios)}"
            )
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


SUITE = Suite(
    name="convergence",
    title="Error against run time",
    protocol="pbrfit-convergence-2, {effort}",
    cases=tasks,
    run=run,
    rows=rows,
    verdicts=verdicts,
    sections=sections,
    settings={
        "model": fixed("paper", choice(MODELS, MODEL_OF_PICTURES)),
        "seeds": count("K", "scenes of a case", 2, 1),
        "cases": several("NAME", CASES, tuple(CASES)[-2:], default=tuple(CASES)[:-2]),
        "solvers": several("NAME", SOLVERS),
        "real": fixed(
            None,
            value(
                "DIR", Path, "pictures of one view, whose truth nobody knows: a case for each size"
            ),
        ),
        "seconds": count("S", "after which a run is cut off", 100, 20),
        "iterations": Setting(500, 200),
        "evaluations": Setting(2000, 200),
    },
    about=(
        "Errors of reconstruction, maps and relit pictures while a solver runs, for every solver "
        "on scenes of several sizes, noise levels and light matrices. Peers need PyTorch (pip "
        "install pbrfit-evaluation[peers]); they know the paper's model alone.",
        "Errors are RMSE in float64, measured from the maps and lights of a run whenever "
        "evaluations or seconds have grown by 12 %, for all solvers by the same function; “recon” "
        "against the pictures that were fitted, noise included, “relight” under the true held-out "
        "lights. Of real pictures a quarter is held out, and errors are relative. The clock does "
        "not run meanwhile, nor while libraries and a start that is handed in are made.",
        "A run of ours ends after so many iterations, one of a peer after so many evaluations, "
        "and any after so many seconds. At 512² the default is held against the others by when it "
        "reaches the reconstruction error that the paper's recipe ends at.",
    ),
    jobs=1,  # times mean something only if nothing else runs
    timed=True,
)
