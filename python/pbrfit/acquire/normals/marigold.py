"""Normals by Marigold (Ke et al. 2024 and 2025), through diffusers.

`MarigoldNormalsPipeline` of diffusers 0.42 gives X right, Y up and Z towards the observer (stated
in `MarigoldImageProcessor.visualize_normals`), which is our camera space. It pads a picture right
and below to whole blocks and cuts that off again, so pixels stay where they are at any size. Of
several normals the pipeline would keep the one nearest to the mean; here the mean is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.acquire.marigold import predictions
from pbrfit.acquire.padding import resized
from pbrfit.model.depth_normals import FACING

MODEL = "prs-eth/marigold-normals-v1-1"

UNCERTAINTY_ENSEMBLE_MIN = 3
"""Predictions below which their spread is not worth using."""

Array = NDArray[np.float64]


def from_picture(
    srgb8: NDArray[np.uint8], *, model: str = MODEL, **options: Any
) -> tuple[Array, Array | None, dict[str, Any]]:
    """Estimate normals of one picture.

    Options, errors and the record are those of `pbrfit.acquire.marigold.predictions`. Returns
    normals, (H, W, 3) unit vectors in camera space; their uncertainty, (H, W) degrees, see
    `mean_and_spread`, None for an ensemble below 3; and the record.
    """
    members, record = predictions(srgb8, "Normals", model=model, **options)
    height, width = srgb8.shape[:2]
    normals, spread = at_size(*mean_and_spread(members), (height, width))
    return normals, spread if len(members) >= UNCERTAINTY_ENSEMBLE_MIN else None, record


def mean_and_spread(members: Sequence[Array]) -> tuple[Array, Array]:
    """Mean direction of unit vectors, and how far a single one is off.

    For members n_i that scatter about a direction by small angles, the mean m = Σ n_i / |Σ n_i| is
    the direction with the least Σ θ_i², θ_i the angle between n_i and m. Two of the 2E degrees of
    freedom went into m, so

        σ² = Σ θ_i² / (E - 1)

    is the mean square angle between one member and the direction that all scatter about. It says
    how much the network's answers depend on the noise that it started from; an error that all
    members share is not in it. The mean is itself off by σ/√E on top of that. Returns mean: (H, W,
    3) unit vectors; (0, 0, 1) where the members cancel; spread: (H, W) σ in degrees; 0 of a single
    member.
    """
    total = np.zeros_like(members[0])
    for member in members:
        total += member
    length = np.linalg.norm(total, axis=-1, keepdims=True)
    mean = np.where(length > 1e-6 * len(members), total / np.maximum(length, 1e-12), FACING)
    squares = np.zeros(mean.shape[:2])
    for member in members:
        # arccos of n·m would lose half of the digits.
        chord = np.linalg.norm(member - mean, axis=-1)
        squares += (2 * np.arcsin(np.clip(chord / 2, 0.0, 1.0))) ** 2
    return mean, np.degrees(np.sqrt(squares / max(len(members) - 1, 1)))


def at_size(normals: Array, spread: Array, size: tuple[int, int]) -> tuple[Array, Array]:
    """Unit normals and their spread at (height, width), borders on borders."""
    if spread.shape == size:
        return normals, spread
    scaled = resized(normals, size).astype(np.float64)
    length = np.linalg.norm(scaled, axis=-1, keepdims=True)
    unit = np.where(length > 1e-6, scaled / np.maximum(length, 1e-6), FACING)
    return unit, resized(spread[..., None], size)[..., 0].astype(np.float64)
