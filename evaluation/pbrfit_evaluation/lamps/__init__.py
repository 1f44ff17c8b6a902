"""Rooms under lamps: what lamps as such are worth to a fit, and where it finds them."""

from __future__ import annotations

from typing import get_args

from pbrfit._core import InputError
from pbrfit_evaluation import cycles
from pbrfit_evaluation.lamps import figures
from pbrfit_evaluation.lamps.measure import FIRST_SEED, Case, Setup, run
from pbrfit_evaluation.lamps.variants import BY_KEY, CONSTANT, HARMONICS, NEAR, VARIANTS
from pbrfit_evaluation.options import absolute, count, cycles_cache, first_seed, option
from pbrfit_evaluation.scores import PROTOCOL as SCORES
from pbrfit_evaluation.suite import Options, Part, Suite

SETUPS: tuple[Setup, ...] = get_args(Setup)

FEW = (CONSTANT, HARMONICS, NEAR)
"""Variants of a quick look."""


def cases(options: Options) -> list[Case]:
    """Every room of every setup, explained in every way.

    Rooms change fastest, so that processes side by side do not render the same one.

    Raises
    ------
    InputError
        If there are too few pictures.
    """
    if options.lights < 2:
        raise InputError(f"--lights: expected at least 2, found {options.lights}")
    if cycles.why_not():
        return []
    return [
        Case(
            *(setup, variant.key, options.first_seed + i, options.size, options.lights),
            picture=i == 0,
            cycles_cache=absolute(options.cycles_cache),
        )
        for variant in VARIANTS
        if variant.key in options.variants
        for setup in options.setups
        for i in range(options.scenes)
    ]


SUITE = Suite(
    name="lamps",
    title="Rooms under lamps",
    description="Fit rooms that Blender Cycles renders under one point lamp a picture, with and "
    "without their depth. Writes report.html, a plot, maps, lamps.md, scenes.csv and summary.json. "
    "Exit code 1 if something does not hold.",
    protocol=f"pbrfit-lamps-1: {SCORES}; lamps one a picture, medians over a room's; {{size}} "
    "pixels, {lights} pictures, {effort}",
    parts=[
        Part(
            "lamps",
            cases,
            run,
            figures.rows,
            verdicts=figures.verdicts,
            sections=figures.sections,
            csvs=figures.csvs,
        ),
    ],
    options=(
        option(
            "--setups",
            metavar="NAME",
            nargs="+",
            choices=SETUPS,
            help=f"only these (default: {SETUPS[0]}): {', '.join(SETUPS)}",
        ),
        option(
            "--variants",
            metavar="NAME",
            nargs="+",
            choices=tuple(BY_KEY),
            help=f"only these ways to explain a room (default: all, with --quick {', '.join(FEW)})"
            f": {', '.join(BY_KEY)}",
        ),
        count("--scenes", "K", "rooms of a setup"),
        count("--size", "PIXELS", "of the pictures"),
        count("--lights", "N", "pictures a room", default=16),
        first_seed("room", FIRST_SEED),
        cycles_cache,
    ),
    effort={
        "setups": (SETUPS[:1], SETUPS[:1]),
        "variants": (tuple(BY_KEY), FEW),
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
