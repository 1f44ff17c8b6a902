"""The gap between reflection models and the integral of the BRDF that renderers use, and Cycles.

Models are compared with brute-force integration (`principled.py`), so what is measured is the model
alone: no fit, no pictures, no noise. `brute_force.py` has the paper's own BRDF, which tells what of
the gap is its closed form. `spheres.py` compares with pictures by a renderer.
"""

from __future__ import annotations

from typing import get_args

from pbrfit.commands.arguments import whole_number
from pbrfit_evaluation import cycles
from pbrfit_evaluation.cycles.job import Distribution
from pbrfit_evaluation.gap import figures, spheres
from pbrfit_evaluation.gap.measure import Case, run
from pbrfit_evaluation.gap.spheres import ROUGHNESSES, SUBSTANCES, Sphere
from pbrfit_evaluation.options import absolute, cycles_cache, option
from pbrfit_evaluation.suite import Options, Part, Suite

TENTHS = tuple(round(0.1 * i, 1) for i in range(1, 11))


def cases(options: Options) -> list[Case]:
    """A case for each roughness of the table."""
    return [
        Case(r, options.n_dot_v, options.rings, options.lights, options.seed) for r in options.r
    ]


def sphere_cases(options: Options) -> list[Sphere]:
    """Spheres for Cycles; none where it cannot run."""
    if options.quick or cycles.why_not():
        return []
    return [
        Sphere(distribution, substance, r, cache=absolute(options.cycles_cache))
        for distribution in get_args(Distribution)
        for substance in SUBSTANCES
        for r in ROUGHNESSES
    ]


SUITE = Suite(
    name="gap",
    title="The gap of the reflection models",
    protocol="pbrfit-gap-3: SH responses of the principled BRDF by quadrature; spheres seen from "
    "far away under random lights turned in every way; spheres by Cycles; {effort}",
    parts=[
        Part.shown_by(figures, "integrals", cases, run),
        Part.shown_by(figures, "cycles", sphere_cases, spheres.run, "sphere_"),
    ],
    options=(
        option("--seed", type=whole_number, default=0, help="of the random lights"),
        cycles_cache,
    ),
    effort={
        "r": ((0.05, *TENTHS), (0.1, 0.3, 0.5, 0.8, 1.0)),
        "n_dot_v": ((0.05, *TENTHS), (0.1, 0.2, 0.5, 0.8, 1.0)),
        "rings": (20, 10),
        "lights": (64, 16),
    },
    about=(
        "The models that pbrfit fits beside brute-force integration of BRDFs, over roughness, "
        "view angle and SH band, and beside spheres rendered by Blender Cycles. The principled "
        "integral is that of the BRDF of Blender's Principled, which glTF and game engines share "
        "but for Fresnel's term of dielectrics.",
        "A response is the size of what comes back of light in one SH band l: 1 for a perfect "
        "mirror, and for l = 0 the directional albedo. Relative RMSE is of the radiance of "
        "spheres under random lights turned in every way, over its RMS.",
    ),
)
