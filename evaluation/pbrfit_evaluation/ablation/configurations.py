"""What is compared: sets of priors."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from pbrfit.result.options import Priors, Solver, prior_names
from pbrfit_evaluation.recipes import PAPER_PRIORS


@dataclass(frozen=True)
class Configuration:
    """Options of a fit that are compared; `key` is for files and `title` for people.

    `priors` None = no priors.
    """

    key: str
    title: str
    priors: Priors | None

    @property
    def solver(self) -> Solver:
        """The default where it knows the priors."""
        of = self.priors
        others = of is not None and (of.cohesion or of.smoothness or of.sparsity)
        return "lbfgsb" if others else "gauss-newton"


def alone(name: str, weight: float) -> Configuration:
    """A single prior of some weight."""
    priors = replace(Priors.none(), **{name: weight})
    return Configuration(f"{name}={weight:g}", f"{name} {weight:g} alone", priors)


def each_off(of: Configuration) -> list[Configuration]:
    """A configuration without each of its priors in turn."""
    assert of.priors is not None
    return [
        replace(
            of,
            key=f"{of.key}-no-{name}",
            title=f"{of.title} without {name}",
            priors=replace(of.priors, **{name: 0.0}),
        )
        for name in prior_names()
        if getattr(of.priors, name) != 0
    ]


NONE = Configuration("none", "no priors", None)
"""What all others are compared with."""

DEFAULT = Configuration("default", "default", Priors())
PAPER = Configuration("paper", "the paper's four", PAPER_PRIORS)

WEIGHTS = replace(PAPER_PRIORS, material=1.0)
"""At which each prior is tried alone."""

CONFIGURATIONS: tuple[Configuration, ...] = (
    NONE,
    DEFAULT,
    alone("material", 1.0),
    PAPER,
    *each_off(PAPER),
)
"""Those of every case."""

FEW: tuple[Configuration, ...] = (NONE, DEFAULT, alone("cohesion", WEIGHTS.cohesion))
"""For a quick look; and what pictures show."""


def table(*, quick: bool) -> tuple[Configuration, ...]:
    """What is fitted in every case."""
    return FEW if quick else CONFIGURATIONS


VARIED: tuple[str, ...] = ("material", "cohesion")
"""Priors whose weight is varied, each alone."""


def curves(weights: Iterable[float]) -> tuple[Configuration, ...]:
    """Each prior of `VARIED` at several weights; weight 0 is `NONE`."""
    weights = tuple(weights)
    return tuple(alone(name, weight) for name in VARIED for weight in weights)
