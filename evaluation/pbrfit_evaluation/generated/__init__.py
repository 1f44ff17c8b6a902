"""From one photograph, with stand-ins for generated pictures: what their faults cost, by stage."""

from __future__ import annotations

from dataclasses import replace

from pbrfit._core import InputError
from pbrfit.acquire.photo import LEAST_SIDE
from pbrfit_evaluation.generated import figures
from pbrfit_evaluation.generated.measure import run
from pbrfit_evaluation.generated.ways import FEW, GRID, by_cycles
from pbrfit_evaluation.grid import Case
from pbrfit_evaluation.options import count, cycles_cache, option
from pbrfit_evaluation.scores import PROTOCOL as SCORES
from pbrfit_evaluation.suite import Options, Part, Suite

FIRST_SEED = 9700


def cases(options: Options) -> list[Case]:
    """Every room in every way; by Cycles where it is there and wanted.

    Raises InputError if there are too few pictures for each kind of damage, or they are too small
    for a photograph.
    """
    if options.pictures < 6:
        raise InputError(f"--pictures: expected at least 6, found {options.pictures}")
    if options.size < LEAST_SIDE:
        raise InputError(f"--size: expected at least {LEAST_SIDE}, found {options.size}")
    kind = "cycles" if by_cycles(options) else "own"
    return [replace(case, kind=kind, lights=options.pictures) for case in GRID.cases(options)]


SUITE = Suite(
    name="generated",
    title="From one photograph, with stand-in pictures",
    protocol=f"pbrfit-generated-1: {SCORES}; {{size}} pixels, {{pictures}} pictures, {{effort}}",
    parts=[Part.shown_by(figures, "generated", cases, run)],
    options=(
        *GRID.options(FIRST_SEED, "--ways", FEW, scenes="rooms"),
        count("--pictures", "N", "a room, the photograph among them"),
        cycles_cache,
        option("--no-cycles", action="store_true", help="only our renderer, even with Cycles"),
    ),
    effort=GRID.effort(FEW) | {"scenes": (4, 1), "size": (64, 64), "pictures": (13, 7)},
    about=(
        "Textured rooms under soft lights, by Cycles with all light transport, stand for a "
        "photograph and for pictures that a generator made of it: tone curves, drift, repainting, "
        "another room. Fits with and without review, alignment, robust weights and exposure "
        "handling, and by commands from photograph to Blender. Without Blender Cycles (make "
        "cycles-env) and with --quick our own renderer makes the rooms.",
        "Levels of damage build upon each other. Normals and segments are true unless a row says "
        "otherwise. Brackets are 95 % intervals of means over rooms. The constant guess has "
        "roughness 0.5, metallic 0 and the mean of the true albedo.",
    ),
)
