"""Shadows and light from surface to surface, by geometry: what depth is worth to a fit."""

from __future__ import annotations

from typing import get_args

from pbrfit._core import InputError
from pbrfit_evaluation import cycles
from pbrfit_evaluation.options import absolute, count, cycles_cache, first_seed, option
from pbrfit_evaluation.scores import PROTOCOL as SCORES
from pbrfit_evaluation.suite import Options, Part, Suite
from pbrfit_evaluation.transport import figures
from pbrfit_evaluation.transport.measure import FIRST_SEED, PICTURED, Case, Setup, run
from pbrfit_evaluation.transport.variants import BY_KEY, VARIANTS

SETUPS: tuple[Setup, ...] = get_args(Setup)

FEW = ("constant", "without", "true")
"""Variants of a quick look."""


def cases(options: Options) -> list[Case]:
    """Every room of every setup, explained in every way that this version has.

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
            picture=i == 0 and variant.key in PICTURED,
            cycles_cache=absolute(options.cycles_cache),
        )
        for variant in VARIANTS
        if variant.key in options.variants
        for setup in options.setups
        for i in range(options.scenes)
    ]


SUITE = Suite(
    name="transport",
    title="Shadows and bounces by geometry",
    description="Fit rooms that Blender Cycles renders, with and without their depth: the true "
    "one, that of a network, one integrated from normals; with true and with found segments. "
    "Writes report.html, a plot, strips of relit pictures, transport.md, scenes.csv and "
    "summary.json. Exit code 1 if something does not hold.",
    protocol=f"pbrfit-transport-1: {SCORES}; {{size}} pixels, {{lights}} pictures, {{effort}}",
    parts=[
        Part(
            "transport",
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
            help=f"only these (default: all, with --quick shadows): {', '.join(SETUPS)}",
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
        count("--lights", "N", "pictures a room; as many are held out", default=16),
        first_seed("room", FIRST_SEED),
        cycles_cache,
    ),
    effort={
        "setups": (SETUPS, ("shadows",)),
        "variants": (tuple(BY_KEY), FEW),
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
