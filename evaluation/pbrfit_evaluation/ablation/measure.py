"""A room of a case, fitted with one set of priors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from pbrfit.result.options import Priors, prior_names
from pbrfit_evaluation.ablation.cases import TITLES, VARIED_IN, case
from pbrfit_evaluation.grid import Case, Grid, measured
from pbrfit_evaluation.recipes import PAPER_PRIORS, Way

WEIGHTS = (0.01, 0.1, 1.0, 10.0)
"""At which a prior is tried alone."""

VARIED = ("material", "cohesion")
"""Priors whose weight is varied, each alone."""


def _with(title: str, priors: Priors) -> Way:
    """By the default solver where it knows the priors."""
    penalties = priors.cohesion or priors.smoothness or priors.sparsity
    return Way(title, {"priors": priors, "solver": "lbfgsb" if penalties else "gauss-newton"})


def _alone(name: str, weight: float) -> Way:
    priors = replace(Priors.none(), **{name: weight})
    return _with(f"{name} {weight:g} alone", priors)


TABLE: Mapping[str, Way] = {
    "none": Way("no priors", {"priors": None}),
    "default": Way("default"),
    "material=1": _alone("material", 1.0),
    "paper": _with("the paper's four", PAPER_PRIORS),
    **{
        f"paper-no-{name}": _with(
            f"the paper's four without {name}", replace(PAPER_PRIORS, **{name: 0.0})
        )
        for name in prior_names()
        if getattr(PAPER_PRIORS, name) != 0
    },
}
"""Priors that are tried in every case; all are compared with the first."""

CURVES: Mapping[str, Way] = {
    f"{name}={weight:g}": _alone(name, weight) for name in VARIED for weight in WEIGHTS
}

FEW = ("none", "default", "cohesion=0.1")
"""For a quick look; and what pictures show."""

WAYS = {**TABLE, **CURVES}

GRID = Grid(
    TITLES,
    WAYS,
    of_condition={name: (*TABLE, FEW[-1]) for name in TITLES if name not in VARIED_IN},
    kinds=("room",),
    pictured=FEW,
    few_ways=FEW,
)


def run(of: Case, threads: int) -> dict[str, Any]:
    """Scores, and perhaps maps."""
    assert of.model is not None
    scene = case(of.condition, of.seed, size=of.size, model=of.model)
    return measured(of, WAYS[of.way], scene, threads)[1]
