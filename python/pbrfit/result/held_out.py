"""How well a fit explains pictures that it was not fitted to: data that a result keeps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from pbrfit.io.json_files import number, table


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
    """What left-out pictures say of explanations: materials of some pixels were fitted to the
    other pictures, and then the light of these alone."""

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

    def in_words(self) -> str:
        """A sentence without its full stop."""
        error, nearest = (f"{100 * one:.2g} %" for one in (self.error, self.nearest_picture))
        return (
            f"explains pictures it was not fitted to within {error} (the nearest photograph: "
            f"{nearest})"
        )

    def decision(self) -> str:
        """What was chosen and what came second; a sentence without its full stop."""
        others = [one for one in self.candidates if one.what != self.chosen]
        if not others:
            return f"chosen: {self.chosen}"
        second = others[0]
        return f"chosen: {self.chosen}; second: {second.what}, {100 * second.error:.2g} %"

    def as_json(self) -> dict[str, Any]:
        """What `result.json` holds under `held_out`."""
        return asdict(self)

    @classmethod
    def from_json(cls, content: Mapping[str, Any] | None) -> HeldOut | None:
        """Undo `as_json`; ValueError, KeyError or TypeError if it is something else."""
        if content is None:
            return None
        return cls(
            number(content["error"]),
            number(content["nearest_picture"]),
            int(content["pictures"]),
            str(content["chosen"]),
            tuple(
                Candidate(str(one["what"]), number(one["score"]), number(one["error"]))
                for one in map(table, content["candidates"])
            ),
        )
