"""Fits of furnished rooms by each solver: pictures without noise, and with noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pbrfit.scene.scene import Scene
from pbrfit.synthetic import make_scene
from pbrfit_evaluation.recipes import fit_and_score

FIRST_SEED = 1000
"""Rooms from here on are those of `pbrfit evaluate table1`, on which nothing was tuned."""

PICTURES = 16


@dataclass(frozen=True)
class Case:
    """A room of a part.

    Attributes
    ----------
    part
        Its name.
    seed, size, iterations
        Of the scene, of a picture's side, and of each fit.
    noise
        Standard deviation in radiance; None where the part has no noise.
    """

    part: str
    seed: int
    size: int
    iterations: int
    noise: float | None = None

    @property
    def key(self) -> str:
        """Name of the record."""
        level = "" if self.noise is None else f"{1e3 * self.noise:g}"
        return "_".join(filter(None, (self.part, level, str(self.seed))))

    def scene(self, held_out: int = PICTURES) -> Scene:
        """Make it as in table1's base row: 16 pictures of mean radiance 0.4."""
        return make_scene(
            "furnished",
            size=self.size,
            lights=PICTURES,
            held_out=held_out,
            seed=self.seed,
            noise=self.noise or 0.0,
        )


# ----------------------------------------------------------------------------------------- exact

RECON_FLOAT32, RECON_FLOAT64 = 3e-8, 1e-12
"""Residual relative to the pictures' RMS that counts as exact, by the precision of the pictures.

Pictures are rendered in float64. Rounded once to float32, they leave a residual of about 1e-8 of
the picture at the ground truth itself; as they are, none but that of float64 arithmetic.
"""

MATERIAL = 1e-6
"""RMSE of a map that counts as exact."""

MAPS = ("albedo", "roughness", "metallic")

EXACT_FITS: dict[str, tuple[str, float]] = {
    "gauss-newton": ("gauss-newton", RECON_FLOAT32),
    "lbfgsb": ("lbfgsb", RECON_FLOAT32),
    "gauss-newton, float64": ("gauss-newton", RECON_FLOAT64),
}
"""Solver and largest residual by name; pictures of all but the last are rounded to float32."""


def run_exact(case: Case, threads: int) -> dict[str, Any]:
    """Errors of each fit to pictures without noise, whose ground truth is a perfect fit."""
    scene = case.scene(held_out=1)
    rounded = replace(scene, images=scene.images.astype(np.float32))
    found = {}
    for name, (solver, bound) in EXACT_FITS.items():
        pictures = rounded if bound == RECON_FLOAT32 else scene
        rms = float(np.sqrt(np.mean(np.square(pictures.images, dtype=np.float64))))
        result, scores = fit_and_score(
            pictures, threads, solver=solver, priors=None, iterations=case.iterations
        )
        recon, errors = scores["recon"] / rms, [scores[name] for name in MAPS]
        found[name] = scores | {
            "recon": recon,
            "worst_map": max(errors),
            "exact": is_exact(recon, errors, bound),
            "stop_reason": result.stop_reason,
        }
    return found


def is_exact(recon: float, errors: list[float], bound: float = RECON_FLOAT32) -> bool:
    """Whether residual and maps are within their bounds."""
    return recon <= bound and all(error <= MATERIAL for error in errors)


# ----------------------------------------------------------------------------------------- noise

LEVELS = (0.004, 0.01)
"""Standard deviations of the noise, in radiance: 1 % of the mean radiance of 0.4, as in the
convergence suite, and 1 % of a radiance of 1, as in the ablation."""

FROM_TRUTH = "gauss-newton from the ground truth"
NOISE_FITS: dict[str, dict[str, Any]] = {
    FROM_TRUTH: {"solver": "gauss-newton", "priors": None},
    "gauss-newton": {"solver": "gauss-newton", "priors": None},
    "lbfgsb": {"solver": "lbfgsb", "priors": None},
    "gauss-newton, priors": {"solver": "gauss-newton"},
    "lbfgsb, priors": {"solver": "lbfgsb"},
}
"""Options by name."""


def run_noise(case: Case, threads: int) -> dict[str, Any]:
    """Scores of each fit, and its objective without penalties over the mark, less 1.

    The mark is the lower of L-BFGS-B's, and that of Gauss-Newton from the ground truth, which no
    search for a start can be blamed for. The objective is the square of the residual in float64.
    """
    scene = case.scene()
    assert scene.truth is not None
    start = {FROM_TRUTH: (scene.truth.materials, scene.truth.lighting)}
    found = {}
    for name, options in NOISE_FITS.items():
        result, scores = fit_and_score(
            scene, threads, iterations=case.iterations, start=start.get(name), **options
        )
        found[name] = scores | {"stop_reason": result.stop_reason}
    mark = min(found[name]["recon"] for name in (FROM_TRUTH, "lbfgsb"))
    for scores in found.values():
        scores["above_mark"] = (scores["recon"] / mark) ** 2 - 1
    return found
