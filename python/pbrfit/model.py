"""The forward model on arrays: thin, checked wrappers around the Rust core.

Camera space throughout: X right, Y up, Z towards the viewer. Radiance is linear Rec.709.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Materials:
    """Material maps of one view.

    Attributes
    ----------
    albedo
        (H, W, 3), base colour, linear Rec.709, in [0, 1]; of a metal it is F0.
    roughness
        (H, W), perceptual roughness r in [0, 1]; the GGX width is alpha = r².
    metallic
        (H, W), in [0, 1].

    Pixels outside the mask are NaN in all three.
    """

    albedo: NDArray[np.floating[Any]]
    roughness: NDArray[np.floating[Any]]
    metallic: NDArray[np.floating[Any]]
