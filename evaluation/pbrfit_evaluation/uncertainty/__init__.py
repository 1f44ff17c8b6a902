"""Posteriors under misfit: whether deviations, intervals and verdicts are right."""

from __future__ import annotations

from pbrfit.model.reflection import DEFAULT_MODEL, MODELS
from pbrfit_evaluation.everyday.disturbances import KINDS
from pbrfit_evaluation.options import count, first_seed, option, several
from pbrfit_evaluation.suite import Options, Part, Suite
from pbrfit_evaluation.uncertainty import figures
from pbrfit_evaluation.uncertainty.conditions import NAMES, Name
from pbrfit_evaluation.uncertainty.measure import Case, run

FIRST_SEED = 9300
"""Nothing was tuned on seeds from there on."""

QUICK: tuple[Name, ...] = ("clean", "noise", "fov-90")
"""Rows of a quick look."""


def cases(options: Options) -> list[Case]:
    """Every scene under every condition that is asked for; kinds take turns."""
    return [
        Case(name, kind, options.first_seed + i, options.size, options.model)
        for i in range(options.scenes)
        for kind in [options.kinds[i % len(options.kinds)]]
        for name in NAMES
        if name in options.rows
    ]


SUITE = Suite(
    name="uncertainty",
    title="Is the uncertainty right?",
    description="Fit scenes whose ground truth is known, such as the model has them and such as it "
    "does not: wrong normals, field of view, order of the lights or reflection model, files of 8 "
    "bits, shadows, bounced light, lamps. Compare errors with standard deviations, intervals and "
    "verdicts. Writes report.html, plots, uncertainty.md, scenes.csv and summary.json. Exit code 1 "
    "if something does not hold.",
    protocol="pbrfit-uncertainty-2: values of maps within their deviations and intervals, RMSE of "
    "maps by their verdicts; {size} pixels, model {model}, {effort}",
    parts=[Part.shown_by(figures, "uncertainty", cases, run)],
    options=(
        several("--rows", "NAME", NAMES, QUICK),
        several("--kinds", "KIND", KINDS, what="of the scenes, in turn", default="furnished"),
        count("--scenes", "K", "of a row"),
        count("--size", "PIXELS", "of the pictures"),
        first_seed("scene of a row", FIRST_SEED),
        option(
            "--model",
            choices=MODELS,
            default=DEFAULT_MODEL,
            help="that is fitted, of `pbrfit decompose --model` (default: %(default)s)",
        ),
    ),
    effort={
        "rows": (NAMES, QUICK),
        "kinds": (("furnished",), ("furnished",)),
        "scenes": (10, 1),
        "size": (64, 32),
    },
    quick="half a minute: one small scene, three rows",
    about=(
        "Rooms with known materials, 16 pictures each, fitted with all defaults. In some rows the "
        "pictures are as the model has them, in others something is wrong that no fit knows of. "
        "A posterior is right where the errors of its values are as large as it says, whatever is "
        "wrong.",
        "docs/uncertainty.md says what must hold. A demand that does not hold is shown as such.",
    ),
    timed=True,
    verdict_rows=True,
)
