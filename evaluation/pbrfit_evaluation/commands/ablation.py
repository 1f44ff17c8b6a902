"""`pbrfit evaluate ablation`."""

from __future__ import annotations

import argparse
import os
from dataclasses import replace
from pathlib import Path

from pbrfit.commands.arguments import Subcommands, positive, unread_is_no_failure, whole_number
from pbrfit.commands.fit_options import MODEL_OF_PICTURES, add_option
from pbrfit.model.reflection import DEFAULT_MODEL
from pbrfit_evaluation.commands import resumable


def add(suites: Subcommands) -> None:
    """Add the suite to `pbrfit evaluate`."""
    added = suites.add_parser(
        "ablation",
        help="what each prior is worth, where it holds and where it does not",
        description="Fit rooms whose truth is known, and real pictures, with and without each "
        "prior: with right, wrong and missing segments, and materials that keep to them or not. "
        "Writes report.html, pictures, ablation.md, rooms.csv, real.csv and summary.json.",
    )
    added.set_defaults(command=_run)
    added.add_argument(
        "folders",
        metavar="FOLDER",
        nargs="*",
        type=Path,
        help="real pictures: as for `pbrfit evaluate real` (default: the folder that the "
        "environment variable PBRFIT_DATA names, if any)",
    )
    resumable.add_options(added)
    add_option(added, "model", MODEL_OF_PICTURES, DEFAULT_MODEL)
    added.add_argument(
        "--scenes",
        metavar="K",
        type=positive,
        help="rooms of each case (default: 5, with --quick 1)",
    )
    added.add_argument(
        "--size",
        metavar="PIXELS",
        type=positive,
        help="of a room's pictures (default: 64, with --quick 32)",
    )
    added.add_argument(
        "--iterations",
        metavar="N",
        type=positive,
        help="of each fit (default: 500, with --quick 60)",
    )
    added.add_argument(
        "--first-seed",
        metavar="SEED",
        type=whole_number,
        help="of the first room (default: 3000; nothing was tuned on seeds from there on)",
    )
    added.add_argument("--quick", action="store_true", help="few configurations, small pictures")


def _run(options: argparse.Namespace) -> int:
    from pbrfit_evaluation import ablation, jobs, workspace
    from pbrfit_evaluation.ablation import report
    from pbrfit_evaluation.real import find_data
    from pbrfit_evaluation.real.sources import find_sources

    effort = ablation.QUICK if options.quick else ablation.FULL
    asked = {"rooms": options.scenes, "size": options.size, "iterations": options.iterations}
    asked["model"] = options.model
    effort = replace(effort, **{name: value for name, value in asked.items() if value is not None})
    seed = ablation.FIRST_SEED if options.first_seed is None else options.first_seed
    given = options.folders or os.environ.get("PBRFIT_DATA")
    folders = find_data(options.folders, os.environ) if given else []
    found = [source for path in folders for source in find_sources(path.absolute())]
    rooms, real = ablation.plan_rooms(effort, seed), ablation.plan_real(found, effort)
    tasks: list[ablation.Task] = [*rooms, *real]
    records = resumable.run_tasks(tasks, ablation.work, options, unit="task")
    # Alone, so that nothing else takes time from what is timed.
    [cost] = jobs.run([ablation.plan_cost(effort, seed)], ablation.work, options.out)
    measured = report.Measured(
        effort,
        list(zip(rooms, records[: len(rooms)], strict=True)),
        list(zip(real, records[len(rooms) :], strict=True)),
        cost,
    )
    with workspace.publish(options.out) as folder:
        report.write(folder, measured)
    if not options.quiet:
        with unread_is_no_failure():
            print("\n".join(report.lines(measured)))
            print(f"\nLook at {options.out / 'report.html'}")
    return resumable.exit_code([*records, cost])
