"""Every figure that a suite reports about a result whose truth is known."""

from __future__ import annotations

import numpy as np

from pbrfit.result import metrics, relighting
from pbrfit.result.result import Result
from pbrfit.result.verdict import PARAMETERS
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.arrays import known

MAPS = PARAMETERS
"""Maps of a material."""

PROTOCOL = (
    "pbrfit-scores-1: RMSE over valid pixels and channels, linear values; relight under the true "
    "held-out lights; scaled = after the best factor a channel"
)

SCORES = ("recon", *MAPS, "relight", "albedo_scaled", "relight_scaled", "seconds", "evaluations")
"""RMSE, `recon` in picture units; `seconds` of the fit alone."""


def score(result: Result, scene: Scene, threads: int = 0) -> dict[str, float | None]:
    """Compare a result with the truth of its scene: `SCORES`, None where there is nothing true."""
    truth = known(scene.truth)
    found, true = result.materials, truth.materials
    relight = relight_scaled = None
    if truth.relight_images is not None and truth.relight_lighting is not None:
        rendered = relighting.relight(result, truth.relight_lighting, threads)
        shown = np.where(scene.valid[..., None], truth.relight_images, np.nan)
        relight = metrics.rmse(rendered, shown)
        relight_scaled = metrics.scaled_rmse(rendered, shown)
    return {
        "recon": result.metrics["recon_rmse"],
        **{name: metrics.rmse(getattr(found, name), getattr(true, name)) for name in MAPS},
        "relight": relight,
        "albedo_scaled": metrics.scaled_rmse(found.albedo, true.albedo),
        "relight_scaled": relight_scaled,
        "seconds": result.seconds,
        "evaluations": result.evaluations,
    }
