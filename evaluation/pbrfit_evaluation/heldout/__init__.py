"""Pictures that a fit has not seen: how well it explains them, beside other ways."""

from __future__ import annotations

import os

from pbrfit_evaluation.heldout import figures
from pbrfit_evaluation.heldout.measure import WAYS, Task, Way, run
from pbrfit_evaluation.heldout.sources import asked_sources
from pbrfit_evaluation.options import count, folders, several
from pbrfit_evaluation.suite import Options, Part, Suite

FEW: tuple[Way, ...] = ("default", "lambert", "nearest")
"""Ways of a quick look."""


def cases(options: Options) -> list[Task]:
    """All folds of all sources, in every way.

    Raises InputError or FileNotFoundError if there are no pictures, or two sources have one name.
    """
    of = options.held_out, options.folds, options.pictures, options.max_size
    return [
        Task(source, way, fold, digest, *of)
        for source in asked_sources(options.folders, os.environ)
        for digest in [source.digest()]
        for count in [min(source.pictures, options.pictures)]
        for fold in range(max(1, min(options.folds, count // options.held_out)))
        for way in WAYS
        if way in options.ways
    ]


SUITE = Suite(
    name="heldout",
    title="Held-out pictures",
    protocol="pbrfit-heldout-1: materials from the kept pictures, light of the held-out ones; RMSE "
    "over RMS of all held-out pictures together, in values of the files, samples that are clipped "
    "left out; {held_out} of at most {pictures} pictures held out at a time, {folds} folds, "
    "{max_size} pixels",
    parts=[Part.shown_by(figures, "heldout", cases, run)],
    options=(
        folders(
            "scene folder, a public set as published, or a folder of such (default: the folder "
            "that the environment variable PBRFIT_DATA names)"
        ),
        several("--ways", "NAME", WAYS, FEW),
        count("--held-out", "K", "pictures that are held out at a time", default=1),
        count("--folds", "F", "so many times, spread evenly over the pictures"),
        count("--pictures", "N", "of a set that are used at most, evenly chosen"),
        count("--max-size", "PIXELS", "average larger pictures down to this longer side"),
    ),
    effort={
        "ways": (WAYS, FEW),
        "folds": (4, 1),
        "pictures": (32, 6),
        "max_size": (192, 32),
    },
    about=(
        "Materials are fitted to the kept pictures of each set, then only the light of each "
        "held-out picture. What is left of the values in its file, as they are stored, is the "
        "error: so ways compare that read the files by different tone curves. It is also taken "
        "with one far lamp and constant ambient light, whatever light a way found.",
        "Regret is the error of the default over the least of the default, its flags and the "
        "paper's recipe. “Lambert, rank 3” is a matt surface under unknown lamps, “known lamps” "
        "photometric stereo by least squares; the nearest and the sum of kept pictures have a "
        "factor a channel. All of these read the files both as sRGB and as linear; the better "
        "counts. Relightable images (PTM, HSH, PCA) are told the lamp of a held-out picture where "
        "it is known, else where a fit finds it.",
        "A small error does not prove maps right: several materials may explain the same pictures.",
    ),
)
