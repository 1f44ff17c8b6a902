"""The convergence suite as files: page, plots, CSV, summary."""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from pbrfit.model.reflection import Model
from pbrfit.report.notation import scientific
from pbrfit.synthetic.exposure import MEAN_RADIANCE
from pbrfit_evaluation import page, summary
from pbrfit_evaluation.convergence import FIRST_SEED, SOLVERS, Case, Curve, Effort, Solver, plots
from pbrfit_evaluation.convergence.cases import PICTURES
from pbrfit_evaluation.convergence.measure import (
    CHECKPOINT_RATIO,
    POINT_COLUMNS,
    QUANTITIES,
    TARGETS,
    Quantity,
    final,
    first_reached,
    median_reached,
)
from pbrfit_evaluation.page import Cell, Figure, Section, Table
from pbrfit_evaluation.tables import write_csv

CURVES, TIMES = "curves.csv", "times.csv"

PROTOCOL = "pbrfit-convergence-1"
"""Under one name and effort, the same scenes, seeds, checkpoints and errors."""

CURVE_COLUMNS = ("case", "size", "noise", "lights", "condition", "solver", "seed", *POINT_COLUMNS)
TIME_COLUMNS = (
    *("case", "solver", "seed", "quantity", "target"),
    *("status", "seconds", "evaluations", "kept"),
)

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
"""Times that the page has a column for; times.csv has them all."""

NAMES: dict[Quantity, str] = {
    "recon": "recon",
    "albedo": "albedo",
    "albedo_scaled": "albedo, best scale",
    "roughness": "roughness",
    "metallic": "metallic",
    "relight": "relight",
}

BELOW_NOISE = 0.9
"""Of the noise: a fit of as many unknowns as these ends at 0.95 of it. Lower is out of reach."""


@dataclass(frozen=True)
class Group:
    """Runs of one solver on the scenes of one case; `failed` more did not end."""

    case: Case
    solver: Solver
    curves: Sequence[Curve]
    failed: int

    @property
    def status(self) -> str:
        """For the summary: "ok", or what went wrong."""
        if why_not := self.solver.why_not(self.case.model):
            return why_not
        if self.failed:
            return f"{self.failed} of {self.failed + len(self.curves)} runs failed"
        return "ok" if self.curves else "not run"

    def metrics(self) -> dict[str, float | None]:
        """Medians of the last states' errors, and of the times to reach those of the page."""
        if not self.curves:
            return {}
        ends = [final(curve.points) for curve in self.curves]
        found: dict[str, float | None] = {
            name: statistics.median(end[name] for end in ends) for name in ends[0]
        }
        found["condition"] = statistics.median(curve.condition for curve in self.curves)
        for quantity, target in SHOWN:
            found[f"seconds_to_{quantity}_{target:g}"] = self.time_to(quantity, target)[0]
        return found

    def time_to(self, quantity: Quantity, target: float) -> tuple[float | None, int]:
        """Median of the seconds to reach an error, None if the median is never; how many did."""
        times = [first_reached(c.points, quantity, target).seconds for c in self.curves]
        return median_reached(times), sum(time is not None for time in times)


def groups(effort: Effort, curves: Sequence[Curve], seeds: int) -> list[Group]:
    """By case and solver, those without a run included."""
    found = []
    for case in effort.cases:
        for solver in SOLVERS:
            runs = [c for c in curves if c.task.case == case and c.task.solver == solver.name]
            failed = 0 if solver.why_not(case.model) else seeds - len(runs)
            found.append(Group(case, solver, runs, failed))
    return found


def write(folder: Path, effort: Effort, curves: Sequence[Curve], *, seeds: int, jobs: int) -> None:
    """Write everything into an existing folder."""
    found = groups(effort, curves, seeds)
    write_csv(folder / CURVES, CURVE_COLUMNS, curve_rows(curves))
    write_csv(folder / TIMES, TIME_COLUMNS, time_rows(curves))
    page.write_page(
        folder,
        "Error against run time",
        _opening(effort, curves, seeds, jobs),
        [_roster(effort.model), *_cases(effort, found), *_plots(curves)],
    )
    rows = [
        summary.Row(
            group.case.name,
            scenes=len(group.curves),
            solver=group.solver.name,
            metrics=group.metrics(),
            status=group.status,
        )
        for group in found
    ]
    summary.write_summary(folder, f"{PROTOCOL}, {effort.name}", rows)


def curve_rows(curves: Sequence[Curve]) -> Iterator[list[object]]:
    """A line for every checkpoint, in the order of `CURVE_COLUMNS`."""
    for curve in curves:
        case = curve.task.case
        head = [case.name, case.size, case.noise, case.lights, curve.condition]
        for point in curve.points:
            yield [*head, curve.task.solver, curve.task.seed, *point.as_row()]


def time_rows(curves: Sequence[Curve]) -> Iterator[list[object]]:
    """A line for every run and error asked for, in the order of `TIME_COLUMNS`."""
    for curve in curves:
        task = curve.task
        for quantity in QUANTITIES:
            for target in TARGETS[quantity]:
                time = first_reached(curve.points, quantity, target)
                if time.seconds is not None:
                    status = "reached"
                elif quantity == "recon" and target < _noise_floor(task.case):
                    status = "below the noise"
                else:
                    status = "not reached"
                yield [
                    *(task.case.name, task.solver, task.seed, quantity, target, status),
                    *(time.seconds, time.evaluations, "yes" if time.kept else "no"),
                ]


