"""Everyday pictures: what files, bad pictures and unknown cameras cost beside clean float ones."""

from __future__ import annotations

from pbrfit_evaluation.everyday import figures
from pbrfit_evaluation.everyday.disturbances import DISTURBANCES, KINDS
from pbrfit_evaluation.everyday.measure import PICTURED, Case, run
from pbrfit_evaluation.options import count, first_seed, several
from pbrfit_evaluation.scores import PROTOCOL as SCORES
from pbrfit_evaluation.suite import Options, Part, Suite

FIRST_SEED = 2000
"""Nothing was tuned on seeds from there on."""

FEW = tuple(name for name in DISTURBANCES if "444" not in name and "75" not in name)
"""Disturbances of a quick look: JPEG once."""


def cases(options: Options) -> list[Case]:
    """Every scene after every disturbance asked for, with what it is compared with.

    Kinds take turns. Maps are kept of the second scene, which is furnished, or of the only one.
    """
    asked = set(options.disturbances)
    asked |= {figures.REFERENCE, *(figures.TWINS.get(name, name) for name in asked)}
    return [
        Case(
            *(name, KINDS[i % len(KINDS)], options.first_seed + i, options.size),
            picture=name in PICTURED and i == min(1, options.scenes - 1),
        )
        for i in range(options.scenes)
        for name in DISTURBANCES
        if name in asked
    ]


SUITE = Suite(
    name="everyday",
    title="Everyday pictures",
    description="Fit scenes whose ground truth is known after what cameras and files do to "
    "pictures: 8 bits, JPEG, clipping, hot samples, a bad picture, tone curves, vignetting, an "
    "unknown or wrong field of view; errors as multiples of those of clean float pictures. Writes "
    "report.html, a plot, a sheet of maps, everyday.md, scenes.csv and summary.json. Exit code 1 "
    "if something does not hold.",
    protocol=f"pbrfit-everyday-1: {SCORES}; {{size}} pixels, {{effort}}",
    parts=[Part.shown_by(figures, "everyday", cases, run)],
    options=(
        several(
            *("--disturbances", "NAME", DISTURBANCES),
            what="only these, and what they are compared with",
            default="all, with --quick JPEG but once",
        ),
        count("--scenes", "K", "in all; the kinds room, furnished and detailed take turns"),
        count("--size", "PIXELS", "of the pictures"),
        first_seed("scene", FIRST_SEED),
    ),
    effort={"disturbances": (DISTURBANCES, FEW), "scenes": (18, 2), "size": (64, 24)},
    quick="two minutes: two small scenes",
    about=(
        "Scenes of 16 pictures, mean radiance 0.4, with white noise of 0.01 in float32, and what "
        "cameras and files do to such pictures; fits with all defaults. docs/everyday.md says what "
        "each case is.",
    ),
    timed=True,
    verdict_rows=True,
)
