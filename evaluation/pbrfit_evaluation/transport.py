"""Shadows and light from surface to surface, by geometry: what depth is worth to a fit."""

from __future__ import annotations

from pbrfit_evaluation.explained import figures
from pbrfit_evaluation.explained.measure import GEOMETRY, TRUE, WITHOUT, run
from pbrfit_evaluation.options import count, cycles_cache
from pbrfit_evaluation.scores import PROTOCOL as SCORES
from pbrfit_evaluation.suite import Part, Suite

FIRST_SEED = 8100

FEW, FEW_WAYS = ("shadows",), ("constant", WITHOUT, TRUE)
"""Those of a quick look."""

SUITE = Suite(
    name="transport",
    title="Shadows and bounces by geometry",
    protocol=f"pbrfit-transport-1: {SCORES}; {{size}} pixels, {{lights}} pictures, {{effort}}",
    parts=[Part.shown_by(figures, "transport", GEOMETRY.cases, run, "geometry_")],
    options=(
        *GEOMETRY.options(
            *(FIRST_SEED, "--setups", FEW),
            ways="--variants",
            few_ways=FEW_WAYS,
            scenes="rooms of a setup",
        ),
        count("--lights", "N", "pictures a room; as many are held out", default=16),
        cycles_cache,
    ),
    effort=GEOMETRY.effort(FEW, FEW_WAYS) | {"scenes": (10, 2), "size": (64, 24)},
    about=(
        "Rooms with furniture under panoramas of SH3 light, rendered by Blender Cycles: without "
        "shadows, with shadows, and with all that a path tracer does; fitted with and without "
        "their depth. Normals are true. A network's depth has smooth errors of scale and shift, "
        "washed-out outlines and noise. Figures are means over rooms, with 95 % intervals by "
        "bootstrap over rooms in brackets. The constant guess has roughness 0.5, metallic 0 and "
        "the mean of the true albedo, with the lights that then fit best.",
    ),
    timed=True,
)
