"""`pbrfit evaluate gap`."""

from __future__ import annotations

import argparse

from pbrfit.commands.arguments import (
    DONE,
    Subcommands,
    add_out,
    add_quiet,
    progress_bar,
    unread_is_no_failure,
    whole_number,
)
from pbrfit_evaluation.commands.resumable import add_cycles_cache


def add(suites: Subcommands) -> None:
    """Add the suite to `pbrfit evaluate`."""
    added = suites.add_parser(
        "gap",
        help="the reflection models against full reflection integrals and Cycles",
        description="Compare the models that pbrfit fits with brute-force integration of BRDFs, "
        "over roughness, view angle and SH band, and with spheres rendered by Blender Cycles. "
        "Writes report.html, heat maps, gap.csv, spheres.csv, cycles.csv and summary.json.",
    )
    added.set_defaults(command=_run)
    add_out(added, "folder to write")
    added.add_argument("--quick", action="store_true", help="a coarser table, without Cycles")
    added.add_argument("--seed", type=whole_number, default=0, help="of the random lights")
    add_cycles_cache(added)
    add_quiet(added)


def _run(options: argparse.Namespace) -> int:
    from pbrfit.io.output import new_folder
    from pbrfit_evaluation import cycles, gap
    from pbrfit_evaluation.gap import report, spheres

    effort = gap.QUICK if options.quick else gap.FULL
    why_not = "--quick leaves Cycles out" if options.quick else cycles.why_not()
    steps = 3 * len(effort.r) + (0 if why_not else len(spheres.Effort().r))
    with new_folder(options.out, overwrite=options.overwrite, contains=report.CONTAINS) as folder:
        with progress_bar(steps, quiet=options.quiet) as bar:
            begun = 0

            def show(roughness: float) -> None:
                nonlocal begun
                bar.set_description(f"r = {roughness:g}")
                bar.update(begun - bar.n)
                begun += 1

            gaps = gap.measure_all(effort, seed=options.seed, progress=show)
            on_cycles = why_not or spheres.measure(cache=options.cycles_cache, progress=show)
            bar.update(steps - bar.n)
        report.write(folder, gaps, on_cycles)
    if not options.quiet:
        with unread_is_no_failure():
            print("\n".join(report.lines(gaps, on_cycles)))
            print(f"\nLook at {options.out / 'report.html'}")
    return DONE
