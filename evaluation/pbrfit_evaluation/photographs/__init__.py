"""Photographs of one view under lamps, without normals: how well some explain the others."""

from __future__ import annotations

import os

from pbrfit_evaluation.options import count, folders, option
from pbrfit_evaluation.photographs import figures
from pbrfit_evaluation.photographs.explanations import IN_WORDS, KNOWING, WAYS
from pbrfit_evaluation.photographs.measure import Task, run
from pbrfit_evaluation.photographs.pictures import has_lamps
from pbrfit_evaluation.real.measure import folds_of
from pbrfit_evaluation.real.sources import check_names, find_data, find_sources
from pbrfit_evaluation.suite import Options, Part, Suite


def cases(options: Options) -> list[Task]:
    """All folds of all sources, in every way that what is known of them allows.

    Raises
    ------
    InputError, FileNotFoundError
        If there are no pictures, or two sources have one name.
    """
    paths = find_data(options.folders, os.environ)
    sources = [source for path in paths for source in find_sources(path.absolute())]
    check_names(sources)
    return [
        Task(
            *(source, way, fold, digest, options.max_size, options.iterations, options.held_out),
            fov=options.fov,
            picture=fold == 0,
        )
        for source in sources
        for digest in [source.digest()]
        for way in WAYS
        if way in options.ways and (way not in KNOWING or has_lamps(source))
        for fold in folds_of(source, options.held_out, options.folds)
    ]


def _about() -> str:
    words = {way: IN_WORDS[way] for way in WAYS}
    return (
        f"“{words['lambert-known']}” is photometric stereo by least squares over all samples; "
        f"“{words['lambert']}” the same with unknown lamps: three pictures, found by singular "
        f"values, of which all others are sums. “{words['combination']}” is the same of the kept "
        f"pictures themselves, “{words['nearest']}” the best of them alone, “{words['constant']}” "
        "one radiance for all pixels; all have a factor a channel."
    )


SUITE = Suite(
    name="photographs",
    title="Photographs under lamps, some held out",
    description="Fit shape, materials and lamps to some pictures of each scene, whose normals are "
    "not given, then only the light of the others, and report how well they are explained, beside "
    "photometric stereo of matt surfaces. Writes report.html, pictures, pictures.csv, "
    "photographs.md and summary.json. Exit code 1 if something does not hold.",
    protocol="pbrfit-photographs-1: shape and materials from the kept pictures, the light of "
    "held-out pictures fitted; RMSE over RMS radiance of all held-out pictures together, linear, "
    "clipped samples left out; PSNR and SSIM in sRGB, exposed so that the picture's 98th "
    "percentile is white; {max_size} pixels, {iterations} iterations",
    parts=[
        Part(
            "photographs",
            cases,
            run,
            figures.figures,
            verdicts=figures.verdicts,
            sections=figures.sections,
            csvs=figures.csvs,
        )
    ],
    options=(
        folders(
            "scene folder, a public set as published, or a folder of such (default: the folder "
            "that the environment variable PBRFIT_DATA names)"
        ),
        option(
            "--ways",
            metavar="NAME",
            nargs="+",
            choices=WAYS,
            default=WAYS,
            help=f"only these ways to explain them (default: all): {', '.join(WAYS)}",
        ),
        count(
            "--held-out",
            "K",
            "pictures of a scene that are held out at a time (default: a quarter)",
        ),
        count("--folds", "F", "at most so many ways to hold pictures out"),
        count("--max-size", "PIXELS", "average larger pictures down to this longer side"),
        count("--iterations", "N", "of each fit"),
        option(
            "--fov",
            metavar="DEGREES",
            type=float,
            help="horizontal field of view of scene folders (default: what they say)",
        ),
    ),
    effort={"folds": (4, 1), "max_size": (256, 64), "iterations": (500, 60)},
    quick="small pictures, short fits, one fold",
    about=(
        "Shape, materials and lamps are fitted to the kept pictures. Then only the light of each "
        "held-out picture is fitted, a lamp and faint light from all around, and what is left is "
        "the error of shape, materials and model.",
        _about(),
        "Normals are not given to anything; where they are known, angles to them are reported. "
        "A scene folder may hold true_lamps.npy (N, 3), direction times strength, and "
        "true_normals.npy (H, W, 3), in camera space, for this suite alone.",
        "Samples that an integer file holds at its maximum are clipped and take no part in fits "
        "and errors; “matt, rank 3” takes them as they are.",
    ),
)
