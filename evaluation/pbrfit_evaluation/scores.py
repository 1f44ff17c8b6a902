"""Every figure that a suite reports about a result whose truth is known."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from pbrfit.result import metrics, relighting
from pbrfit.result.result import Result
from pbrfit.scene.scene import Scene

PROTOCOL = (
    "pbrfit-scores-1: RMSE over valid pixels and channels, linear values; relight under the true "
    "held-out lights; scaled = after the best factor a channel"
)


@dataclass(frozen=True)
class Scores:
    """Errors of one result; None where there is nothing to compare with.

    RMSE, `recon` in picture units; `seconds` of the fit alone.
    """

    recon: float
    albedo: float
    roughness: float
    metallic: float
    relight: float | None
    albedo_scaled: float
    relight_scaled: float | None
    seconds: float
    evaluations: float

    def as_json(self) -> dict[str, float | None]:
        """For a record."""
        return asdict(self)


def score(result: Result, scene: Scene, threads: int = 0) -> Scores:
    """Compare a result with the truth of its scene; without truth it is an AssertionError."""
    truth = scene.truth
    assert truth is not None
    found, true = result.materials, truth.materials
    errors = result.metrics
    valid = scene.valid
    scaled = metrics.scaled_per_channel(found.albedo, true.albedo)
    relight = relight_scaled = None
    if truth.relight_images is not None and truth.relight_lighting is not None:
        rendered = relighting.relight(result, truth.relight_lighting, threads)
        shown = np.where(valid[..., None], truth.relight_images, np.nan)
        relight = metrics.rmse(rendered, shown)
        relight_scaled = metrics.rmse(metrics.scaled_per_channel(rendered, shown), shown)
    return Scores(
        recon=errors["recon_rmse"],
        albedo=metrics.rmse(found.albedo, true.albedo),
        roughness=metrics.rmse(found.roughness, true.roughness),
        metallic=metrics.rmse(found.metallic, true.metallic),
        albedo_scaled=metrics.rmse(scaled, true.albedo),
        relight=relight,
        relight_scaled=relight_scaled,
        seconds=result.seconds,
        evaluations=result.evaluations,
    )
