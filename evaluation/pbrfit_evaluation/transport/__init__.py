"""Shadows and light from surface to surface, by geometry: what depth is worth to a fit."""

from __future__ import annotations

from pbrfit_evaluation.explained import cases_of, options_of
from pbrfit_evaluation.explained.measure import run
from pbrfit_evaluation.explained.variants import GUESS, OF_GEOMETRY, TRUE, WITHOUT
from pbrfit_evaluation.scores import PROTOCOL as SCORES
from pbrfit_evaluation.suite import Part, Suite
from pbrfit_evaluation.transport import figures

SETUPS = ("brdf", "shadows", "bounces", "detailed")

KEYS = tuple(variant.key for variant in OF_GEOMETRY)
FEW = (GUESS.key, WITHOUT, TRUE)
"""Variants, and those of a quick look."""

FIRST_SEED = 8100
"""Nothing was tuned on seeds from there on."""

SUITE = Suite(
    name="transport",
    title="Shadows and bounces by geometry",
    description="Fit rooms that Blender Cycles renders, with and without their depth: the true "
    "one, that of a network, one integrated from normals; with true and with found segments. "
    "Writes report.html, a plot, strips of relit pictures, transport.md, scenes.csv and "
    "summary.json. Exit code 1 if something does not hold.",
    protocol=f"pbrfit-transport-1: {SCORES}; {{size}} pixels, {{lights}} pictures, {{effort}}",
    parts=[Part.shown_by(figures, "transport", cases_of(KEYS, (WITHOUT, TRUE)), run)],
    options=options_of(
        *(SETUPS, "all, with --quick shadows", KEYS, FEW, FIRST_SEED),
        held_out="; as many are held out",
    ),
    effort={
        "setups": (SETUPS, ("shadows",)),
        "variants": (KEYS, FEW),
        "scenes": (10, 2),
        "size": (64, 24),
    },
    quick="minutes: two small rooms with shadows",
    about=(
        "Rooms with furniture under panoramas of SH3 light, rendered by Blender Cycles: without "
        "shadows, with shadows, and with all that a path tracer does. Normals are true. A "
        "network's depth has smooth errors of scale and shift, washed-out outlines and noise; "
        "found segments come from the pictures and normals alone. Figures are means over rooms, "
        "with 95 % intervals by bootstrap over rooms in brackets. The constant guess has roughness "
        "0.5, metallic 0 and the mean of the true albedo, with the lights that then fit best.",
    ),
    timed=True,
    verdict_rows=True,
)
