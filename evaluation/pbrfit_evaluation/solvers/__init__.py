"""The second-order solver: whether it reaches what it is there for, and at what cost."""

from __future__ import annotations

from pbrfit_evaluation.options import count
from pbrfit_evaluation.solvers import figures
from pbrfit_evaluation.solvers.measure import GRID, run
from pbrfit_evaluation.suite import Part, Suite

FIRST_SEED = 1000
"""Rooms from here on are those of `pbrfit evaluate table1`."""

SUITE = Suite(
    name="solvers",
    title="The second-order solver",
    protocol="pbrfit-solvers-1, {effort}",
    parts=[Part.shown_by(figures, "solvers", GRID.cases, run)],
    options=(
        *GRID.options(FIRST_SEED, scenes="of every condition (default: as each needs)"),
        count("--iterations", "K", "of a fit"),
    ),
    effort=GRID.effort()
    | {"scenes": ((67, 10), (2, 1)), "size": (128, 32), "iterations": (500, 100)},
    about=(
        "Whether the second-order solver “gauss-newton” reaches what it is there for, beside "
        "“lbfgsb”, scipy's L-BFGS-B, in rooms without noise, to the last digits, and with noise. "
        "docs/solvers.md says what is measured, and what must hold.",
    ),
    jobs=1,
    timed=True,
)
