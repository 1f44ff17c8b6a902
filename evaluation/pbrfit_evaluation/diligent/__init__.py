"""Photometric stereo as its benchmarks judge it: angles between normals and the true ones."""

from __future__ import annotations

import os

from pbrfit.commands.arguments import positive
from pbrfit_evaluation.diligent import figures
from pbrfit_evaluation.diligent.figures import WAYS
from pbrfit_evaluation.heldout.measure import Task, run
from pbrfit_evaluation.heldout.sources import asked_sources
from pbrfit_evaluation.options import count, folders, option, several
from pbrfit_evaluation.suite import Options, Part, Suite

PICTURES = (4, 8, 16, 24, 32, 96)
"""Pictures of an object that are fitted."""

HELD_OUT = 8
"""Pictures that are not, on which relighting is judged."""


def cases(options: Options) -> list[Task]:
    """All objects in every way, of every number of pictures that they have.

    Normals are kept of the most pictures alone.

    Raises InputError or FileNotFoundError if there are no pictures, or two objects have one name.
    """
    return [
        Task(
            *(source, way, 0, digest, HELD_OUT, 1, source.pictures, options.max_size),
            keep=keep,
            linear=source.linear,
            mapped=keep == numbers[-1],
        )
        for source in asked_sources(options.folders, os.environ)
        for digest in [source.digest()]
        for numbers in [sorted({min(n, source.pictures) for n in options.pictures})]
        for keep in numbers
        for way in WAYS
        if way in options.ways
    ]


SUITE = Suite(
    name="diligent",
    title="Photometric stereo",
    protocol="pbrfit-diligent-1: mean angle in degrees over the mask; pictures evenly "
    f"chosen; relighting as of pbrfit-heldout-1 on at most {HELD_OUT} others; {{max_size}} pixels",
    parts=[Part.shown_by(figures, "diligent", cases, run)],
    options=(
        folders(
            "object, or folder of such, as DiLiGenT, DiLiGenT10², LUCES and Harvard publish them, "
            "or scene folders with set.json and normals.npz (default: the folder that the "
            "environment variable PBRFIT_DATA names)"
        ),
        several("--ways", "NAME", WAYS),
        option(
            "--pictures",
            metavar="N",
            nargs="+",
            type=positive,
            help="numbers of pictures that are fitted, as far as an object has so many (default: "
            f"{' '.join(map(str, PICTURES))}, with --quick {PICTURES[1]})",
        ),
        count("--max-size", "PIXELS", "average larger pictures down to this longer side"),
        option(
            "--mat",
            action="store_true",
            help="write the normals of the most pictures as NAME-WAY.mat, (H, W, 3) Normal_est",
        ),
    ),
    effort={
        "ways": (WAYS, WAYS),
        "pictures": (PICTURES, PICTURES[1:2]),
        "max_size": (1024, 64),
    },
    about=(
        "Mean angles between the normals of a fit and measured ones, of objects under far lamps, "
        "one a picture. A fit is told all of the lamps, their directions, or nothing. Least "
        "squares (Woodham 1980) is told all; trimmed, it leaves out a quarter of a pixel's "
        "samples at either end.",
    ),
    timed=True,
)
