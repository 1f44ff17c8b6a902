"""A small DNG file of a made-up camera, to be read by LibRaw."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

BLACK, WHITE = 128, 4095

NEUTRAL = (0.5, 1.0, 0.8)
"""What the camera's channels are of white: the balance is 2, 1, 1.25."""

XYZ_TO_CAMERA = (0.67, -0.06, -0.10, -0.43, 1.25, 0.20, -0.09, 0.22, 0.57)


def write_dng(path: Path, white_share: NDArray[np.floating[Any]], orientation: int = 1) -> None:
    """Write a picture of a white card whose radiance (H, W), of the green white level, is given.

    The pattern is R G, G B; sensors stop at their white level.
    """
    import tifffile

    share = np.array(white_share, np.float64)
    share[0::2, 0::2] *= NEUTRAL[0]
    share[1::2, 1::2] *= NEUTRAL[2]
    bayer = np.rint(BLACK + np.minimum(share, 1) * (WHITE - BLACK)).astype(np.uint16)

    def rationals(values: tuple[float, ...]) -> tuple[int, ...]:
        return tuple(part for value in values for part in (round(10_000 * value), 10_000))

    tags = [
        (271, "s", 0, "Acme", False),
        (272, "s", 0, "Acme One", False),
        (274, "H", 1, orientation, False),
        (33421, "H", 2, (2, 2), False),  # repeated pattern
        (33422, "B", 4, (0, 1, 1, 2), False),
        (50706, "B", 4, (1, 4, 0, 0), False),  # version
        (50708, "s", 0, "Acme One", False),
        (50714, "H", 1, BLACK, False),
        (50717, "H", 1, WHITE, False),
        (50721, "2i", 9, rationals(XYZ_TO_CAMERA), False),
        (50728, "2I", 3, rationals(NEUTRAL), False),
        (50778, "H", 1, 21, False),  # D65
    ]
    tifffile.imwrite(path, bayer, photometric=32803, planarconfig=1, extratags=tags, metadata=None)
