"""What suites of many tasks share: options, progress, an interruption that can be made good."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn, TypeVar

from pbrfit.commands.arguments import (
    SOME_FAILED,
    UNUSABLE,
    add_cluster,
    add_jobs,
    add_out,
    add_quiet,
    complain,
    progress_bar,
)
from pbrfit.model.reflection import MODELS, Model
from pbrfit_evaluation.jobs import Record, Task, Values, run

T = TypeVar("T", bound=Task)


def add_options(
    parser: argparse.ArgumentParser, *, jobs: int | None = None, timed: bool = False
) -> None:
    """Add `--out`, `--overwrite`, `--resume`, `--jobs`, `--cluster` and `--quiet`.

    `jobs` is the default where there is no cluster; None = one for each processor. A suite whose
    figures are `timed` on this machine takes no cluster, and says why.
    """
    add_out(parser, "folder to write")
    parser.add_argument(
        "--resume",
        action="store_true",
        help="go on with an earlier run: what it finished with the same options and code is kept",
    )
    default = jobs or os.cpu_count() or 1
    on_cluster = "" if timed else "; on a cluster one for each worker"
    add_jobs(
        parser,
        f"scenes at the same time, each in a process of its own (default: {default}{on_cluster})",
    )
    if timed:
        parser.add_argument("--cluster", type=_refused, help=argparse.SUPPRESS)
    else:
        add_cluster(parser)
    parser.set_defaults(default_jobs=default)
    add_quiet(parser)


def _refused(_: str) -> NoReturn:
    raise argparse.ArgumentTypeError("not for this suite, whose seconds are those of one machine")


BOTH = "both"
"""Value of `--model` for every model, one after the other."""


def add_models(parser: argparse.ArgumentParser, what: str) -> None:
    """Add `--model` of a suite that can do both."""
    parser.add_argument(
        "--model",
        choices=(*MODELS, BOTH),
        default=BOTH,
        help=f"what {what}, of `pbrfit decompose --model` (default: %(default)s)",
    )


def models(options: argparse.Namespace) -> tuple[Model, ...]:
    """Those that `--model` asks for."""
    return MODELS if options.model == BOTH else (options.model,)


def add_cycles_cache(parser: argparse.ArgumentParser) -> None:
    """Add `--cycles-cache`, of suites that render with Blender Cycles."""
    parser.add_argument(
        "--cycles-cache",
        metavar="DIR",
        type=Path,
        help="where renders are kept (default: the user's cache folder)",
    )


def run_tasks(
    tasks: Sequence[T],
    work: Callable[[T, int], Values],
    options: argparse.Namespace,
    *,
    unit: str = "scene",
) -> list[Record]:
    """Run them with a progress bar; tell failures as they come.

    Raises
    ------
    KeyboardInterrupt
        With a message that says how to go on.
    """
    from pbrfit_evaluation import workspace

    if options.jobs is None and options.cluster is None:
        options.jobs = options.default_jobs
    workspace.prepare(options.out, resume=options.resume, overwrite=options.overwrite)
    return go_on(tasks, work, options, jobs=options.jobs, cluster=options.cluster, unit=unit)


def go_on(
    tasks: Sequence[T],
    work: Callable[[T, int], Values],
    options: argparse.Namespace,
    *,
    jobs: int | None,
    cluster: str | None = None,
    unit: str,
    complaints: int | None = None,
) -> list[Record]:
    """Run tasks in a folder that `run_tasks` has made: such as wait for others, or run alone.

    At most so many `complaints` are shown, where all fail for one reason; None = all.

    Raises
    ------
    KeyboardInterrupt
        As `run_tasks`.
    """
    with progress_bar(len(tasks), quiet=options.quiet, unit=unit) as bar:
        done = failed = 0  # bar.n stays 0 where no bar is shown

        def show(record: Record) -> None:
            nonlocal done, failed
            done += 1
            bar.set_postfix_str(record.key, refresh=False)
            bar.update()
            failed += record.error is not None
            if record.error is not None and (complaints is None or failed <= complaints):
                with bar.external_write_mode():
                    complain(f"{record.key}: {record.error}")

        try:
            return run(tasks, work, options.out, jobs=jobs, cluster=cluster, progress=show)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                f"interrupted after {done} of {len(tasks)}; --resume goes on from there"
            ) from None


def exit_code(records: Sequence[Record]) -> int:
    """0 if all went well, 1 if some failed, 2 if all did; says which."""
    failed = [record.key for record in records if record.error is not None]
    if not failed:
        return 0
    complain(f"{len(failed)} of {len(records)} failed: {', '.join(failed)}")
    return SOME_FAILED if len(failed) < len(records) else UNUSABLE
