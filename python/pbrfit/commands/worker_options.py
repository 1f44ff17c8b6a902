"""Options that say where tasks run."""

from __future__ import annotations

import argparse

from pbrfit.commands.arguments import positive


def add_jobs(parser: argparse.ArgumentParser, what: str, default: int | None = None) -> None:
    """Add `--jobs`."""
    parser.add_argument("--jobs", metavar="J", type=positive, default=default, help=what)


def add_cluster(parser: argparse.ArgumentParser) -> None:
    """Add `--cluster`."""
    parser.add_argument(
        "--cluster",
        metavar="local|ADDRESS",
        help="hand scenes to the workers of a dask scheduler, which share storage with this "
        "machine, or to a cluster on this machine alone; --jobs limits how many at the same time; "
        "needs pip install 'pbrfit[cluster]'",
    )
