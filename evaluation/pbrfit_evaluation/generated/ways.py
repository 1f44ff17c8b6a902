"""What is done with stand-in pictures: the stages of the comparison, a row each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pbrfit.result.options import Priors
from pbrfit_evaluation.generated.stand_ins import Level

BARE: Mapping[str, Any] = {
    "align": "off",
    "robust": "none",
    "response": "srgb",
    "equal_exposures": False,
    "refine_normals": "off",
    "light": "sh",
}
"""Options that take pictures as they are."""

ALIGN: Mapping[str, Any] = {"align": "auto"}
ROBUST: Mapping[str, Any] = {"robust": "auto"}
EXPOSURE: Mapping[str, Any] = {"response": "auto", "equal_exposures": None}

PRIOR: Mapping[str, Any] = {"priors": Priors(material=1.0)}

TOGETHER: Mapping[str, Any] = {**BARE, **ALIGN, **ROBUST, **EXPOSURE, **PRIOR}

NORMALS_OFF = 8.0
"""Degrees, θ of `normals.disturbances`: estimated normals are off by 10 degrees in the mean."""


@dataclass(frozen=True)
class Way:
    """A level of damage and what is done about it.

    Attributes
    ----------
    key, words
        In records and tables.
    level
        Of the pictures.
    options
        Of `pbrfit.decompose`.
    review
        Whether pictures are reviewed first.
    normals
        "true", or "estimated": with the errors of an estimator, and with a network's depth.
    path
        Whether commands do it, from files to files.
    guess
        Whether nothing is fitted.
    """

    key: str
    words: str
    level: Level
    options: Mapping[str, Any]
    review: bool = False
    normals: str = "true"
    path: bool = False
    guess: bool = False


WAYS = (
    Way("constant", "constant guess", "exact", {}, guess=True),
    Way("exact", "exact pictures", "exact", BARE),
    Way("toned", "tone curves, exposures, 8 bits", "toned", BARE),
    Way("drifted", "and a quarter drifted", "drifted", BARE),
    Way("repainted", "and a quarter repainted or of something else", "repainted", BARE),
    Way("review", "all damage: review alone", "repainted", BARE, review=True),
    Way("align", "all damage: alignment alone", "repainted", {**BARE, **ALIGN}),
    Way("robust", "all damage: robust weights alone", "repainted", {**BARE, **ROBUST}),
    Way("exposure", "all damage: exposure handling alone", "repainted", {**BARE, **EXPOSURE}),
    Way("together", "all damage: all together", "repainted", TOGETHER, review=True),
    Way(
        "estimated",
        "all together, estimated normals and depth",
        "repainted",
        {**TOGETHER, "refine_normals": "auto"},
        review=True,
        normals="estimated",
    ),
    Way("exact-handled", "exact pictures: all together", "exact", TOGETHER, review=True),
    Way("path", "all damage: generate, decompose, export", "repainted", {}, True, path=True),
)

BY_KEY = {way.key: way for way in WAYS}

FEW = ("constant", "exact", "repainted", "together", "path")
"""Those of a quick look."""
