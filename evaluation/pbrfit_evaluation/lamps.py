"""Rooms under lamps: what lamps as such are worth to a fit, and where it finds them."""

from __future__ import annotations

from pbrfit_evaluation.explained import figures
from pbrfit_evaluation.explained.measure import HARMONICS, LAMPS, NEAR, run
from pbrfit_evaluation.options import count, cycles_cache
from pbrfit_evaluation.scores import PROTOCOL as SCORES
from pbrfit_evaluation.suite import Part, Suite

FIRST_SEED = 8200

DEFAULT = ("points-shadows",)
FEW_WAYS = ("constant", HARMONICS, NEAR)
"""Variants of a quick look."""

SUITE = Suite(
    name="lamps",
    title="Rooms under lamps",
    protocol=f"pbrfit-lamps-1: {SCORES}; lamps one a picture, medians over a room's; {{size}} "
    "pixels, {lights} pictures, {effort}",
    parts=[Part.shown_by(figures, "lamps", LAMPS.cases, run, "lamps_")],
    options=(
        *LAMPS.options(
            *(FIRST_SEED, "--setups"),
            default=DEFAULT[0],
            ways="--variants",
            few_ways=FEW_WAYS,
            scenes="rooms of a setup",
        ),
        count("--lights", "N", "pictures a room", default=16),
        cycles_cache,
    ),
    effort=LAMPS.effort(few_ways=FEW_WAYS)
    | {"conditions": (DEFAULT, DEFAULT), "scenes": (10, 2), "size": (64, 24)},
    about=(
        "Rooms with furniture, each picture lit by one lamp without size and of its own colour, "
        "somewhere in the upper half of the room or near the camera; rendered by Blender Cycles "
        "without light that surfaces reflect. Normals and segments are true, depth too where it "
        "is told. The constant guess has roughness 0.5, metallic 0 and the mean of the true "
        "albedo. Figures are means over rooms, with 95 % intervals by bootstrap over rooms in "
        "brackets.",
    ),
    timed=True,
)
