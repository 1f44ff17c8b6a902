"""Posteriors under misfit: whether deviations, intervals and verdicts are right."""

from __future__ import annotations

from pbrfit.model.reflection import DEFAULT_MODEL, MODELS
from pbrfit_evaluation.everyday.disturbances import KINDS
from pbrfit_evaluation.options import option, several
from pbrfit_evaluation.suite import Part, Suite
from pbrfit_evaluation.uncertainty import figures
from pbrfit_evaluation.uncertainty.measure import GRID, run

FIRST_SEED = 9300

QUICK = ("clean", "noise", "fov-90")
"""Rows of a quick look."""


SUITE = Suite(
    name="uncertainty",
    title="Is the uncertainty right?",
    protocol="pbrfit-uncertainty-2: values of maps within their deviations and intervals, RMSE of "
    "maps by their verdicts; {size} pixels, model {model}, {effort}",
    parts=[Part.shown_by(figures, "uncertainty", GRID.cases, run)],
    options=(
        *GRID.options(FIRST_SEED, "--rows", QUICK),
        several("--kinds", "KIND", KINDS, what="of the scenes, in turn", default="furnished"),
        option(
            "--model",
            choices=MODELS,
            default=DEFAULT_MODEL,
            help="that is fitted, of `pbrfit decompose --model` (default: %(default)s)",
        ),
    ),
    effort=GRID.effort(QUICK)
    | {
        "kinds": (("furnished",), ("furnished",)),
        "scenes": (10, 1),
        "size": (64, 32),
    },
    about=(
        "Rooms with known materials, 16 pictures each, fitted with all defaults. In some rows the "
        "pictures are as the model has them, in others something is wrong that no fit knows of: "
        "normals, field of view, order of the lights or reflection model, files of 8 bits, "
        "shadows, bounced light, lamps. A posterior is right where the errors of its values are "
        "as large as it says, whatever is wrong. docs/uncertainty.md says what must hold.",
    ),
)