def lines(found: Sequence[Group]) -> list[str]:
    """What the command prints: the last states' errors, medians over seeds."""
    head = f"{'median over seeds':<22}" + "".join(f"{name:>14}" for name in QUANTITIES)
    text = [f"{head}{'seconds':>9}{'evaluations':>12}"]
    case = None
    for group in found:
        if group.case != case:
            case = group.case
            text.append(case.title)
        ends = group.metrics()
        if not ends:
            text.append(f"  {group.solver.name:<20}{group.status}")
            continue
        errors = "".join(f"{ends[name]:>14.5f}" for name in QUANTITIES)
        text.append(
            f"  {group.solver.name:<20}{errors}{ends['seconds']:>9.2f}{ends['evaluations']:>12.0f}"
        )
    return text


def _noise_floor(case: Case) -> float:
    return BELOW_NOISE * case.noise * MEAN_RADIANCE


def _opening(effort: Effort, curves: Sequence[Curve], seeds: int, jobs: int) -> list[str]:
    on = summary.machine()
    threads = sorted({curve.threads for curve in curves})
    loads = sorted(curve.load for curve in curves) or [0.0]
    alone = (
        "one run at a time"
        if jobs == 1
        else f"{jobs} runs at a time, so times are not to be compared with those of another run"
    )
    return [
        "How far reconstruction, maps and relit pictures are from the truth while solvers run, "
        "against wall time and against evaluations of loss and gradient.",
        f"Scenes are rooms with {PICTURES} training and {PICTURES} held-out pictures of "
        f"mean radiance {MEAN_RADIANCE:g}, rendered and fitted with model {effort.model}; seeds "
        f"{FIRST_SEED} to "
        f"{FIRST_SEED + seeds - 1}. Constants of solvers and peers were chosen on other seeds.",
        "Errors are measured in float64 from the maps and lights of a run, at numbers of "
        f"evaluations that grow by {100 * (CHECKPOINT_RATIO - 1):.0f} %, for all solvers by the "
        "same function; “recon” against the pictures that were fitted, noise included, “relight” "
        "under the true held-out lights. The clock does not run meanwhile. It begins when the "
        "pictures are arrays in memory. Importing libraries, a first small fit that wakes their "
        "threads, and making a start that is handed in are not on it.",
        f"A run of ours ends after {effort.iterations} iterations, one of a peer after "
        f"{effort.evaluations} evaluations, and any after {effort.seconds:g} s (more above 64², "
        "in proportion to the pixels).",
        f"pbrfit {version('pbrfit')}, effort “{effort.name}”, {alone}, "
        f"{' or '.join(map(str, threads)) or 'no'} threads each; {on['processor']}, "
        f"{on['cores']} cores, {on['system']}, Python {on['python']}, numpy {on['numpy']}. "
        f"Load average of the last minute when runs began: {loads[0]:.1f} to {loads[-1]:.1f}, "
        f"median {statistics.median(loads):.1f}; a quiet machine shows at most its number of "
        "threads, and times from a busy one are of little use.",
    ]


def _roster(model: Model) -> Section:
    rows = [
        [Cell(solver.name, "name"), Cell(solver.what, "why"), Cell(solver.why_not(model) or "ok")]
        for solver in SOLVERS
    ]
    columns = [Cell("Solver", "name"), Cell("What it is"), Cell("Status")]
    return Section("Solvers", [], tables=[Table(columns, rows)])


def _cases(effort: Effort, found: Sequence[Group]) -> list[Section]:
    sections = []
    for case in effort.cases:
        of_case = [group for group in found if group.case == case]
        sections.append(Section(case.title, [], tables=[_ends(of_case), _times(of_case)]))
    return sections


def _ends(found: Sequence[Group]) -> Table:
    columns = [
        Cell("Solver", "name"),
        *(Cell(NAMES[quantity], "number") for quantity in QUANTITIES),
        Cell("seconds", "number"),
        Cell("evaluations", "number"),
    ]
    rows = []
    for group in found:
        ends = group.metrics()
        cells = [_figure(ends.get(name)) for name in (*QUANTITIES, "seconds", "evaluations")]
        rows.append([Cell(group.solver.name, "name"), *(Cell(text, "number") for text in cells)])
    return Table(columns, rows, "Errors (RMSE) at the end, medians over seeds.")


def _times(found: Sequence[Group]) -> Table:
    columns = [
        Cell("Solver", "name"),
        *(Cell(f"{NAMES[quantity]}\n{scientific(target)}", "number") for quantity, target in SHOWN),
    ]
    rows = [
        [
            Cell(group.solver.name, "name"),
            *(Cell(_time(group, quantity, target), "number") for quantity, target in SHOWN),
        ]
        for group in found
    ]
    caption = (
        "Seconds until an error was first reached, medians over seeds; in brackets in how many "
        "scenes it was. “–”: not in most."
    )
    return Table(columns, rows, caption)


def _time(group: Group, quantity: Quantity, target: float) -> str:
    if not group.curves:
        return ""
    if quantity == "recon" and target < _noise_floor(group.case):
        return "below noise"
    median, count = group.time_to(quantity, target)
    return f"{'–' if median is None else f'{median:.2g}'} ({count}/{len(group.curves)})"


def _figure(value: float | None) -> str:
    return "" if value is None else scientific(value)


def _plots(curves: Sequence[Curve]) -> list[Section]:
    if not curves:
        return []
    caption = (
        "Error of {} against wall time and against evaluations. Lines: medians over seeds, held "
        "where a run had ended; shaded: least to largest."
    )
    return [
        Section(
            NAMES[quantity].capitalize(),
            [],
            figures=[
                Figure(quantity, plots.draw(curves, quantity), caption.format(NAMES[quantity]))
            ],
        )
        for quantity in QUANTITIES
    ]
