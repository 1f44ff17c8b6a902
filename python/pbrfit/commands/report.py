"""`pbrfit report`."""

from __future__ import annotations

import argparse
from pathlib import Path

from pbrfit.commands.arguments import DONE, Subcommands, add_command, add_quiet, add_result


def add(commands: Subcommands) -> None:
    """Add the command to `pbrfit`."""
    added = add_command(
        commands, "report", _run, "write a page about a result, to be looked at in a browser"
    )
    add_result(added, "FILE", "page to write, FILE.html")
    added.add_argument(
        "--scene",
        metavar="SCENE",
        type=Path,
        help="scene folder that the result was made from (default: where it was then)",
    )
    add_quiet(added)


def _run(options: argparse.Namespace) -> int:
    from pbrfit.report import write_report
    from pbrfit.result.result import Result

    result = Result.load(options.result)
    write_report(result, options.out, options.scene, options.overwrite)
    if not options.quiet:
        size = options.out.stat().st_size / 1e6
        print(f"{options.out}: {size:.1f} MB, open it in a browser")
    return DONE
