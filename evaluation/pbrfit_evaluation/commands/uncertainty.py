"""`pbrfit evaluate uncertainty`."""

from __future__ import annotations

import argparse

from pbrfit.commands.arguments import SOME_FAILED, Subcommands, unread_is_no_failure, whole_number
from pbrfit_evaluation.commands.resumable import add_options, exit_code, run_tasks


def add(suites: Subcommands) -> None:
    """Add the suite to `pbrfit evaluate`."""
    added = suites.add_parser(
        "uncertainty",
        help="predicted deviations against many refits under noise",
        description="Fit pictures of known materials many times under synthetic noise, with the "
        "lights known and free, and compare the standard deviations of what is found with those "
        "that pbrfit predicts. Writes report.html, its plot, uncertainty.md and summary.json. "
        "Exit code 1 if a bar is not reached.",
    )
    added.set_defaults(command=_run)
    add_options(added)
    added.add_argument(
        "--first-seed",
        metavar="SEED",
        type=whole_number,
        help="of the first scene of each kind (default: 3000)",
    )
    added.add_argument("--quick", action="store_true", help="one small room, few refits")


def _run(options: argparse.Namespace) -> int:
    from pbrfit_evaluation import uncertainty, workspace
    from pbrfit_evaluation.uncertainty import report

    seed = uncertainty.FIRST_SEED if options.first_seed is None else options.first_seed
    tasks = uncertainty.plan(uncertainty.QUICK if options.quick else uncertainty.FULL, seed)
    records = run_tasks(tasks, uncertainty.work, options)
    scenes = uncertainty.calibrations(tasks, [record.values for record in records])
    found = report.groups(scenes)
    with workspace.publish(options.out) as folder:
        report.write(folder, scenes)
    if not options.quiet:
        with unread_is_no_failure():
            print("\n".join(report.lines(found)))
            print(f"\nLook at {options.out / 'report.html'}")
    return exit_code(records) or (0 if all(group.holds for group in found) else SOME_FAILED)
