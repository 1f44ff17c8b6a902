"""`pbrfit evaluate convergence`."""

from __future__ import annotations

import argparse

from pbrfit._core import InputError
from pbrfit.commands.arguments import Subcommands, positive, unread_is_no_failure
from pbrfit.commands.fit_options import MODEL_OF_PICTURES, add_option
from pbrfit_evaluation.commands.resumable import (
    add_options,
    exit_code,
    run_tasks,
)


def add(suites: Subcommands) -> None:
    """Add the suite to `pbrfit evaluate`."""
    added = suites.add_parser(
        "convergence",
        help="error against run time, for every solver, start and peer",
        description="Run every solver on scenes of several sizes, noise levels and light "
        "matrices, and measure the errors of reconstruction, maps and relit pictures on the way. "
        "Writes report.html, a plot a quantity, curves.csv, times.csv and summary.json. Peers "
        "need PyTorch: pip install pbrfit-evaluation[peers]; they know the paper's model alone.",
    )
    added.set_defaults(command=_run)
    # Times mean something only if nothing else runs.
    add_options(added, jobs=1, timed=True)
    add_option(added, "model", MODEL_OF_PICTURES, "paper")
    added.add_argument(
        "--seeds", metavar="K", type=positive, help="scenes of a case (default: 3; 1 if quick)"
    )
    added.add_argument(
        "--quick", action="store_true", help="half a minute: two cases of 24 × 24 pixels, few steps"
    )


def _run(options: argparse.Namespace) -> int:
    from pbrfit_evaluation import convergence, workspace
    from pbrfit_evaluation.convergence import report

    effort = (convergence.QUICK if options.quick else convergence.FULL).of_model(options.model)
    seeds = options.seeds or effort.seeds
    if seeds > convergence.MOST_SEEDS:
        raise InputError(f"--seeds: expected at most {convergence.MOST_SEEDS}, found {seeds}")
    tasks = convergence.plan(effort, seeds)
    records = run_tasks(tasks, convergence.work, options, unit="run")
    curves = convergence.curves(tasks, [record.values for record in records])
    with workspace.publish(options.out) as folder:
        report.write(folder, effort, curves, seeds=seeds, jobs=options.jobs)
    if not options.quiet:
        with unread_is_no_failure():
            print("\n".join(report.lines(report.groups(effort, curves, seeds))))
            print(f"\nLook at {options.out / 'report.html'}")
    return exit_code(records)
