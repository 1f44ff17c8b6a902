"""`pbrfit evaluate solvers`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from pbrfit.commands.arguments import DONE, SOME_FAILED, Subcommands, positive, unread_is_no_failure
from pbrfit_evaluation.commands.resumable import (
    add_cycles_cache,
    add_options,
    exit_code,
    go_on,
    run_tasks,
)

if TYPE_CHECKING:
    from pbrfit_evaluation.jobs import Record
    from pbrfit_evaluation.solvers import Effort, Part

NAMES = ("exact", "noise", "start", "gap", "priors", "race", "memory")


def add(suites: Subcommands) -> None:
    """Add the suite to `pbrfit evaluate`."""
    added = suites.add_parser(
        "solvers",
        help="whether gauss-newton and auto reach what they must",
        description="Fit rooms with gauss-newton, auto and lbfgsb: without noise to the last "
        "digits, with noise, with priors, where the model does not fit, against the clock, and in "
        "memory; and hold the figures against what they must be. Writes report.html, plots, "
        "solvers.md, scenes.csv and summary.json. Exit code 1 if something does not hold. The "
        "race has PyTorch in it where that is installed (pip install pbrfit-evaluation[peers]).",
    )
    added.set_defaults(command=_run)
    # Times mean something only if nothing else runs.
    add_options(added, jobs=1, timed=True)
    added.add_argument(
        "--part",
        metavar="NAME",
        nargs="+",
        choices=NAMES,
        default=NAMES,
        help=f"only these parts (default: all): {', '.join(NAMES)}",
    )
    added.add_argument(
        "--scenes", metavar="K", type=positive, help="of every part (default: as each part needs)"
    )
    added.add_argument("--size", metavar="PIXELS", type=positive, help="of the pictures, likewise")
    added.add_argument(
        "--iterations", metavar="K", type=positive, help="of a fit (default: 500, with --quick 100)"
    )
    added.add_argument(
        "--cycles-scenes",
        metavar="K",
        type=int,
        help="of the gap part: scenes of a row that Blender Cycles renders (default: 5)",
    )
    add_cycles_cache(added)
    added.add_argument(
        "--large", action="store_true", help="measure the memory of 4 million pixels too"
    )
    added.add_argument("--quick", action="store_true", help="minutes: few and small scenes")


def _run(options: argparse.Namespace) -> int:
    from pbrfit_evaluation import solvers, workspace
    from pbrfit_evaluation.solvers import ALONE, Measured, gap, race, report
    from pbrfit_evaluation.solvers.report.verdicts import verdicts

    effort = _effort(options)
    parts: list[Part] = [part for part in solvers.PARTS if part in options.part]
    tasks = {part: solvers.plan(part, effort, options.cycles_cache) for part in parts}
    found: dict[Part, list[tuple[Any, Record]]] = {}

    def keep(part: Part, done: Sequence[Any], records: Sequence[Record]) -> None:
        found.setdefault(part, []).extend(zip(done, records, strict=True))

    shared = [(part, task) for part in parts if part not in ALONE for task in tasks[part]]
    records = run_tasks([task for _, task in shared], solvers.work, options, unit="task")
    for (part, task), record in zip(shared, records, strict=True):
        keep(part, [task], [record])
    for part in ALONE:
        if part in parts:
            keep(part, tasks[part], go_on(tasks[part], solvers.work, options, jobs=1, unit="run"))
    if "race" in parts:
        marks = [(task, record.values) for task, record in found["race"]]
        rest = race.plan_rest(marks)
        keep("race", rest, go_on(rest, solvers.work, options, jobs=1, unit="run"))

    notes: dict[Part, str] = {}
    missing = [f"{r.name}: {r.missing}" for r in race.RUNNERS if r.missing]
    if "race" in parts and missing:
        notes["race"] = "; ".join(missing)
    if "gap" in parts and effort.cycles_scenes and (why := gap.why_no_cycles()):
        notes["gap"] = f"rows of Cycles not run: {why}"
    measured = Measured(effort, options.jobs, found, notes)
    with workspace.publish(options.out) as folder:
        report.write(folder, measured)
    if not options.quiet:
        with unread_is_no_failure():
            print("\n".join(report.lines(measured)))
            print(f"\nLook at {options.out / 'report.html'}")
    failed = exit_code([record for pairs in found.values() for _, record in pairs])
    if failed:
        return failed
    return DONE if all(verdict.holds for verdict in verdicts(measured)) else SOME_FAILED


def _effort(options: argparse.Namespace) -> Effort:
    from pbrfit_evaluation.solvers import FULL, LARGE_SIZE, QUICK

    effort = QUICK if options.quick else FULL
    if options.scenes:
        effort = replace(effort, scenes=dict.fromkeys(effort.scenes, options.scenes))
    if options.size:
        effort = replace(
            effort,
            size=dict.fromkeys(effort.size, options.size),
            memory_sizes=(options.size,),
        )
    if options.large:
        effort = replace(effort, memory_sizes=(*effort.memory_sizes, LARGE_SIZE))
    if options.iterations:
        effort = replace(effort, iterations=options.iterations)
    if options.cycles_scenes is not None:
        effort = replace(effort, cycles_scenes=max(0, options.cycles_scenes))
    return effort
