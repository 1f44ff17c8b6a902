"""The gap between reflection models and the integral of the BRDF that renderers use, and Cycles.

Models are compared with brute-force integration (`principled.py`), so what is measured is the model
alone: no fit, no pictures, no noise. `brute_force.py` has the paper's own BRDF, which tells what of
the gap is its closed form. Renders of spheres agree with the principled integral (docs/cycles.md).
"""

from __future__ import annotations

from pbrfit.commands.arguments import whole_number
from pbrfit_evaluation.gap import figures
from pbrfit_evaluation.gap.measure import Case, run
from pbrfit_evaluation.options import option
from pbrfit_evaluation.suite import Options, Part, Suite

TENTHS = tuple(round(0.1 * i, 1) for i in range(1, 11))


def cases(options: Options) -> list[Case]:
    """A case for each roughness of the table."""
    return [
        Case(r, options.n_dot_v, options.rings, options.lights, options.seed) for r in options.r
    ]


SUITE = Suite(
    name="gap",
    title="The gap of the reflection models",
    protocol="pbrfit-gap-4: SH responses of the principled BRDF by quadrature; spheres seen from "
    "far away under random lights turned in every way; {effort}",
    parts=[Part.shown_by(figures, "integrals", cases, run)],
    options=(option("--seed", type=whole_number, default=0, help="of the random lights"),),
    effort={
        "r": ((0.05, *TENTHS), (0.1, 0.3, 0.5, 0.8, 1.0)),
        "n_dot_v": ((0.05, *TENTHS), (0.1, 0.2, 0.5, 0.8, 1.0)),
        "rings": (20, 10),
        "lights": (64, 16),
    },
    about=(
        "The models that pbrfit fits beside brute-force integration of BRDFs, over roughness, "
        "view angle and SH band. The principled "
        "integral is that of the BRDF of Blender's Principled, which glTF and game engines share "
        "but for Fresnel's term of dielectrics.",
        "A response is the size of what comes back of light in one SH band l: 1 for a perfect "
        "mirror, and for l = 0 the directional albedo. Relative RMSE is of the radiance of "
        "spheres under random lights turned in every way, over its RMS.",
    ),
)
