"""What a fit of a room is given of its geometry and lamps, and how it takes the light to be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from pbrfit_evaluation.recipes import GUESS, Way

Depth = Literal["none", "true", "network", "rough", "integrated"]
"""The true one; disturbed like a network's (`depth_errors`), or more; integrated from normals."""

Segments = Literal["true", "found", "none"]
"""The true ones; those of `found_segments`."""


@dataclass(frozen=True)
class Variant(Way):
    """A way to explain a room, with what the fit is given.

    Attributes
    ----------
    depth, segments
        As they are called above.
    lamps
        Whether it is given the true ones.
    """

    depth: Depth = "none"
    segments: Segments = "true"
    lamps: bool = False


CONSTANT = Variant(**vars(GUESS))

WITHOUT, TRUE = "without", "true"
"""The principled model without geometry, and with all that is true: what figures compare."""


def _among(words: str, depth: Depth, segments: Segments = "true") -> Variant:
    return Variant(words, {"transport": "auto"}, depth=depth, segments=segments)


OF_GEOMETRY: Mapping[str, Variant] = {
    "constant": CONSTANT,
    "default": Variant("default model, no depth", {"model": None}),
    WITHOUT: Variant("no depth"),
    TRUE: _among("true depth", "true"),
    "network": _among("depth of a network", "network"),
    "rough": _among("rough depth", "rough"),
    "integrated": _among("integrated normals", "integrated"),
    "found": _among("true depth, found segments", "true", "found"),
    "unsegmented": _among("true depth, no segments", "true", "none"),
    "network-found": _among("depth of a network, found segments", "network", "found"),
}

HARMONICS, NEAR = "sh", "lamps-depth"
"""The fit that knows no lamps, and the one that is given depth: what verdicts compare."""


def _lit(words: str, light: str, depth: Depth = "none", *, lamps: bool = False) -> Variant:
    return Variant(words, {"light": light}, depth=depth, lamps=lamps)


OF_LAMPS: Mapping[str, Variant] = {
    "constant": CONSTANT,
    HARMONICS: _lit("environment light, no depth", "sh"),
    "sh-depth": _lit("environment light, depth", "sh", "true"),
    "lamps": _lit("lamps, no depth", "lamps"),
    NEAR: _lit("lamps, depth", "lamps", "true"),
    "auto": _lit("auto, no depth", "auto"),
    "auto-depth": _lit("auto, depth", "auto", "true"),
    "known": _lit("known lamps, depth", "lamps", "true", lamps=True),
}

VARIANTS = {**OF_GEOMETRY, **OF_LAMPS}
