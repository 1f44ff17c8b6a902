"""Verdicts: whether a map can be used, by the error that is to be expected of it.

The expected error of a map is the root mean square of its deviations, so it compares with an RMSE.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pbrfit.io.json_files import number, table, text
from pbrfit.model.materials import Materials

PARAMETERS = ("albedo", "roughness", "metallic")
"""Maps with an uncertainty, in the order of all tables."""

Level = Literal["usable", "rough guide", "not determined"]
LEVELS: tuple[Level, ...] = get_args(Level)
"""From the best to the worst."""

USABLE_MAX: Mapping[str, float] = dict.fromkeys(PARAMETERS, 0.1)
"""Expected error up to which a map is usable: a tenth of its range. Of a middle grey of albedo 0.2
it is half a stop."""

GUESS_DEVIATION: Mapping[str, float] = {"albedo": 0.22, "roughness": 0.25, "metallic": 0.3}
"""Standard deviation of a guess that knows only what materials there are: of dielectric albedos
and of roughness in the sets of `fit.priors.population`, and of metallic where a tenth is metal."""

ROUGH_MAX: Mapping[str, float] = {name: of / 2**0.5 for name, of in GUESS_DEVIATION.items()}
"""Expected error up to which a map is a rough guide: half of a guess's variance is gone. Above it
nothing is determined that a guess does not know."""


@dataclass(frozen=True)
class Verdict:
    """About one map."""

    level: Level
    expected_error: float
    """RMSE, in units of the map."""
    cause: str = ""
    """Why the map is no better, in words without a full stop; empty where it is usable."""
    remedy: str = ""
    """What would help, likewise."""

    def as_json(self) -> dict[str, Any]:
        """For result.json."""
        return asdict(self)

    @classmethod
    def from_json(cls, content: Any) -> Verdict:
        """From what `as_json` gave; raises one of `json_files.UNFIT` for anything else."""
        content = table(content)
        level = text(content["level"])
        if level not in LEVELS:
            raise ValueError(f"level {level!r}")
        found: Level = level  # type: ignore[assignment]
        expected = number(content["expected_error"])
        return cls(found, expected, text(content["cause"]), text(content["remedy"]))


def level_of(name: str, expected_error: float) -> Level:
    """What a map of this name can be used for."""
    if expected_error <= USABLE_MAX[name]:
        return "usable"
    return "rough guide" if expected_error <= ROUGH_MAX[name] else "not determined"


def expected_errors(deviation: Materials) -> dict[str, float]:
    """RMSE to be expected of each map, from its deviations."""
    found = {}
    for name in PARAMETERS:
        values = getattr(deviation, name)
        inside = values[np.isfinite(values)].astype(np.float32).astype(np.float64)
        found[name] = float(np.sqrt(np.mean(np.square(inside)))) if inside.size else 0.0
    return found


def levels(deviation: Materials) -> dict[str, NDArray[np.uint8]]:
    """For each pixel (H, W) the index in `LEVELS` that its own deviation alone would give its map.

    Of albedo the root mean square over channels. 255 outside the mask.
    """
    albedo = np.sqrt(np.mean(np.square(deviation.albedo), axis=-1))
    planes = dict(zip(PARAMETERS, (albedo, deviation.roughness, deviation.metallic), strict=True))
    found = {}
    for name, values in planes.items():
        limits = np.array([USABLE_MAX[name], ROUGH_MAX[name]])
        of_map = np.searchsorted(limits, values, side="left").astype(np.uint8)
        of_map[~np.isfinite(values)] = 255
        found[name] = of_map
    return found


def nothing_usable(verdicts: Mapping[str, Verdict]) -> bool:
    """Whether no map is usable, which `decompose --strict` refuses."""
    return all(one.level != "usable" for one in verdicts.values())
