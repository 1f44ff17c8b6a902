"""From linear radiance to what a screen shows: exposure, tone mapping, sRGB curve."""

from __future__ import annotations

from typing import Literal

import numpy as np

from pbrfit.io.color import encode_srgb, over_channels
from pbrfit.values.arrays import Array, Codes, Floats
from pbrfit.values.checks import finite, one_of

ToneMap = Literal["none", "neutral"]
"""How radiance above white is shown: clipped, or by `neutral`."""


def encoded(radiance: Floats, exposure: float = 0.0, tone_map: ToneMap = "none") -> Array:
    """Values for an sRGB screen, in [0, 1], of linear Rec.709 radiance (..., 3); NaN stays NaN.

    1 is white at exposure 0, in stops: radiance is multiplied by 2^exposure. Negative radiance is
    black, and the tone map ``none`` clips each channel at 1. Raises InputError if `tone_map` is
    another, or `exposure` is not finite.
    """
    one_of("tone_map", tone_map, ToneMap)
    finite("exposure", exposure, "a number of stops")
    exposed = np.maximum(np.asarray(radiance, dtype=np.float64) * 2.0**exposure, 0.0)
    shown = neutral(exposed) if tone_map == "neutral" else exposed
    return encode_srgb(np.clip(shown, 0.0, 1.0))


def codes(shown: Floats) -> Codes:
    """Values in [0, 1], (H, W) or (H, W, 3), as 8-bit codes (H, W, C); alpha is 0 where NaN is."""
    shown = np.atleast_3d(shown)
    outside = over_channels(np.logical_or, np.isnan(shown))
    found = np.rint(255 * np.where(outside[..., None], 0.0, np.clip(shown, 0.0, 1.0)))
    if outside.any():
        found = np.dstack([found, np.where(outside, 0, 255)])
    return np.asarray(found, np.uint8)


def neutral(radiance: Array) -> Array:
    """Compress highlights and keep colours below 0.8 as they are; (..., 3), 0 or more.

    Made for pictures of products, whose base colours are to be recognised: what is not a highlight
    is shown one to one, but for the 4 % of white that dielectrics mirror. Source: Khronos PBR
    Neutral Tone Mapper, 2024.
    """
    least = over_channels(np.minimum, radiance)[..., None]
    color = radiance - np.where(least < 2 * FRESNEL, least - least**2 / (4 * FRESNEL), FRESNEL)
    peak = over_channels(np.maximum, color)[..., None]
    room = 1 - COMPRESSED_FROM
    lowered = 1 - room**2 / (np.maximum(peak, COMPRESSED_FROM) + room - COMPRESSED_FROM)
    grey = 1 - 1 / (DESATURATION * (peak - lowered) + 1)
    with np.errstate(invalid="ignore", divide="ignore"):  # black, which is not compressed
        compressed = color * (lowered / peak) * (1 - grey) + lowered * grey
    return np.where(peak < COMPRESSED_FROM, color, compressed)


FRESNEL = 0.04
COMPRESSED_FROM = 0.8 - FRESNEL
DESATURATION = 0.15
