"""Residuals, errors and deviations as colours: one logarithmic scale for all of them.

So a colour means the same number everywhere, in every preview and every report, and an error can be
compared with the deviation that was predicted for it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from pbrfit.io.color import encode_srgb, over_channels
from pbrfit.model.materials import Materials
from pbrfit.result.refinement import CHANGE_DEGREES_MIN
from pbrfit.result.uncertainty import Uncertainty
from pbrfit.result.verdict import LEVELS, levels, planes
from pbrfit.values.arrays import Array, Codes, Floats, Mask

SCALE = (0.001, 1.0)
"""Ends of the scale; what lies beyond takes the ends' colours."""

TICKS = {0.001: "0.001", 0.003: "", 0.01: "0.01", 0.03: "", 0.1: "0.1", 0.3: "", 1.0: "1"}
"""Labels by value."""

DEGREE_TICKS = {0.1: "0.1°", 0.3: "", 1.0: "1°", 3.0: "", 10.0: "10°", 30.0: "30°"}
"""Labels by angle in degrees."""

# Colours lie on a straight line in Oklab (B. Ottosson, "A perceptual color space for image
# processing", 2020), from dark blue to light yellow: equal steps look equally large, also in grey
# and to people with red or green blindness.

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


def blue_to_yellow(values: Floats) -> Array:
    """Colours (..., 3), sRGB in [0, 1], of values (...,); those outside [0, 1] take the ends'."""
    t = np.clip(values, 0, 1)[..., None]
    oklab = (1 - t) * np.array(FIRST) + t * np.array(LAST)
    linear = (oklab @ LMS_OF_OKLAB.T) ** 3 @ RGB_OF_LMS.T
    return np.asarray(encode_srgb(linear))


ROWS = 64
"""Rows of a picture that are looked at together: caches hold them."""

STEPS = 251
"""Colours on the scale."""

WHITE, VERMILLION, OUTSIDE = STEPS, STEPS + 1, STEPS + 2
"""Indices of what is not on the scale."""

PALETTE = np.concatenate(
    [
        blue_to_yellow(np.linspace(0, 1, STEPS)),
        # Vermillion is told apart from the scale, from white and from grey by all common colour
        # vision.
        [[1.0, 1.0, 1.0], [0.84, 0.37, 0.0], [0.85, 0.85, 0.85]],
    ]
)
"""(254, 3) sRGB in [0, 1]."""


@dataclass(frozen=True, eq=False)
class Difference:
    """A map of differences."""

    values: Floats
    """(H, W), 0 or more; NaN outside the mask."""
    white: Mask | None = None
    vermillion: Mask | None = None
    """(H, W) bool: pixels with a colour of their own instead; None = none."""

    def indices(self) -> Codes:
        """(H, W) into `PALETTE`."""
        share = on_scale(np.where(np.isfinite(self.values), self.values, 1.0))
        found = np.rint(share * (STEPS - 1)).astype(np.uint8)
        for index, marked in ((WHITE, self.white), (VERMILLION, self.vermillion)):
            if marked is not None:
                found[marked] = index
        found[np.isnan(self.values)] = OUTSIDE
        return found


def on_scale(values: Floats | float) -> Array:
    """Where on the scale values lie, from 0 to 1."""
    low, high = map(math.log, SCALE)
    clipped = np.clip(np.asarray(values, dtype=np.float64), *SCALE)
    return np.asarray((np.log(clipped) - low) / (high - low))


def tick_places(*, degrees: bool = False) -> dict[float, str]:
    """Labels by their place on the scale, from 0 to 1: of plain numbers, or of degrees."""
    if degrees:
        return {float(on_scale(math.radians(t))): label for t, label in DEGREE_TICKS.items()}
    return {float(on_scale(t)): label for t, label in TICKS.items()}


def residual(
    rendered: Floats, picture: Floats, weights: Floats | None = None
) -> tuple[Difference, float, float]:
    """Root mean square over channels of (rendered − picture), relative to the picture's RMS.

    Both are (H, W, 3), and `rendered` is NaN outside the mask. Values of weight (H, W, 3) 0 took no
    part in the fit and have none here; pixels with no others are white. Beside it the root mean
    squares of picture and residual by those weights.
    """
    used: Mask = over_channels(np.logical_and, np.isfinite(rendered))
    squares, channels, brightness = np.zeros(used.shape), np.zeros(used.shape, np.intp), 0.0
    weighted = np.zeros(3)
    for first in range(0, len(used), ROWS):
        rows = slice(first, first + ROWS)
        inside = np.broadcast_to(used[rows, :, None], np.shape(picture[rows]))
        weight = inside * (1.0 if weights is None else weights[rows])
        counted = weight > 0
        shown = np.where(counted, picture[rows], np.float64(0))
        error = np.where(counted, rendered[rows], 0.0) - shown
        channels[rows] = np.count_nonzero(counted, axis=-1)
        squares[rows] = np.einsum("hwc,hwc->hw", error, error)
        brightness += float(np.einsum("hwc,hwc->", shown, shown))
        of_both = (np.einsum("hwc,hwc,hwc->", weight, of, of) for of in (shown, error))
        weighted += weight.sum(dtype=np.float64), *of_both
    difference = np.sqrt(squares / np.maximum(channels, 1))
    difference /= math.sqrt(brightness / max(int(channels.sum()), 1)) or 1.0
    difference[~used] = np.nan
    white = None if weights is None else used & (channels == 0)
    rms, rmse = np.sqrt(weighted[1:] / (weighted[0] or 1.0)).tolist()
    return Difference(difference, white=white), rms, rmse


def turned(degrees: Floats) -> Difference:
    """Angles (H, W) between given and refined normals, by radians; white = as given.

    A small angle in radians is how far apart the unit vectors are, so it has the place on the scale
    that a difference of that size has. `DEGREE_TICKS` are for its key.
    """
    return Difference(np.radians(degrees), white=degrees < CHANGE_DEGREES_MIN)


def errors(found: Materials, true: Materials) -> dict[str, Difference]:
    """Absolute errors of the maps by name; of albedo the root mean square over channels."""
    error = Materials(
        found.albedo - true.albedo,
        np.abs(found.roughness - true.roughness),
        np.abs(found.metallic - true.metallic),
    )
    return {name: Difference(values) for name, values in planes(error).items()}


def deviations(uncertainty: Uncertainty) -> dict[str, Difference]:
    """Standard deviations; white = given, vermillion = not determined.

    Of albedo the root mean square over channels.
    """
    of_pixels = levels(uncertainty.deviation)
    return {
        name: Difference(values, values == 0, of_pixels[name] == LEVELS.index("not determined"))
        for name, values in planes(uncertainty.deviation).items()
    }


def deviation_marks(maps: Iterable[Difference]) -> dict[str, int]:
    """Entries of the palette beside the scale by label, of those that some of `deviations` have."""
    found = {}
    for label, index in (("given", WHITE), ("not determined", VERMILLION)):
        if any((one.indices() == index).any() for one in maps):
            found[label] = index
    return found
