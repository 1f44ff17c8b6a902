"""The suites as sub-commands of `pbrfit evaluate`, one file each; measuring is imported late."""

from __future__ import annotations

from pbrfit.commands.arguments import Subcommands
from pbrfit_evaluation.commands import (
    ablation,
    convergence,
    gap,
    normals,
    peers,
    real,
    review,
    solvers,
    stability,
    table1,
    uncertainty,
)

SUITES = (
    table1,
    ablation,
    convergence,
    gap,
    normals,
    peers,
    real,
    review,
    solvers,
    stability,
    uncertainty,
)


def add_suites(suites: Subcommands) -> None:
    """Add them all."""
    for suite in SUITES:
        suite.add(suites)
