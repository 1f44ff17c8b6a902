"""Every figure that a suite reports about a result whose truth is known."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pbrfit.result import metrics, relighting
from pbrfit.result.result import Result
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.similarity import psnr, ssim

PROTOCOL = (
    "pbrfit-scores-1: RMSE over valid pixels and channels, linear values; relight under the true "
    "held-out lights; metal = true metallic >= 0.5; scaled = after the best factor a channel; "
    "PSNR and SSIM in sRGB, pictures exposed so that the truth's 98th percentile is white"
)

METAL = 0.5
"""Pixels whose true metallic is at least this are metal."""


RELIGHT = ("relight", "relight_scaled", "relight_psnr", "relight_ssim")
"""Scores of relit pictures; PSNR and SSIM are means over pictures."""


@dataclass(frozen=True)
class Scores:
    """Errors of one result; None where there is nothing to compare with.

    RMSE unless the name says otherwise. `recon` in picture units, `psnr` in dB, `seconds` of the
    fit alone.
    """

    recon: float
    albedo: float
    roughness: float
    metallic: float
    relight: float | None
    roughness_on_metal: float | None
    metallic_on_metal: float | None
    albedo_scaled: float
    relight_scaled: float | None
    albedo_psnr: float
    albedo_ssim: float
    relight_psnr: float | None
    relight_ssim: float | None
    seconds: float
    evaluations: float

    def as_json(self) -> dict[str, float | None]:
        """For a record."""
        return asdict(self)


def better(metric: str) -> Literal["low", "high"]:
    """Which values of a metric are better."""
    return "high" if metric.endswith(("psnr", "ssim")) else "low"


def score(result: Result, scene: Scene, threads: int = 0) -> Scores:
    """Compare a result with the truth of its scene; without truth it is an AssertionError."""
    truth = scene.truth
    assert truth is not None
    found, true = result.materials, truth.materials
    errors = result.metrics
    valid = scene.valid
    metal = np.where(valid, true.metallic, 0.0) >= METAL
    scaled = metrics.scaled_per_channel(found.albedo, true.albedo)
    relight: dict[str, float | None] = dict.fromkeys(RELIGHT)
    if truth.relight_images is not None and truth.relight_lighting is not None:
        rendered = relighting.relight(result, truth.relight_lighting, threads)
        shown = np.where(valid[..., None], truth.relight_images, np.nan)
        relight |= zip(RELIGHT, _relight(rendered, shown), strict=True)
    albedos = metrics.display(found.albedo, 1.0), metrics.display(true.albedo, 1.0)
    return Scores(
        recon=errors["recon_rmse"],
        albedo=metrics.rmse(found.albedo, true.albedo),
        roughness=metrics.rmse(found.roughness, true.roughness),
        metallic=metrics.rmse(found.metallic, true.metallic),
        roughness_on_metal=_on(metal, found.roughness, true.roughness),
        metallic_on_metal=_on(metal, found.metallic, true.metallic),
        albedo_scaled=metrics.rmse(scaled, true.albedo),
        albedo_psnr=psnr(*albedos),
        albedo_ssim=ssim(*albedos),
        seconds=result.seconds,
        evaluations=result.evaluations,
        **relight,
    )


def _relight(
    rendered: NDArray[np.float64], true: NDArray[np.float64]
) -> tuple[float, float, float, float]:
    """Relit pictures (M, H, W, 3) against the truth, in the order of `RELIGHT`."""
    pairs = [
        (metrics.display(a, white), metrics.display(b, white))
        for a, b in zip(rendered, true, strict=True)
        for white in [metrics.white_of(b)]
    ]
    return (
        metrics.rmse(rendered, true),
        metrics.rmse(metrics.scaled_per_channel(rendered, true), true),
        float(np.mean([psnr(*pair) for pair in pairs])),
        float(np.mean([ssim(*pair) for pair in pairs])),
    )


def _on(
    pixels: NDArray[np.bool_], found: NDArray[np.floating[Any]], true: NDArray[np.floating[Any]]
) -> float | None:
    return metrics.rmse(found[pixels], true[pixels]) if pixels.any() else None
