"""`pbrfit evaluate review`."""

from __future__ import annotations

import argparse
from dataclasses import replace

from pbrfit.commands.arguments import (
    DONE,
    SOME_FAILED,
    Subcommands,
    unread_is_no_failure,
    whole_number,
)
from pbrfit_evaluation.commands.resumable import add_cycles_cache, add_options, exit_code, run_tasks


def add(suites: Subcommands) -> None:
    """Add the suite to `pbrfit evaluate`."""
    added = suites.add_parser(
        "review",
        help="what the review of generated pictures catches and refuses",
        description="Render scenes under many lights, damage some of the pictures on purpose, and "
        "count how many of them the review of `pbrfit generate` finds and how many honest ones it "
        "refuses. Writes report.html, its figures, review.md, pictures.csv and summary.json. Exit "
        "code 1 if a bar is not reached. Without Blender Cycles (make cycles-env) only our own "
        "renders are judged.",
    )
    added.set_defaults(command=_run)
    add_options(added)
    added.add_argument(
        "--first-seed",
        metavar="SEED",
        type=whole_number,
        help="of the first scene of each source (default: 6000)",
    )
    add_cycles_cache(added)
    added.add_argument(
        "--no-cycles", action="store_true", help="only our own renders, even with Cycles there"
    )
    added.add_argument("--quick", action="store_true", help="two scenes of 256 pixels")


def _run(options: argparse.Namespace) -> int:
    from pbrfit_evaluation import cycles, review, workspace
    from pbrfit_evaluation.review import report

    effort = review.QUICK if options.quick else review.FULL
    why_not = "not asked for" if options.no_cycles else cycles.why_not()
    if why_not:
        own = tuple(source for source in effort.sources if source.renderer == "own")
        effort = replace(effort, sources=own)
    seed = review.FIRST_SEED if options.first_seed is None else options.first_seed
    cache = None if options.cycles_cache is None else options.cycles_cache.resolve()
    tasks = review.plan(effort, seed, cache)
    records = run_tasks(tasks, review.work, options)
    scenes = [
        report.Scene(task, review.judged(record.values))
        for task, record in zip(tasks, records, strict=True)
        if record.values is not None
    ]
    if scenes:
        setup = [
            f"{effort.size} × {effort.size} pixels, {effort.pictures} pictures beside the "
            f"photograph, seeds from {seed}, 8-bit sRGB. Five of the pictures of each of "
            f"{effort.sets} sets are damaged.",
            f"Renders by Cycles left out: {why_not}." if why_not else "Cycles casts hard shadows.",
        ]
        with workspace.publish(options.out) as folder:
            report.write(folder, scenes, setup)
        if not options.quiet:
            with unread_is_no_failure():
                print("\n".join(report.lines(scenes)))
                print(f"\nLook at {options.out / 'report.html'}")
    failed = exit_code(records)
    if failed:
        return failed
    return DONE if all(demand.holds for demand in report.demands(scenes)) else SOME_FAILED
