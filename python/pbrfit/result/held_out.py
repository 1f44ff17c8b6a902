"""How well a fit explains pictures that it was not fitted to: data that a result keeps."""

from __future__ import annotations

from dataclasses import dataclass

LEAST = 1e-5
"""Relative error below which digits mean nothing."""


@dataclass(frozen=True)
class Candidate:
    """An explanation that was compared."""

    what: str
    """In words."""
    score: float
    """Less is better (`pbrfit.fit.compare`)."""
    error: float
    """Relative root mean square error of left-out pictures, in the files' values."""


@dataclass(frozen=True)
class HeldOut:
    """What pictures say of explanations that were fitted to the others, but for their light."""

    error: float
    """Of what was chosen, as of a candidate."""
    nearest_picture: float
    """The same where for each left-out picture the most similar other one is shown."""
    pictures: int
    """How many were left out."""
    chosen: str
    candidates: tuple[Candidate, ...]
    """All, the best score first."""

    @property
    def explains(self) -> bool:
        """Whether it is better than to show the nearest picture."""
        return self.error < self.nearest_picture

    @property
    def error_in_words(self) -> str:
        """In percent, with as many digits as mean something."""
        return _percent(self.error)

    def in_words(self) -> str:
        """A sentence about a fit, without its full stop."""
        error, nearest = _percent(max(self.error, LEAST)), _percent(self.nearest_picture)
        said = "explains pictures it was not fitted to"
        if self.explains:
            return f"{said} within {error} (the nearest photograph: {nearest})"
        return f"{said} only within {error}, no better than the nearest photograph ({nearest})"

    def decision(self) -> str:
        """What was chosen and what came second; a sentence without its full stop."""
        others = [one for one in self.candidates if one.what != self.chosen]
        if not others:
            return f"chosen: {self.chosen}"
        second = others[0]
        return f"chosen: {self.chosen}; second: {second.what}, {_percent(second.error)}"


def _percent(share: float) -> str:
    """A share with two digits, or as a whole number: 0.0039 %, 3.9 %, 39 %, 120 %."""
    if 0 < share < LEAST:
        return f"< {100 * LEAST:g} %"
    return f"{100 * share:.2g} %" if share < 0.1 else f"{100 * share:.0f} %"
