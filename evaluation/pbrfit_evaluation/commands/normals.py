"""`pbrfit evaluate normals`."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pbrfit.commands.arguments import (
    DONE,
    SOME_FAILED,
    Subcommands,
    add_threads,
    positive,
    unread_is_no_failure,
    whole_number,
)
from pbrfit_evaluation.commands.resumable import add_options, exit_code, go_on, run_tasks

if TYPE_CHECKING:
    from pbrfit_evaluation.jobs import Record
    from pbrfit_evaluation.normals import Effort, Part, Task

NAMES = ("rooms", "exact", "real", "cost")
DISTURBANCES = ("correlated", "biased", "estimator")


def add(suites: Subcommands) -> None:
    """Add the suite to `pbrfit evaluate`."""
    added = suites.add_parser(
        "normals",
        help="what wrong normals cost, and how much of it refining wins back",
        description="Disturb the normals of scenes whose truth is known, by 1 to 25 degrees, and "
        "fit them with and without refinement: errors of materials, relighting and normals; "
        "without noise; on public sets with true normals; and what it costs. Writes report.html, "
        "plots and pictures, normals.md, scenes.csv and summary.json. Exit code 1 if something "
        "does not hold.",
    )
    added.set_defaults(command=_run)
    added.add_argument(
        "folders",
        metavar="FOLDER",
        nargs="*",
        type=Path,
        help="public sets: as for `pbrfit evaluate real` (default: the folder that the environment "
        "variable PBRFIT_DATA names, if any)",
    )
    add_options(added, timed=True)
    add_threads(added)
    added.add_argument(
        "--part",
        metavar="NAME",
        nargs="+",
        choices=NAMES,
        help=f"only these parts (default: all): {', '.join(NAMES)}",
    )
    added.add_argument(
        "--disturbances",
        metavar="KIND",
        nargs="+",
        choices=DISTURBANCES,
        help=f"only these (default: all): {', '.join(DISTURBANCES)}",
    )
    added.add_argument(
        "--degrees",
        metavar="THETA",
        nargs="+",
        type=float,
        help="sizes of the disturbance (default: 1 2 5 10 15 20 25, with --quick 10); true "
        "normals are always there",
    )
    added.add_argument(
        "--scenes", metavar="K", type=positive, help="rooms (default: 12, with --quick 2)"
    )
    added.add_argument(
        "--size",
        metavar="PIXELS",
        type=positive,
        help="of the rooms' pictures (default: 128, with --quick 32)",
    )
    added.add_argument(
        "--iterations", metavar="K", type=positive, help="of a fit (default: 500, with --quick 100)"
    )
    added.add_argument(
        "--first-seed",
        metavar="SEED",
        type=whole_number,
        help="of the first room (default: 7000; nothing was tuned on seeds from there on)",
    )
    added.add_argument("--quick", action="store_true", help="minutes: few and small scenes")


def _run(options: argparse.Namespace) -> int:
    from pbrfit_evaluation import normals, workspace
    from pbrfit_evaluation.normals import ALONE, Measured, real, report
    from pbrfit_evaluation.normals.report.verdicts import verdicts
    from pbrfit_evaluation.real import find_data

    effort = _effort(options)
    parts: list[Part] = [part for part in normals.PARTS if part in (options.part or NAMES)]
    notes: dict[Part, str] = {}
    given = options.folders or os.environ.get("PBRFIT_DATA")
    sources = real.find(find_data(options.folders, os.environ)) if given else []
    if "real" in parts and not sources:
        kinds = " or ".join(real.KINDS)
        notes["real"] = f"not run: no {kinds} in the folders given, or none given"
    tasks = {part: normals.plan(part, effort, sources) for part in parts}
    work = partial(_with_threads, normals.work, options.threads)
    found: dict[Part, list[tuple[Any, Record]]] = {part: [] for part in parts}

    def keep(done: Sequence[tuple[Part, Task]], records: Sequence[Record]) -> None:
        for (part, task), record in zip(done, records, strict=True):
            found[part].append((task, record))

    shared = [(part, task) for part in parts if part not in ALONE for task in tasks[part]]
    keep(shared, run_tasks([task for _, task in shared], work, options, unit="task"))
    alone = [(part, task) for part in parts if part in ALONE for task in tasks[part]]
    keep(alone, go_on([task for _, task in alone], work, options, jobs=1, unit="task"))

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


def _with_threads(work: Any, asked: int, task: Any, threads: int) -> Any:
    """Do a task with as many threads as were asked for; 0 = as many as it may use."""
    return work(task, asked or threads)


def _effort(options: argparse.Namespace) -> Effort:
    from pbrfit._core import InputError
    from pbrfit_evaluation.normals import FULL, QUICK

    effort = QUICK if options.quick else FULL
    asked: dict[str, Any] = {
        "scenes": options.scenes,
        "size": options.size,
        "iterations": options.iterations,
        "first_seed": options.first_seed,
    }
    if options.disturbances:
        asked["disturbances"] = tuple(k for k in DISTURBANCES if k in options.disturbances)
    if options.degrees:
        for theta in options.degrees:
            if not 0 < theta <= 45:
                raise InputError(f"--degrees: expected more than 0 and at most 45, found {theta:g}")
        asked["degrees"] = tuple(sorted(set(options.degrees)))
    return replace(effort, **{name: value for name, value in asked.items() if value is not None})
