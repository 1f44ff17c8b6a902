"""Depth by Marigold (Ke et al. 2024 and 2025), through diffusers.

`MarigoldDepthPipeline` gives depth between 0 and 1 up to an unknown factor and offset, another one
with each seed. Members of an ensemble are brought to the first by least squares, and averaged.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.acquire.marigold import predictions
from pbrfit.acquire.padding import resized

MODEL = "prs-eth/marigold-depth-v1-1"


def from_picture(
    srgb8: NDArray[np.uint8], *, model: str = MODEL, **options: Any
) -> tuple[NDArray[np.float64], dict[str, Any]]:
    """Estimate relative depth of one picture (H, W, 3), sRGB.

    Options, errors and the record are those of `pbrfit.acquire.marigold.predictions`. Returns depth
    (H, W), up to a factor and an offset, and the record.
    """
    members, record = predictions(srgb8, "Depth", model=model, **options)
    depth = aligned_mean([one[..., 0] for one in members])
    height, width = srgb8.shape[:2]
    return resized(depth[..., None], (height, width))[..., 0].astype(np.float64), record


def aligned_mean(members: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Mean of maps (H, W), each with the factor and offset by which it is nearest to the first."""
    first = members[0]
    total = first.copy()
    for member in members[1:]:
        both = np.stack([member.ravel(), np.ones(member.size)], axis=-1)
        total += (both @ np.linalg.lstsq(both, first.ravel())[0]).reshape(first.shape)
    return np.asarray(total / len(members))
