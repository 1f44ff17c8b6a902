"""`pbrfit evaluate SUITE`: each suite as a sub-command, made from its `Suite`, and run.

A suite is imported when it is asked for; `pbrfit evaluate --help` knows names and summaries alone.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from pbrfit.commands import arguments as cli

if TYPE_CHECKING:
    from pbrfit_evaluation.jobs import Record, Values
    from pbrfit_evaluation.suite import Suite

SUITES = {
    "ablation": "what each prior is worth, where it holds and where it does not",
    "convergence": "error against run time, for every solver, start and peer",
    "diligent": "photometric stereo: normals beside true ones, lamps told or unknown",
    "everyday": "8 bits, JPEG, clipping, bad pictures and unknown cameras beside clean floats",
    "gap": "the reflection models against full reflection integrals and Cycles",
    "generated": "what faults of generated pictures cost, from photograph to Blender",
    "heldout": "held-out pictures of real scenes: the default beside flags, recipe and baselines",
    "lamps": "what lamps as such are worth in rooms, and where they are found",
    "normals": "what wrong normals cost, and how much of it refining wins back",
    "peers": "networks that see one picture, beside our fit of all",
    "review": "what the review of generated pictures catches and refuses",
    "solvers": "whether gauss-newton reaches what it must",
    "stability": "numerical stability of the core",
    "table1": "errors of materials and relighting on scenes whose ground truth is known",
    "transport": "what depth is worth where light is blocked and bounces",
    "uncertainty": "whether deviations, intervals and verdicts are right where the model is wrong",
}
"""Summaries by name; `pbrfit_evaluation.NAME.figures.SUITE` is the suite."""


def add_suites(suites: cli.Subcommands) -> None:
    """Add them all to `pbrfit evaluate`."""
    for name, summary in SUITES.items():
        suites.add_parser(name, help=summary, complete=partial(_complete, name))


def _complete(name: str, parser: argparse.ArgumentParser) -> None:
    """Import a suite and add its options."""
    suite: Suite[Any] = import_module(f"pbrfit_evaluation.{name}.figures").SUITE
    parser.description = (
        f"{suite.about[0]} Writes report.html with its plots, {name}.md, CSV files and "
        "summary.json. Exit code 1 if something does not hold."
    )
    cli.add_out(parser, "folder to write")
    resume = "go on with an earlier run: what it finished with the same options and code is kept"
    cli.add_flags(parser, resume=cli.switch(resume))
    default = suite.jobs or os.cpu_count() or 1
    on_cluster = "" if suite.timed else "; on a cluster one for each worker"
    cli.add_jobs(
        parser,
        f"cases at the same time, each in a process of its own (default: {default}{on_cluster})",
    )
    if suite.timed:
        parser.add_argument("--cluster", type=_refused, help=argparse.SUPPRESS)
    else:
        cli.add_cluster(parser)
    cli.add_quiet(parser)
    if suite.folders:
        said = f"{suite.folders} (default: the folder that the variable PBRFIT_DATA names)"
        parser.add_argument("folders", metavar="FOLDER", nargs="*", type=Path, help=said)
    for name, setting in suite.settings.items():
        if setting.flag is not None:
            cli.add_flags(parser, **{setting.name or name: {**setting.flag, "dest": name}})
    docs = "documentation of a checkout: bring its tables and plots of this suite up to date"
    cli.add_flags(
        parser,
        quick=cli.switch("few and small scenes, what takes minutes left out"),
        docs=cli.value("DIR", Path, docs),
    )
    parser.set_defaults(command=partial(run, suite))


def _refused(_: str) -> NoReturn:
    raise argparse.ArgumentTypeError("not for this suite, whose seconds are those of one machine")


def run(suite: Suite[Any], options: argparse.Namespace) -> int:
    """Run a suite and write its report; returns the exit code.

    Raises KeyboardInterrupt with a message that says how to go on.
    """
    from pbrfit_evaluation import jobs, report
    from pbrfit_evaluation.report import evidence
    from pbrfit_evaluation.suite import Results

    suite.settle(options)
    cases = list(suite.cases(options))
    if options.jobs is None and options.cluster is None:
        options.jobs = suite.jobs or os.cpu_count() or 1
    jobs.prepare(options.out, resume=options.resume, overwrite=options.overwrite)
    records = _measure(suite, cases, options)
    found = report.outcome(suite, Results(options, list(zip(cases, records, strict=True))))
    with jobs.publish(options.out) as folder:
        report.write(folder, suite, options, found)
    if options.docs is not None:
        evidence.publish(options.docs, suite.name, options.out)
    if not options.quiet:
        with cli.unread_is_no_failure():
            print("\n".join(report.lines(found)))
            print(f"\nLook at {options.out / report.PAGE}")
    failed = [record.key for record in found.failed]
    if failed:
        cli.complain(f"{len(failed)} of {len(cases)} failed: {', '.join(failed)}")
        return cli.SOME_FAILED if len(failed) < len(cases) else cli.UNUSABLE
    held = all(verdict.holds for verdict in found.verdicts)
    return cli.DONE if held else cli.SOME_FAILED


def _do(run: Callable[[Any, int], Values], asked: int, case: Any, threads: int) -> Values:
    return run(case, asked or threads)


def _measure(suite: Suite[Any], todo: list[Any], options: argparse.Namespace) -> list[Record]:
    """Run cases with a progress bar; tell failures as they come, those of one reason once."""
    from pbrfit_evaluation import jobs

    with cli.progress_bar(len(todo), quiet=options.quiet, unit="case") as bar:
        done = 0  # bar.n stays 0 where no bar is shown
        told: set[str] = set()

        def show(record: Record) -> None:
            nonlocal done
            done += 1
            bar.set_postfix_str(record.key, refresh=False)
            bar.update()
            if record.error is not None and record.error not in told:
                told.add(record.error)
                with bar.external_write_mode():
                    cli.complain(f"{record.key}: {record.error}")

        try:
            return jobs.run(
                todo,
                partial(_do, suite.run, getattr(options, "threads", 0)),
                options.out,
                jobs=options.jobs,
                cluster=options.cluster,
                progress=show,
            )
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                f"interrupted after {done} of {len(todo)}; --resume goes on from there"
            ) from None
