"""What a fit decided about surroundings: data that a result keeps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal, get_args

from pbrfit.io.json_files import number, table
from pbrfit.transport.extents import Extents

Kind = Literal["none", "occlusion", "bounce"]
"""Whether surroundings do nothing, block light, or also bring the light that they reflect."""


@dataclass(frozen=True)
class Transport:
    """What a fit decided about surroundings, and why."""

    kind: Kind = "none"
    why: str = "no depth is given"
    extents: Extents | None = None
    gain: float = 1.0
    """What light from surfaces is multiplied by, beside what pictures show of them."""
    figures: Mapping[str, float] = field(default_factory=dict)
    """Mean of ln(residual²/radiance²) of pixels that lights were not fitted to:
    `left_out_occlusion`, `left_out_bounce`, as far as they were tried, and `left_out_pixels`."""

    @property
    def blocks(self) -> bool:
        """Whether surroundings do anything."""
        return self.kind != "none"

    def as_json(self) -> dict[str, Any]:
        """What `result.json` holds under `transport`."""
        return {
            "kind": self.kind,
            "why": self.why,
            "extents": None if self.extents is None else asdict(self.extents),
            "gain": self.gain,
            "figures": dict(self.figures),
        }

    @classmethod
    def from_json(cls, content: Any) -> Transport:
        """Undo `as_json`; ValueError if it is something else. None, of older results, is none."""
        if content is None:
            return cls(why="the fit knew no surroundings")
        values = table(content)
        [kind] = [one for one in get_args(Kind) if one == values.get("kind")]
        extents = None
        if values.get("extents") is not None:
            of_extents = table(values["extents"])
            of_extents["blocks"] = tuple(map(bool, of_extents["blocks"]))
            extents = Extents(**of_extents)
        return cls(
            kind,
            str(values["why"]),
            extents,
            number(values["gain"]),
            {name: number(value) for name, value in table(values["figures"]).items()},
        )


NOT_TRIED = Transport()
"""The decision about a scene without depth."""
