"""Wrong normals: what they cost, and how much of it refining them wins back."""

from __future__ import annotations

from pbrfit._core import InputError
from pbrfit.commands.arguments import add_threads
from pbrfit_evaluation.grid import Case
from pbrfit_evaluation.normals import figures
from pbrfit_evaluation.normals.disturbances import DISTURBANCES
from pbrfit_evaluation.normals.measure import exact, rooms, run
from pbrfit_evaluation.options import count, first_seed, option, several
from pbrfit_evaluation.suite import Options, Part, Suite

FIRST_SEED = 7000

LARGEST = 45.0
"""Degrees of a disturbance, at most."""


def cases(options: Options) -> list[Case]:
    """Rooms under every disturbance that is asked for; InputError if a size makes no sense."""
    for theta in options.degrees:
        if not 0 < theta <= LARGEST:
            expected = f"expected more than 0 and at most {LARGEST:g}"
            raise InputError(f"--degrees: {expected}, found {theta:g}")
    return rooms(options).cases(options)


def of_exact(options: Options) -> list[Case]:
    """Rooms without noise."""
    return exact(options).cases(options)


SUITE = Suite(
    name="normals",
    title="Wrong normals, refined",
    protocol="pbrfit-normals-1, {effort}",
    parts=[
        Part.shown_by(figures, "rooms", cases, run, "room_"),
        Part.shown_by(figures, "exact", of_exact, run, "exact_"),
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
        "with materials and lights: scenes whose ground truth is known, their normals disturbed "
        "by 1 to 25 degrees, with noise and without. docs/benchmarks/normals.md says what each "
        "part measures, and what must hold. Judged is “auto”, the default; without noise “on”.",
    ),
    timed=True,
)
