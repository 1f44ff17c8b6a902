"""`pbrfit evaluate`: suites that the distribution pbrfit-evaluation adds."""

from __future__ import annotations

import argparse
from importlib.metadata import entry_points

from pbrfit.commands.arguments import UNUSABLE

ABSENT = "the suites are a package of their own: pip install pbrfit-evaluation"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the suites that are installed, or end with how to install them."""
    parser.description = "Run a suite of measurements and write its report."
    for point in entry_points(group="pbrfit.commands", name="evaluate"):
        suites = parser.add_subparsers(metavar="SUITE", required=True, title="suites")
        point.load()(suites)
        return
    parser.exit(UNUSABLE, f"{parser.prog}: {ABSENT}\n")
