"""Real pictures: what is held out, and how well the materials of the rest explain it."""

from __future__ import annotations

import os

from pbrfit_evaluation.options import count, folders, model_option, models
from pbrfit_evaluation.real import figures
from pbrfit_evaluation.real.measure import Task, folds_of, run
from pbrfit_evaluation.real.sources import check_names, find_data, find_sources
from pbrfit_evaluation.suite import Options, Part, Suite


def cases(options: Options) -> list[Task]:
    """All folds of all sources and models.

    Raises
    ------
    InputError, FileNotFoundError
        If there are no pictures, or two sources have one name.
    """
    paths = find_data(options.folders, os.environ)
    sources = [source for path in paths for source in find_sources(path.absolute())]
    check_names(sources)
    of_task = options.max_size, options.iterations, options.held_out
    return [
        Task(source, model, fold, digest, *of_task)
        for source in sources
        for digest in [source.digest()]
        for model in models(options)
        for fold in folds_of(source, options.held_out, options.folds)
    ]


SUITE = Suite(
    name="real",
    title="Real pictures, some held out",
    description="Fit materials to some pictures of each scene, then only the light of the others, "
    "and report how well the materials explain them. Writes report.html, pictures, pictures.csv, "
    "real.md and summary.json.",
    protocol="pbrfit-real-1: materials from the kept pictures, lights of held-out pictures by "
    "linear least squares; RMSE over RMS radiance of all held-out pictures together, linear, "
    "clipped samples left out; PSNR and SSIM in sRGB, exposed so that the picture's 98th "
    "percentile is white; {max_size} pixels, {iterations} iterations",
    parts=[Part("real", cases, run, figures.figures, sections=figures.sections, csvs=figures.csvs)],
    options=(
        folders(
            "scene folder, a public set as published, or a folder of such (default: the folder "
            "that the environment variable PBRFIT_DATA names)"
        ),
        model_option("pictures are explained with"),
        count(
            "--held-out",
            "K",
            "pictures of a scene that are held out at a time (default: a quarter)",
        ),
        count("--folds", "F", "at most so many ways to hold pictures out"),
        count("--max-size", "PIXELS", "average larger pictures down to this longer side"),
        count("--iterations", "N", "of each fit"),
    ),
    effort={"folds": (4, 1), "max_size": (256, 64), "iterations": (500, 60)},
    quick="small pictures, short fits, one fold",
    about=(
        "Materials are fitted to the kept pictures. Then only the light of each held-out picture "
        "is fitted, 48 numbers for all its pixels, and what is left is the error of the materials "
        "and of the model. There is no other ground truth for real pictures.",
        "It can tell whether the maps carry over to light that they have not seen, better than a "
        "constant guess or a map of albedo alone. It cannot tell whether the maps are right: "
        "several materials may explain the same pictures, and where lights are much alike, shading "
        "that is painted into the albedo explains the held-out picture as well.",
        "The sum of kept pictures needs no materials: light adds up, so a factor a picture and "
        "channel is a fair competitor where lights are many and alike.",
        "Samples that an integer file holds at its maximum are clipped and take no part in fits "
        "and errors. Known lights are not used.",
    ),
)
