"""Numerical stability of the core: measurements against exact or float64 references."""

from __future__ import annotations

from pbrfit.commands.arguments import add_threads, whole_number
from pbrfit_evaluation.options import option
from pbrfit_evaluation.stability import figures
from pbrfit_evaluation.stability.bounds import SECTIONS
from pbrfit_evaluation.stability.measure import EFFORTS
from pbrfit_evaluation.stability.run import Task, run
from pbrfit_evaluation.suite import Options, Part, Suite


def cases(options: Options) -> list[Task]:
    """All sections."""
    return [Task(section, EFFORTS[options.effort], options.seed) for section in SECTIONS]


SUITE = Suite(
    name="stability",
    title="Numerical stability",
    description="Check band weights, loss and gradient against exact or float64 references, and "
    "state a bound for every figure. Writes report.html, its plots, stability.md and summary.json. "
    "Exit code 1 if a bound fails.",
    # Under one name, with the same effort and seed, the same is measured in the same way.
    protocol="pbrfit-stability-1, {effort}",
    parts=[
        Part(
            "stability",
            cases,
            run,
            figures.figures,
            verdicts=figures.verdicts,
            sections=figures.sections,
        )
    ],
    options=(
        option("--seed", type=whole_number, default=0, help="of pixels, lights, pictures"),
        add_threads,
    ),
    quick="seconds instead of minutes: fewer pixels",
    jobs=1,
    about=(
        "pbrfit computes what depends on a material alone in float64, and the products with lights "
        "and residuals, which are nearly all of the work, in float32. This page says how far the "
        "results are from exact ones, and where they stop meaning anything. Every figure is the "
        "worst of all that was tried; u = 2⁻²⁴ = 6·10⁻⁸ is the largest relative error of one "
        "rounding to float32.",
    ),
)
