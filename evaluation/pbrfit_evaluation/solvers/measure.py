"""Fits of furnished rooms by each solver: pictures without noise, and with noise."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from pbrfit.model.materials import Materials
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.arrays import Array, known
from pbrfit_evaluation.grid import Case, Grid, measured
from pbrfit_evaluation.recipes import Way
from pbrfit_evaluation.scores import MAPS
from pbrfit_evaluation.suite import Options

NOISE = {"noise-0.004": 0.004, "noise-0.01": 0.01}
"""Standard deviations of the noise, in radiance: 1 % of the mean radiance of 0.4, as in the
convergence suite, and 1 % of a radiance of 1, as in the ablation."""

RESIDUAL = {"exact": 3e-8, "exact-float64": 1e-12}
"""Residual relative to the pictures' RMS that counts as exact, by the precision of the pictures.

Pictures are rendered in float64. Rounded once to float32, they leave a residual of about 1e-8 of
the picture at the ground truth itself; as they are, none but that of float64 arithmetic.
"""

MATERIAL = 1e-6
"""RMSE of a map that counts as exact."""


def _truth(scene: Scene) -> tuple[Materials, Array]:
    truth = known(scene.truth)
    return truth.materials, known(truth.lighting)


_NONE = {"priors": None}

WAYS = {
    "truth": Way("gauss-newton from the ground truth", _NONE, _truth),
    "gauss-newton": Way("gauss-newton", _NONE),
    "lbfgsb": Way("lbfgsb", {**_NONE, "solver": "lbfgsb"}),
    "gauss-newton-priors": Way("gauss-newton, priors"),
    "lbfgsb-priors": Way("lbfgsb, priors", {"solver": "lbfgsb"}),
}


def sized(options: Options, condition: str) -> tuple[int, int]:
    """Without `--scenes`, as many as each condition needs."""
    scenes = options.scenes
    if not isinstance(scenes, int):
        exact, noisy = scenes
        scenes = noisy if condition in NOISE else exact
    return scenes, options.size


GRID = Grid(
    {
        "exact": "no noise",
        "exact-float64": "no noise, float64 pictures",
        **{key: f"noise {level:g}" for key, level in NOISE.items()},
    },
    WAYS,
    of_condition={"exact": ("gauss-newton", "lbfgsb"), "exact-float64": ("gauss-newton",)},
    sized=sized,
)


def run(case: Case, threads: int) -> dict[str, Any]:
    """Scores; without noise also the `residual` over the RMS of the pictures, and `exact`.

    Rooms are those of table1's base row: 16 pictures of mean radiance 0.4.
    """
    noise = NOISE.get(case.condition, 0.0)
    scene = case.drawn(noise=noise, held_out=case.lights if noise else 1)
    if case.condition == "exact":
        scene = replace(scene, images=scene.images.astype(np.float32))
    result, found = measured(case, WAYS[case.way], scene, threads)
    scores = found["scores"]
    if not noise:
        rms = float(np.sqrt(np.mean(np.square(scene.images, dtype=np.float64))))
        scores["residual"] = scores["recon"] / rms
        scores["worst_map"] = max(scores[name] for name in MAPS)
        exact = scores["residual"] <= RESIDUAL[case.condition] and scores["worst_map"] <= MATERIAL
        scores["exact"] = exact
    return {**found, "stop_reason": result.stop_reason}
