"""Everyday pictures: what files, bad pictures and unknown cameras cost beside clean float ones."""

from __future__ import annotations

from pbrfit_evaluation.everyday import figures
from pbrfit_evaluation.everyday.disturbances import DISTURBANCES
from pbrfit_evaluation.everyday.measure import GRID, run
from pbrfit_evaluation.scores import PROTOCOL as SCORES
from pbrfit_evaluation.suite import Part, Suite

FIRST_SEED = 2000

FEW = tuple(name for name in DISTURBANCES if "444" not in name and "75" not in name)
"""Disturbances of a quick look: JPEG once."""


SUITE = Suite(
    name="everyday",
    title="Everyday pictures",
    protocol=f"pbrfit-everyday-2: {SCORES}; {{size}} pixels, {{effort}}",
    parts=[Part.shown_by(figures, "everyday", GRID.cases, run)],
    options=(
        *GRID.options(
            *(FIRST_SEED, "--disturbances", FEW),
            scenes="in all; the kinds room, furnished and detailed take turns",
        ),
    ),
    effort=GRID.effort(FEW) | {"scenes": (18, 2), "size": (64, 24)},
    about=(
        "Fits of scenes whose ground truth is known after what cameras and files do to pictures: "
        "8 bits, JPEG, clipping, hot samples, a bad picture, tone curves, vignetting, an unknown "
        "or wrong field of view. Scenes have 16 pictures of mean radiance 0.4 with white noise of "
        "0.01 in float32; fits have all defaults. docs/everyday.md says what each case is.",
    ),
    timed=True,
)
