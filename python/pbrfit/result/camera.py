"""What a fit decided about the camera, and why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from pbrfit._core import InputError
from pbrfit.io.color import Curve
from pbrfit.model.geometry import check_fov
from pbrfit.scene.correction import Correction

How = Literal["given", "fitted", "assumed"]

FOV_DOUBTED = 5.0
"""Standard deviation of a fitted field of view, in degrees, above which the true one is asked."""


@dataclass(frozen=True)
class Camera:
    """The field of view of a fit, and what the pictures say of it."""

    fov_degrees: float
    """Horizontal, 0 = orthographic."""
    how: How
    """"given"; "fitted" with all else, as nobody told it; or "assumed", as there was no time."""
    fov_sigma: float | None = None
    """Standard deviation of what was fitted, in degrees; else None."""
    contradicted: bool = False
    """Whether the pictures fit far better with another than was given."""
    correction: Correction | None = None
    """The tone curve that was undone in the pictures; None = nothing."""
    response: Curve | None = None
    """The curve that files were decoded by, where the fit decided; None = as the scene said."""
    figures: Mapping[str, float] = field(default_factory=dict)
    """Where the given field of view is contradicted, `other_fov_degrees` and `other_fov_sigma`.
    Infinite and NaN ones are null in a file."""

    def __post_init__(self) -> None:
        check_fov(self.fov_degrees)
        if self.contradicted and not {"other_fov_degrees", "other_fov_sigma"} <= set(self.figures):
            raise InputError("camera: expected what contradicts its field of view, found nothing")

    def in_words(self) -> str:
        """The field of view, and how it was found."""
        if self.fov_sigma is None:
            return f"{self.fov_degrees:g} degrees, {self.how}"
        return f"{_with_sigma(self.fov_degrees, self.fov_sigma)} degrees, {self.how}"

    def contradiction(self) -> str:
        """What the pictures say against what was given."""
        found = _with_sigma(self.figures["other_fov_degrees"], self.figures["other_fov_sigma"])
        return f"the pictures fit far better with about {found}"

    def doubt(self) -> str:
        """What is doubtful about it, a clause; empty where nothing is."""
        if self.contradicted:
            return f"the field of view is {self.in_words()}, but {self.contradiction()}"
        if self.how == "assumed":
            return f"the field of view is a guess, {self.fov_degrees:g} degrees"
        if self.fov_sigma is not None and self.fov_sigma > FOV_DOUBTED:
            return f"the field of view is hardly known, {self.in_words()}"
        return ""


def _with_sigma(degrees: float, sigma: float) -> str:
    """Both to the digit that the deviation has."""
    digits = 0 if sigma >= 2 else 1 if sigma >= 0.2 else 2
    return f"{degrees:.{digits}f} ± {max(sigma, 0.01):.{digits}f}"
