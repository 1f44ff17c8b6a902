"""`pbrfit evaluate SUITE`: each suite as a sub-command, made from its `Suite`, and run.

A suite is imported when it is asked for; `pbrfit evaluate --help` knows names and summaries alone.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from pbrfit.commands.arguments import (
    DONE,
    SOME_FAILED,
    UNUSABLE,
    Subcommands,
    add_cluster,
    add_jobs,
    add_out,
    add_quiet,
    complain,
    progress_bar,
    unread_is_no_failure,
)

if TYPE_CHECKING:
    from pbrfit_evaluation.jobs import Record
    from pbrfit_evaluation.report import Outcome
    from pbrfit_evaluation.suite import Part, Row, Section, Suite, Verdict

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
"""Summaries by name; `pbrfit_evaluation.NAME.SUITE` is the suite."""


def add_suites(suites: Subcommands) -> None:
    """Add them all to `pbrfit evaluate`."""
    for name, summary in SUITES.items():
        suites.add_parser(name, help=summary, complete=partial(_complete, name))


def _complete(name: str, parser: argparse.ArgumentParser) -> None:
    """Import a suite and add its options."""
    from pbrfit_evaluation.options import several

    suite: Suite = import_module(f"pbrfit_evaluation.{name}").SUITE
    parser.description = (
        f"{suite.about[0]} Writes report.html with its plots, {name}.md, CSV files and "
        "summary.json. Exit code 1 if something does not hold."
    )
    add_out(parser, "folder to write")
    parser.add_argument(
        "--resume",
        action="store_true",
        help="go on with an earlier run: what it finished with the same options and code is kept",
    )
    default = suite.jobs or os.cpu_count() or 1
    on_cluster = "" if suite.timed else "; on a cluster one for each worker"
    add_jobs(
        parser,
        f"cases at the same time, each in a process of its own (default: {default}{on_cluster})",
    )
    if suite.timed:
        parser.add_argument("--cluster", type=_refused, help=argparse.SUPPRESS)
    else:
        add_cluster(parser)
    add_quiet(parser)
    if len(suite.parts) > 1:
        names = [part.name for part in suite.parts]
        several("--part", "NAME", names, what="only these parts")(parser)
    for add in suite.options:
        add(parser)
    few = "few and small scenes, what takes minutes left out"
    parser.add_argument("--quick", action="store_true", help=few)
    parser.add_argument(
        "--docs",
        metavar="DIR",
        type=Path,
        help="documentation of a checkout: bring its tables and plots of this suite up to date",
    )
    for action in parser._actions:
        full, quick = suite.effort.get(action.dest, (None, None))
        if isinstance(full, (int, float)) and action.default is None and action.help:
            less = f", with --quick {quick}" if quick != full else ""
            action.help += f" (default: {full}{less})"
    told = [action for action in parser._actions if action.dest != "help"]
    parser.set_defaults(
        command=partial(run, suite),
        spelled={one.dest: max(one.option_strings, key=len, default="") for one in told},
        defaults={one.dest: one.default for one in told},
    )


def _refused(_: str) -> NoReturn:
    raise argparse.ArgumentTypeError("not for this suite, whose seconds are those of one machine")


def run(suite: Suite, options: argparse.Namespace) -> int:
    """Run a suite and write its report; returns the exit code.

    Raises KeyboardInterrupt with a message that says how to go on.
    """
    from pbrfit_evaluation import jobs, report
    from pbrfit_evaluation.report import evidence

    options.effort = "quick" if options.quick else "full"
    for name, of_effort in suite.effort.items():
        if getattr(options, name, None) is None:
            setattr(options, name, of_effort[options.quick])
    chosen = getattr(options, "part", None)
    parts = [part for part in suite.parts if not chosen or part.name in chosen]
    cases = {part.name: list(part.cases(options)) for part in parts}
    if options.jobs is None and options.cluster is None:
        options.jobs = suite.jobs or os.cpu_count() or 1
    jobs.prepare(options.out, resume=options.resume, overwrite=options.overwrite)
    todo = [_Job(part.run, case) for part in parts for case in cases[part.name]]
    records = iter(_measure(todo, options))
    done = {part.name: [(case, next(records)) for case in cases[part.name]] for part in parts}
    found = _outcome(suite, parts, options, done)
    with jobs.publish(options.out) as folder:
        report.write(folder, suite, options, found)
    if options.docs is not None:
        evidence.publish(options.docs, suite.name, options.out)
    if not options.quiet:
        with unread_is_no_failure():
            print("\n".join(report.lines(found)))
            print(f"\nLook at {options.out / report.PAGE}")
    failed = [record.key for record in found.failed]
    if failed:
        total = sum(map(len, done.values()))
        complain(f"{len(failed)} of {total} failed: {', '.join(failed)}")
        return SOME_FAILED if len(failed) < total else UNUSABLE
    held = all(verdict.holds for verdict in found.verdicts)
    return DONE if held else SOME_FAILED


@dataclass(frozen=True)
class _Job:
    """A case and what runs it, together for another process; the case alone says what it is."""

    run: Callable[[Any, int], Any] = field(repr=False)
    case: Any

    @property
    def key(self) -> str:
        """Of the case."""
        return str(self.case.key)


def _do(job: _Job, threads: int, *, asked: int) -> Any:
    return job.run(job.case, asked or threads)


def _measure(todo: Sequence[_Job], options: argparse.Namespace) -> list[Record]:
    """Run cases with a progress bar; tell failures as they come, those of one reason once."""
    from pbrfit_evaluation import jobs

    with progress_bar(len(todo), quiet=options.quiet, unit="case") as bar:
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
                    complain(f"{record.key}: {record.error}")

        try:
            return jobs.run(
                todo,
                partial(_do, asked=getattr(options, "threads", 0)),
                options.out,
                jobs=options.jobs,
                cluster=options.cluster,
                progress=show,
            )
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                f"interrupted after {done} of {len(todo)}; --resume goes on from there"
            ) from None


def _outcome(
    suite: Suite,
    parts: Sequence[Part[Any]],
    options: argparse.Namespace,
    done: dict[str, list[tuple[Any, Record]]],
) -> Outcome:
    """What the suite makes of the records, all parts together."""
    from pbrfit_evaluation.report import Outcome
    from pbrfit_evaluation.suite import Results, csv_files

    rows: list[Row] = []
    verdicts: list[Verdict] = []
    sections: list[Section] = []
    failed: list[Record] = []
    files: dict[str, Any] = {}
    for part in parts:
        results = Results(options, done[part.name])
        of_part = part.figures(results)
        rows += of_part
        name = part.name if len(suite.parts) > 1 else ""
        verdicts += [replace(one, part=one.part or name) for one in part.verdicts(results, of_part)]
        sections += part.sections(results, of_part)
        for file, lines in csv_files(results).items():
            files.setdefault(file, []).extend(lines)
        files |= part.files(results)
        failed += results.failed
    return Outcome(rows, verdicts, sections, files, failed)
