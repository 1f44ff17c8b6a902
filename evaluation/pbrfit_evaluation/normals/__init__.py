"""Wrong normals: what they cost, and how much of it refining them wins back."""

from __future__ import annotations

from functools import partial
from typing import Literal

from pbrfit._core import InputError
from pbrfit.commands.arguments import add_threads
from pbrfit_evaluation.normals import figures
from pbrfit_evaluation.normals.disturbances import DISTURBANCES, Disturbance
from pbrfit_evaluation.normals.measure import FIRST_SEED, Case, Name, room_kind, run
from pbrfit_evaluation.options import count, first_seed, option, several
from pbrfit_evaluation.suite import Options, Part, Suite

LARGEST = 45.0
"""Degrees of a disturbance, at most."""

PARTS: dict[Name, str] = {"rooms": "room", "exact": "exact"}
"""What names of functions that show a part begin with."""

EXACT = ("correlated", "biased")
EXACT_DEGREES = 10.0
"""Disturbances without noise, and their size."""


def cases(part: Name, options: Options) -> list[Case]:
    """Every scene under every disturbance that is asked for; with noise, at true normals too.

    Raises InputError if a size makes no sense.
    """
    kinds = [kind for kind in DISTURBANCES if kind in options.disturbances]
    starts: list[tuple[Disturbance | Literal["true"], float]] = []
    if part == "exact":
        starts += [(kind, EXACT_DEGREES) for kind in kinds if kind in EXACT]
    else:
        sizes = sorted(set(options.degrees))
        for size in sizes:
            if not 0 < size <= LARGEST:
                expected = f"expected more than 0 and at most {LARGEST:g}"
                raise InputError(f"--degrees: {expected}, found {size:g}")
        starts += [("true", 0.0), *((kind, size) for kind in kinds for size in sizes)]
    return [
        Case(part, room_kind(i), seed, options.size, kind, degrees, options.iterations)
        for i in range(options.scenes)
        for seed in [options.first_seed + i]
        for kind, degrees in starts
    ]


SUITE = Suite(
    name="normals",
    title="Wrong normals, refined",
    description="Disturb the normals of scenes whose ground truth is known, by 1 to 25 degrees, "
    "and fit them with and without refinement: errors of materials, relighting and normals; and "
    "without noise. Writes report.html, a plot, normals.md, scenes.csv and summary.json. Exit code "
    "1 if something does not hold.",
    protocol="pbrfit-normals-1, {effort}",
    parts=[
        Part.shown_by(figures, name, partial(cases, name), run, f"{of}_")
        for name, of in PARTS.items()
    ],
    options=(
        add_threads,
        several("--disturbances", "KIND", DISTURBANCES),
        option(
            "--degrees",
            metavar="THETA",
            nargs="+",
            type=float,
            help="sizes of the disturbance (default: 1 2 5 10 15 20 25, with --quick 10); true "
            "normals are always there",
        ),
        count("--scenes", "K", "rooms"),
        count("--size", "PIXELS", "of the rooms' pictures"),
        count("--iterations", "K", "of a fit"),
        first_seed("room", FIRST_SEED),
    ),
    effort={
        "disturbances": (DISTURBANCES, DISTURBANCES),
        "degrees": ((1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 25.0), (10.0,)),
        "scenes": (12, 2),
        "size": (128, 32),
        "iterations": (500, 100),
    },
    about=(
        "What wrong normals cost, and how much of it comes back when they are refined together "
        "with materials and lights. docs/benchmarks/normals.md says what each part measures, and "
        f"what must hold. Judged is “{figures.JUDGED}”, the default; without noise “on”.",
    ),
    timed=True,
    verdict_rows=True,
)
