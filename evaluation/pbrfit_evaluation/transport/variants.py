"""What a fit is told of the geometry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Depth = Literal["none", "true", "network", "rough", "integrated"]
"""The true one; disturbed like a network's (`depth_errors`), or more; integrated from normals."""

Segments = Literal["true", "found", "none"]
"""The true ones; those of `found_segments`."""


@dataclass(frozen=True)
class Variant:
    """A way to explain a scene.

    Attributes
    ----------
    key, words
        For files, and for people.
    depth, segments
        What the fit is told.
    transport
        Option of the fit; None = as it is without geometry.
    model
        That is fitted; None = pbrfit's default.
    guess
        Whether nothing is fitted but the lights.
    """

    key: str
    words: str
    depth: Depth = "none"
    segments: Segments = "true"
    transport: str | None = None
    model: Literal["principled"] | None = "principled"
    guess: bool = False


WITHOUT, TRUE = "without", "true"
"""The principled model without geometry, and with all that is true: what figures compare."""

VARIANTS = (
    Variant("constant", "constant guess", guess=True),
    Variant("default", "default model, no depth", model=None),
    Variant(WITHOUT, "no depth"),
    Variant(TRUE, "true depth", "true", transport="auto"),
    Variant("network", "depth of a network", "network", transport="auto"),
    Variant("rough", "rough depth", "rough", transport="auto"),
    Variant("integrated", "integrated normals", "integrated", transport="auto"),
    Variant("found", "true depth, found segments", "true", "found", transport="auto"),
    Variant("unsegmented", "true depth, no segments", "true", "none", transport="auto"),
    Variant(
        "network-found",
        "depth of a network, found segments",
        "network",
        "found",
        transport="auto",
    ),
)

BY_KEY = {variant.key: variant for variant in VARIANTS}
