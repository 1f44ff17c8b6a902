"""What a fit of a room is told of its geometry and lamps, and how it takes the light to be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

Depth = Literal["none", "true", "network", "rough", "integrated"]
"""The true one; disturbed like a network's (`depth_errors`), or more; integrated from normals."""

Segments = Literal["true", "found", "none"]
"""The true ones; those of `found_segments`."""


@dataclass(frozen=True)
class Variant:
    """A way to explain a room.

    Attributes
    ----------
    key, words
        For files, and for people.
    depth, segments
        What the fit is told.
    options
        Of the fit.
    model
        That is fitted; None = pbrfit's default. Cycles renders the principled one.
    lamps
        Whether the fit is told the true ones.
    guess
        Whether nothing is fitted but the lights.
    """

    key: str
    words: str
    depth: Depth = "none"
    segments: Segments = "true"
    options: Mapping[str, Any] = field(default_factory=dict)
    model: Literal["principled"] | None = "principled"
    lamps: bool = False
    guess: bool = False


GUESS = Variant("constant", "constant guess", guess=True)

GEOMETRY: Mapping[str, Any] = {"transport": "auto"}
WITHOUT, TRUE = "without", "true"
"""The principled model without geometry, and with all that is true: what figures compare."""

OF_GEOMETRY = (
    GUESS,
    Variant("default", "default model, no depth", model=None),
    Variant(WITHOUT, "no depth"),
    Variant(TRUE, "true depth", "true", options=GEOMETRY),
    Variant("network", "depth of a network", "network", options=GEOMETRY),
    Variant("rough", "rough depth", "rough", options=GEOMETRY),
    Variant("integrated", "integrated normals", "integrated", options=GEOMETRY),
    Variant("found", "true depth, found segments", "true", "found", GEOMETRY),
    Variant("unsegmented", "true depth, no segments", "true", "none", GEOMETRY),
    Variant("network-found", "depth of a network, found segments", "network", "found", GEOMETRY),
)

HARMONICS, NEAR = "sh", "lamps-depth"
"""The fit that knows no lamps, and the one that is told depth: what verdicts compare."""

OF_LAMPS = (
    GUESS,
    Variant(HARMONICS, "environment light, no depth", options={"light": "sh"}),
    Variant("sh-depth", "environment light, depth", "true", options={"light": "sh"}),
    Variant("lamps", "lamps, no depth", options={"light": "lamps"}),
    Variant(NEAR, "lamps, depth", "true", options={"light": "lamps"}),
    Variant("auto", "auto, no depth", options={"light": "auto"}),
    Variant("auto-depth", "auto, depth", "true", options={"light": "auto"}),
    Variant("known", "known lamps, depth", "true", options={"light": "lamps"}, lamps=True),
)

BY_KEY = {variant.key: variant for variant in (*OF_GEOMETRY, *OF_LAMPS)}
