"""`pbrfit evaluate stability`."""

from __future__ import annotations

import argparse

from pbrfit.commands.arguments import (
    DONE,
    SOME_FAILED,
    Subcommands,
    add_out,
    add_quiet,
    add_threads,
    progress_bar,
    unread_is_no_failure,
    whole_number,
)


def add(suites: Subcommands) -> None:
    """Add the suite to `pbrfit evaluate`."""
    added = suites.add_parser(
        "stability",
        help="numerical stability of the core",
        description="Check band weights, loss and gradient against exact or float64 references, "
        "and state a bound for every figure. Writes report.html, its plots and summary.json. "
        "Exit code 1 if a bound fails.",
    )
    added.set_defaults(command=_run)
    add_out(added, "folder to write")
    added.add_argument(
        "--quick", action="store_true", help="seconds instead of minutes: fewer pixels"
    )
    added.add_argument("--seed", type=whole_number, default=0, help="of pixels, lights, pictures")
    add_threads(added)
    add_quiet(added)


def _run(options: argparse.Namespace) -> int:
    from pbrfit.io.output import new_folder
    from pbrfit_evaluation import stability
    from pbrfit_evaluation.stability import report

    with new_folder(options.out, overwrite=options.overwrite, contains=report.CONTAINS) as folder:
        sections = len(stability.SECTIONS)
        with progress_bar(sections, quiet=options.quiet, unit="section") as bar:

            def show(section: str) -> None:
                bar.set_description(section)
                bar.update(stability.SECTIONS.index(section) - bar.n)

            measured = stability.measure(
                stability.QUICK if options.quick else stability.FULL,
                seed=options.seed,
                threads=options.threads,
                progress=show,
            )
            bar.update(sections - bar.n)
        report.write(folder, measured)
    if not options.quiet:
        with unread_is_no_failure():
            print(f"{'worst':>9}{'bound':>9}")
            for check in measured.checks:
                if check.bound is not None:
                    mark = "" if check.passed else "   FAILS"
                    print(f"{check.worst:>9.1e}{check.bound:>9.1e}  {check.what}{mark}")
            print(f"\n{report.verdict(measured)}; look at {options.out / 'report.html'}")
    return DONE if measured.passed else SOME_FAILED
