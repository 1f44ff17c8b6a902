"""What is done with stand-in pictures: the stages of the comparison, a row each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pbrfit.result.options import Priors
from pbrfit_evaluation import cycles
from pbrfit_evaluation.generated.stand_ins import Level
from pbrfit_evaluation.grid import Grid
from pbrfit_evaluation.recipes import GUESS, Way
from pbrfit_evaluation.suite import Options

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

REFINED: Mapping[str, Any] = {**TOGETHER, "refine_normals": "auto"}

NORMALS_OFF = 8.0
"""Degrees, θ of `normals.disturbances`: estimated normals are off by 10 degrees in the mean."""


@dataclass(frozen=True)
class Handled(Way):
    """A level of damage and what is done about it."""

    level: Level = "repainted"
    """Of the pictures."""
    review: bool = False
    """Whether pictures are reviewed first."""
    normals: str = "true"
    """"true", or "estimated": with the errors of an estimator, and with a network's depth."""
    path: bool = False
    """Whether commands do it, from files to files."""
    maps: str = ""
    """Whose maps are estimates of the scene: "own" or "another"'s; empty = there are none."""


WAYS: Mapping[str, Handled] = {
    "constant": Handled(**vars(GUESS), level="exact"),
    "exact": Handled("exact pictures", BARE, level="exact"),
    "toned": Handled("tone curves, exposures, 8 bits", BARE, level="toned"),
    "drifted": Handled("and a quarter drifted", BARE, level="drifted"),
    "repainted": Handled("and a quarter repainted or of something else", BARE),
    "review": Handled("all damage: review alone", BARE, review=True),
    "align": Handled("all damage: alignment alone", {**BARE, **ALIGN}),
    "robust": Handled("all damage: robust weights alone", {**BARE, **ROBUST}),
    "exposure": Handled("all damage: exposure handling alone", {**BARE, **EXPOSURE}),
    "together": Handled("all damage: all together", TOGETHER, review=True),
    "maps": Handled("all together, a network's maps", TOGETHER, review=True, maps="own"),
    "other-maps": Handled(
        "all together, maps of another room", TOGETHER, review=True, maps="another"
    ),
    "estimated": Handled(
        "all together, estimated normals and depth", REFINED, review=True, normals="estimated"
    ),
    "estimated-maps": Handled(
        "all together, estimated normals and depth, a network's maps",
        REFINED,
        review=True,
        normals="estimated",
        maps="own",
    ),
    "exact-handled": Handled("exact pictures: all together", TOGETHER, level="exact", review=True),
    "path": Handled("all damage: generate, decompose, export", review=True, path=True),
}
"""By key; words are those of tables."""

PICTURED = ("exact", "repainted", "together", "maps", "path")
"""Ways whose maps are shown."""


def by_cycles(options: Options) -> bool:
    """Whether Cycles renders the rooms: where it is there, but for a quick look."""
    return not (options.quick or cycles.why_not())


def why_not(options: Options, key: str, _: str) -> str:
    """Why a way cannot be run; empty if it can."""
    lacks = WAYS[key].normals == "estimated" and not by_cycles(options)
    return "rooms by our renderer have no depth" if lacks else ""


GRID = Grid(
    {key: way.words for key, way in WAYS.items()},
    pictured=PICTURED,
    few=("constant", "exact", "repainted", "together", "maps", "path"),
    why_not=why_not,
)
"""What is done is the condition; kinds "cycles" and "own" say what renders the rooms."""
