"""Rooms under lamps: what lamps as such are worth to a fit, and where it finds them."""

from __future__ import annotations

from pbrfit_evaluation.explained import cases_of, options_of
from pbrfit_evaluation.explained.measure import run
from pbrfit_evaluation.explained.variants import GUESS, HARMONICS, NEAR, OF_LAMPS
from pbrfit_evaluation.lamps import figures
from pbrfit_evaluation.scores import PROTOCOL as SCORES
from pbrfit_evaluation.suite import Part, Suite

SETUPS = ("points-shadows", "points")

KEYS = tuple(variant.key for variant in OF_LAMPS)
FEW = (GUESS.key, HARMONICS, NEAR)
"""Variants, and those of a quick look."""

FIRST_SEED = 8200
"""Nothing was tuned on seeds from there on."""

SUITE = Suite(
    name="lamps",
    title="Rooms under lamps",
    description="Fit rooms that Blender Cycles renders under one point lamp a picture, with and "
    "without their depth. Writes report.html, a plot, maps, lamps.md, scenes.csv and summary.json. "
    "Exit code 1 if something does not hold.",
    protocol=f"pbrfit-lamps-1: {SCORES}; lamps one a picture, medians over a room's; {{size}} "
    "pixels, {lights} pictures, {effort}",
    parts=[Part.shown_by(figures, "lamps", cases_of(KEYS, KEYS), run)],
    options=options_of(SETUPS, SETUPS[0], KEYS, FEW, FIRST_SEED),
    effort={
        "setups": (SETUPS[:1], SETUPS[:1]),
        "variants": (KEYS, FEW),
        "scenes": (10, 2),
        "size": (64, 24),
    },
    quick="minutes: two small rooms",
    about=(
        "Rooms with furniture, each picture lit by one lamp without size and of its own colour, "
        "somewhere in the upper half of the room or near the camera; rendered by Blender Cycles "
        "without light that surfaces reflect. Normals and segments are true, depth too where it is "
        "told. The constant guess has roughness 0.5, metallic 0 and the mean of the true albedo. "
        "Figures are means over rooms, with 95 % intervals by bootstrap over rooms in brackets.",
    ),
    timed=True,
    verdict_rows=True,
)
