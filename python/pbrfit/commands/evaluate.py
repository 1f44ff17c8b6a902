"""`pbrfit evaluate`: suites that the distribution pbrfit-evaluation adds."""

from __future__ import annotations

import argparse
from importlib.metadata import entry_points

from pbrfit.commands.arguments import UNUSABLE, Subcommands

ABSENT = "the suites are a package of their own: pip install pbrfit-evaluation"


def add(commands: Subcommands) -> None:
    """Add the command to `pbrfit`."""
    commands.add_parser(
        "evaluate",
        help="measure this package and write a report",
        description="Run a suite of measurements and write its report.",
        complete=_add_suites,
    )


def _add_suites(parser: argparse.ArgumentParser) -> None:
    """Add the suites that are installed, or end with how to install them."""
    for point in entry_points(group="pbrfit.commands", name="evaluate"):
        suites = parser.add_subparsers(metavar="SUITE", required=True, title="suites")
        point.load()(suites)
        return
    parser.exit(UNUSABLE, f"{parser.prog}: {ABSENT}\n")
