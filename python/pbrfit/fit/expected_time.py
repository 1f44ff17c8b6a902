"""How long a fit will take, said before it is begun: an order of magnitude."""

from __future__ import annotations

from pbrfit.fit.parameters import ParameterLayout

FIXED_SECONDS = 3.0
"""Processor time of the smallest fit: joint steps, prior and scale of a few hundred pixels."""

PICTURE_SECONDS = 0.08
"""Processor time a picture: joint steps, in which some pixels stand for all, and the look for
lamps."""

PIXEL_SECONDS = 30e-6
"""Processor time a pixel: descents of its material and its uncertainty."""

SAMPLE_SECONDS = 0.4e-6
"""Processor time a sample of a pixel, picture and channel."""


def expected_seconds(layout: ParameterLayout) -> float:
    """Processor time of a fit with defaults, without surroundings; rarely off by more than twice.

    By fits of textured rooms with 1 % noise, 32² to 512² with 4 to 200 pictures, on an AMD EPYC
    (Zen 4): 3.5 to 30 s.
    """
    samples = layout.pixels * layout.pictures * layout.channels
    few = FIXED_SECONDS + PICTURE_SECONDS * layout.pictures
    return few + PIXEL_SECONDS * layout.pixels + SAMPLE_SECONDS * samples


def in_words(seconds: float) -> str:
    """A time in seconds, minutes or hours, whichever is two digits long."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = seconds / 60
    return f"{minutes:.0f} min" if minutes < 100 else f"{minutes / 60:.0f} h"
