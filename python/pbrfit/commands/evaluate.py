"""`pbrfit evaluate`: the suites are in `evaluation/commands/`."""

from __future__ import annotations

from pbrfit.arguments import Subcommands
from pbrfit.evaluation.commands import add_suites


def add(commands: Subcommands) -> None:
    """Add the command to `pbrfit`."""
    suites = commands.add_parser(
        "evaluate",
        help="measure this package and write a report",
        description="Run a suite of measurements and write its report.",
    ).add_subparsers(metavar="SUITE", required=True, title="suites")
    add_suites(suites)
