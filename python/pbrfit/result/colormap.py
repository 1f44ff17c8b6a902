"""One map from numbers to colours, for everyone's eyes.

A straight line in Oklab, from dark blue to light yellow: equal steps look equally large, lightness
rises all along, so it survives grey printing, and blue to yellow is the axis that people with red
or green blindness see like everybody else.

Source: B. Ottosson, "A perceptual color space for image processing", 2020.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.io.color import encode_srgb

FIRST = (0.22, -0.010, -0.085)
LAST = (0.95, -0.040, 0.130)
"""Ends of the line: lightness, green to red, blue to yellow. All of it lies within sRGB."""

LMS_OF_OKLAB = np.array(
    [
        [1.0, 0.3963377774, 0.2158037573],
        [1.0, -0.1055613458, -0.0638541728],
        [1.0, -0.0894841775, -1.2914855480],
    ]
)
"""To cube roots of cone responses."""

RGB_OF_LMS = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)
"""From cone responses to linear Rec.709."""


def blue_to_yellow(values: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Colours (..., 3), sRGB in [0, 1], of values (...,); those outside [0, 1] take the ends'."""
    t = np.clip(values, 0, 1)[..., None]
    oklab = (1 - t) * np.array(FIRST) + t * np.array(LAST)
    linear = (oklab @ LMS_OF_OKLAB.T) ** 3 @ RGB_OF_LMS.T
    return np.asarray(encode_srgb(linear))
