"""What a fit of a room under lamps is told, and how it takes the light to be."""

from __future__ import annotations

from dataclasses import dataclass

from pbrfit.result.options import LightChoice


@dataclass(frozen=True)
class Variant:
    """A way to explain a room.

    Attributes
    ----------
    key, words
        For files, and for people.
    light
        Option of the fit.
    depth, lamps
        Whether the fit is told the true ones; of lamps only where they are.
    guess
        Whether nothing is fitted but the lights.
    """

    key: str
    words: str
    light: LightChoice = "sh"
    depth: bool = False
    lamps: bool = False
    guess: bool = False


CONSTANT, HARMONICS, NEAR = "constant", "sh", "lamps-depth"
"""The guess, the fit that knows no lamps, and the one that is told depth: what verdicts compare."""

VARIANTS = (
    Variant(CONSTANT, "constant guess", guess=True),
    Variant(HARMONICS, "environment light, no depth"),
    Variant("sh-depth", "environment light, depth", depth=True),
    Variant("lamps", "lamps, no depth", "lamps"),
    Variant(NEAR, "lamps, depth", "lamps", depth=True),
    Variant("auto", "auto, no depth", "auto"),
    Variant("auto-depth", "auto, depth", "auto", depth=True),
    Variant("known", "known lamps, depth", "lamps", depth=True, lamps=True),
)

BY_KEY = {variant.key: variant for variant in VARIANTS}
