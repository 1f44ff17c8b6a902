"""Numerical stability of the core: measurements against exact or float64 references."""

from __future__ import annotations

from pbrfit.commands.arguments import add_threads, whole_number
from pbrfit_evaluation.options import option
from pbrfit_evaluation.stability import figures
from pbrfit_evaluation.stability.sections import SECTIONS, Task, run
from pbrfit_evaluation.suite import Options, Part, Suite


def cases(options: Options) -> list[Task]:
    """All sections."""
    return [Task(section, getattr(options, section), options.seed) for section in SECTIONS]


SUITE = Suite(
    name="stability",
    title="Numerical stability",
    # Under one name, with the same effort and seed, the same is measured in the same way.
    protocol="pbrfit-stability-3, {effort}",
    parts=[Part.shown_by(figures, "stability", cases, run)],
    options=(
        option("--seed", type=whole_number, default=0, help="of pixels, lights, pictures"),
        add_threads,
    ),
    effort={
        "fast objective": ((393_216,), (8_192,)),  # pixels of a kind
        "cancellation": ((65_536,), (4_096,)),  # pixels
        "accumulated error": (
            (10, 65_536, 32),
            (8, 4_096, 8),
        ),  # 4^k pixels, of many pictures, draws
        "tiny numbers": ((65_536,), (8_192,)),  # pixels
        "stiff fits": ((48, 16, 300), (10, 5, 20)),  # size, pictures, iterations
        "edges": ((100,), (6,)),  # scenes
    },
    jobs=1,
    about=(
        "Loss and gradient against float64 references, and a bound for every figure. pbrfit "
        "computes what depends on a material alone in float64, and the products with lights and "
        "residuals, which are nearly all of the work, in float32. This page says how far the "
        "results are from exact ones, and where they stop meaning anything. Every figure is the "
        "worst of all that was tried; u = 2⁻²⁴ = 6·10⁻⁸ is the largest relative error of one "
        "rounding to float32.",
    ),
)
