"""`pbrfit evaluate real`."""

from __future__ import annotations

import argparse
import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from pbrfit.commands.arguments import Subcommands, positive, unread_is_no_failure
from pbrfit_evaluation.commands import resumable

if TYPE_CHECKING:
    from pbrfit_evaluation.real.report import Measured


def add(suites: Subcommands) -> None:
    """Add the suite to `pbrfit evaluate`."""
    added = suites.add_parser(
        "real",
        help="held-out pictures of real scenes",
        description="Fit materials to some pictures of each scene, then only the light of the "
        "others, and report how well the materials explain them. Writes report.html, pictures, "
        "pictures.csv and summary.json.",
    )
    added.set_defaults(command=_run)
    added.add_argument(
        "folders",
        metavar="FOLDER",
        nargs="*",
        type=Path,
        help="scene folder, a public set as published, or a folder of such (default: the folder "
        "that the environment variable PBRFIT_DATA names)",
    )
    resumable.add_options(added)
    resumable.add_models(added, "pictures are explained with")
    added.add_argument(
        "--held-out",
        metavar="K",
        type=positive,
        help="pictures of a scene that are held out at a time (default: a quarter)",
    )
    added.add_argument(
        "--folds",
        metavar="F",
        type=positive,
        help="at most so many ways to hold pictures out (default: 4, with --quick 1)",
    )
    added.add_argument(
        "--max-size",
        metavar="PIXELS",
        type=positive,
        help="average larger pictures down to this longer side (default: 256, with --quick 64)",
    )
    added.add_argument(
        "--iterations",
        metavar="N",
        type=positive,
        help="of each fit (default: 500, with --quick 60)",
    )
    added.add_argument("--quick", action="store_true", help="small pictures, short fits, one fold")


def _run(options: argparse.Namespace) -> int:
    from pbrfit_evaluation import real, workspace
    from pbrfit_evaluation.real import report, sources

    effort = real.QUICK if options.quick else real.FULL
    asked = {name: getattr(options, name) for name in ("held_out", "folds", "max_size")}
    asked["iterations"] = options.iterations
    effort = replace(effort, **{name: value for name, value in asked.items() if value is not None})
    data = [path.absolute() for path in real.find_data(options.folders, os.environ)]
    found = [source for path in data for source in sources.find_sources(path)]
    absent = [one for path in data for one in sources.absent(path, found)]
    models = resumable.models(options)
    tasks = real.plan(found, effort, models)
    records = resumable.run_tasks(tasks, real.work, options, unit="fold")
    measured = [
        report.Measured(
            source,
            model,
            {
                task.fold: real.Fold.of(record.values)
                for task, record in zip(tasks, records, strict=True)
                if (task.source, task.model) == (source, model) and record.values is not None
            },
            next(
                (
                    record.error
                    for task, record in zip(tasks, records, strict=True)
                    if (task.source, task.model) == (source, model) and record.error is not None
                ),
                None,
            ),
        )
        for source in found
        for model in models
    ]
    with workspace.publish(options.out) as folder:
        report.write(folder, measured, effort, absent)
    if not options.quiet:
        with unread_is_no_failure():
            _print(measured, options.out)
    return resumable.exit_code(records)


def _print(measured: list[Measured], out: Path) -> None:
    from pbrfit_evaluation import real

    print("held-out pictures, RMSE / RMS radiance")
    print(f"{'':<38}" + "".join(f"{name:>12}" for name in real.EXPLANATIONS))
    for one in measured:
        if one.folds:
            found = [
                real.figures(list(one.folds.values()), name).error for name in real.EXPLANATIONS
            ]
            print(f"{one.name:<38}" + "".join(f"{value:>12.4f}" for value in found))
        else:
            print(f"{one.name:<38}  not run: {one.error}")
    print(f"\nlook at {out / 'report.html'}")
