"""Table 1 of the paper on scenes whose ground truth is known, and what the paper leaves out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from pbrfit._core import InputError
from pbrfit_evaluation.jobs import digest_of_files
from pbrfit_evaluation.options import absolute, count, cycles_cache, model_option, option
from pbrfit_evaluation.rooms.textures import load_textures
from pbrfit_evaluation.scores import PROTOCOL
from pbrfit_evaluation.suite import Options, Part, Suite
from pbrfit_evaluation.table1 import figures
from pbrfit_evaluation.table1.measure import GRID, Case, predicted_files, run
from pbrfit_evaluation.table1.rows import BY_KEY

MOST_SCENES = 100

FIRST_SEED = 1000
"""Seeds below 400 served to design scenes and simulated normals and to tune the solver; none from
here on ever did."""


def cases(options: Options) -> list[Case]:
    """The scenes of every row that can be run, for every model, those of a seed together.

    So a run that is broken off and resumed with fewer scenes is complete in those.

    Raises InputError if an option is out of range or a folder is not there.
    """
    if options.scenes > MOST_SCENES:
        raise InputError(f"--scenes: expected at most {MOST_SCENES}, found {options.scenes}")
    for folder in (options.textures, options.predicted_normals):
        if folder is not None and not folder.is_dir():
            raise InputError(f"{folder}: expected a folder, found none")
    textures, normals = absolute(options.textures), absolute(options.predicted_normals)
    of_textures = ""
    if textures is not None:
        load_textures(textures)  # what is wrong with them should show before the work
        of_textures = digest_of_files(textures)
    found = []
    for case in GRID.cases(options):
        row, given = BY_KEY[case.condition], Case(**vars(case))
        if row.scene == "detailed":
            given = replace(given, textures=textures, inputs=of_textures)
        elif row.normals == "predicted" and normals is not None:
            digest = digest_of_files(normals, predicted_files(normals, case.seed))
            given = replace(given, predicted_normals=normals, inputs=digest)
        found.append(given)
    return sorted(found, key=lambda case: case.seed)


SUITE = Suite(
    name="table1",
    title="Table 1 on scenes whose ground truth is known",
    protocol=PROTOCOL,
    parts=[Part.shown_by(figures, "table1", cases, run)],
    options=(
        model_option("is fitted, and what our renderer renders with"),
        *GRID.options(FIRST_SEED, "--rows", scenes=f"at most {MOST_SCENES}"),
        count("--lights", "N", "pictures a scene; as many are held out", default=16),
        count("--iterations", "K", "of a fit", default=500),
        option(
            "--textures",
            metavar="DIR",
            type=Path,
            help="PBR maps for the detailed scenes (default: procedural textures)",
        ),
        option(
            "--predicted-normals",
            metavar="DIR",
            type=Path,
            help="normal maps of an estimator, SEED.exr or SEED.png (default: simulated)",
        ),
        count(
            "--slow-scenes",
            "K",
            "of setups that take minutes a scene: Cycles, refined normals, large pictures",
        ),
        cycles_cache,
    ),
    effort=GRID.effort() | {"scenes": (67, 4), "slow_scenes": (20, 0), "size": (64, 32)},
    about=(
        "Scenes whose ground truth is known, in the setups of the paper's Table 1, decomposed "
        "with and without priors and by the paper's recipe. Figures are means over scenes, with "
        "95 % intervals by bootstrap over scenes in brackets; the best of the fits of a setup is "
        "bold. The paper's numbers are of other scenes: context, no comparison.",
        "The paper's recipe, as we read it, is one run of scipy's L-BFGS-B from the mean picture, "
        "roughness 0.5 and metallic 0.1. The constant guess has roughness 0.5, metallic 0 and the "
        "mean of the true albedo, with the lights that then fit best. Ours refines normals in one "
        "setup alone, so that all have the same.",
    ),
)
