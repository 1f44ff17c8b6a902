"""Verdicts: whether a map can be used, by the error that is to be expected of it.

The expected error of a map is the root mean square of its deviations, so it compares with an RMSE.
It may be off by a factor, for which verdicts leave a `MARGIN`: a map is called *usable* where its
error would be small enough if it were so much larger than expected, and *not determined* where it
would be too large if it were so much smaller.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np

from pbrfit.io.json_files import read_as, table
from pbrfit.model.materials import Materials
from pbrfit.result.held_out import HeldOut
from pbrfit.values.arrays import Codes, Floats

PARAMETERS = ("albedo", "roughness", "metallic")
"""Maps with an uncertainty, in the order of all tables."""

Level = Literal["usable", "rough guide", "not determined"]
LEVELS: tuple[Level, ...] = get_args(Level)
"""From the best to the worst."""

MARGIN = 1.2
"""Factor between expected and true errors that verdicts leave room for: of 108 maps of rooms that
were disturbed in eleven ways a tenth was off by more."""

USABLE_ERROR: Mapping[str, float] = dict.fromkeys(PARAMETERS, 0.1)
"""Error up to which a map is usable: a tenth of its range, half a stop of albedo 0.2."""

GUESS_DEVIATION: Mapping[str, float] = {"albedo": 0.22, "roughness": 0.25, "metallic": 0.3}
"""Standard deviation of a guess that knows only what materials there are: of dielectric albedos
and of roughness in the sets of `fit.priors.population`, and of metallic where a tenth is metal."""

ROUGH_ERROR: Mapping[str, float] = {name: of / 2**0.5 for name, of in GUESS_DEVIATION.items()}
"""Error up to which a map is a rough guide: half of a guess's variance is gone. Above it nothing is
determined that a guess does not know."""

USABLE_MAX: Mapping[str, float] = {name: of / MARGIN for name, of in USABLE_ERROR.items()}
ROUGH_MAX: Mapping[str, float] = {name: of * MARGIN for name, of in ROUGH_ERROR.items()}
"""Expected errors up to which maps are called usable, and a rough guide."""

FOV_CONTRADICTED = "the pictures contradict the field of view"
UNEXPLAINED = "the fit explains pictures that were left out worse than the nearest picture does"
MORE_TOLD = "a mask, better normals or more pictures would help"
"""Causes for which no map is usable, and the remedy of the second."""


@dataclass(frozen=True)
class Mark:
    """A disc that stands for a level: told by its filling as well as by its colour."""

    filled: float
    """Share of the disc, from the left."""
    color: tuple[float, float, float]
    """sRGB in [0, 1], told apart by all common colour vision."""
    sign: str
    """The disc as a letter, for text."""
    ink: tuple[int, int, int]
    """The colour of letters, of terminals' 216, with a contrast of 3 or more on black and white."""


MARKS: Mapping[Level, Mark] = {
    "usable": Mark(1.0, (0.0, 0.45, 0.70), "●", (0, 135, 215)),
    "rough guide": Mark(0.5, (0.90, 0.62, 0.0), "◐", (175, 135, 0)),
    "not determined": Mark(0.0, (0.84, 0.37, 0.0), "○", (215, 95, 0)),
}
"""Colours of Okabe and Ito; vermillion is also that of pixels which are not determined."""


@dataclass(frozen=True)
class Verdict:
    """About one map."""

    level: Level
    expected_error: float
    """RMSE, in units of the map."""
    cause: str = ""
    """Why the map is no better, in words without a full stop; empty where it is usable."""
    remedy: str = ""
    """What would help, likewise and with its verb."""

    @property
    def error_in_words(self) -> str:
        """Expected error with as many digits as mean something."""
        error = self.expected_error
        if 0 < error < 0.001:
            return "< 0.001"
        return f"± {error:.2f}" if error >= 0.01 else f"± {error:.3f}" if error else "± 0"

    def in_words(self) -> str:
        """All of it, as it stands beside a map."""
        why = "; ".join(filter(None, (self.cause, self.remedy)))
        return ": ".join(filter(None, (f"{self.level}, {self.error_in_words}", why)))


def level_of(name: str, expected_error: float) -> Level:
    """What a map of this name is said to be usable for."""
    return _level(expected_error, USABLE_MAX[name], ROUGH_MAX[name])


def deserved(name: str, error: float) -> Level:
    """What it can be used for by its true error."""
    return _level(error, USABLE_ERROR[name], ROUGH_ERROR[name])


def _level(error: float, usable: float, rough: float) -> Level:
    if error <= usable:
        return "usable"
    return "rough guide" if error <= rough else "not determined"


def by_deviations(deviation: Materials) -> dict[str, Verdict]:
    """Of each map, without causes: the RMSE to be expected is that of its deviations."""
    found = {}
    for name in PARAMETERS:
        values = getattr(deviation, name)
        inside = values[np.isfinite(values)].astype(np.float32).astype(np.float64)
        error = float(np.sqrt(np.mean(np.square(inside)))) if inside.size else 0.0
        found[name] = Verdict(level_of(name, error), error)
    return found


def capped(verdicts: Mapping[str, Verdict], held_out: HeldOut | None) -> dict[str, Verdict]:
    """Verdicts of which none is *usable* where left-out pictures are explained too badly."""
    if held_out is None or held_out.explains:
        return dict(verdicts)
    usable = {name: one for name, one in verdicts.items() if one.level == "usable"}
    return {**verdicts, **doubted(usable, UNEXPLAINED, MORE_TOLD)}


def doubted(verdicts: Mapping[str, Verdict], cause: str, remedy: str) -> dict[str, Verdict]:
    """Verdicts of which none is *usable*, for a reason that deviations do not know.

    They follow from the model that was fitted and from what was given, as if both were right.
    """
    found = {}
    for name, one in verdicts.items():
        level: Level = "rough guide" if one.level == "usable" else one.level
        found[name] = replace(one, level=level, cause=cause, remedy=remedy)
    return found


def levels(deviation: Materials) -> dict[str, Codes]:
    """For each pixel (H, W) the index in `LEVELS` that its own deviation alone would give its map.

    255 outside the mask.
    """
    found = {}
    for name, values in planes(deviation).items():
        limits = np.array([USABLE_MAX[name], ROUGH_MAX[name]])
        of_map = np.searchsorted(limits, values, side="left").astype(np.uint8)
        of_map[~np.isfinite(values)] = 255
        found[name] = of_map
    return found


def planes(deviations: Materials) -> dict[str, Floats]:
    """(H, W) by name, in the order of `PARAMETERS`: of albedo the RMS over channels."""
    albedo = np.sqrt(np.mean(np.square(deviations.albedo), axis=-1))
    return dict(zip(PARAMETERS, (albedo, deviations.roughness, deviations.metallic), strict=True))


def verdicts_of(summary: Any) -> dict[str, Verdict]:
    """From what `Uncertainty.summary` gave, or None; raises one of `json_files.UNFIT`."""
    if summary is None:
        return {}
    found = table(table(summary)["verdicts"])
    verdicts = {name: read_as(Verdict, found[name]) for name in PARAMETERS}
    for name, one in verdicts.items():
        deserves = level_of(name, one.expected_error)
        if LEVELS.index(one.level) < LEVELS.index(deserves):
            raise ValueError(f"{name} {one.level} in place of {deserves}")
    return verdicts


def in_short(name: str, verdict: Verdict) -> str:
    """What a map is good for, without the reasons: "albedo: usable, expected error ± 0.03"."""
    return f"{name}: {verdict.level}, expected error {verdict.error_in_words}"


def thresholds() -> str:
    """Up to which expected error a map is what, in words without a full stop."""
    usable, rough = (
        _by_map({name: f"{limits[name]:.2g}" for name in PARAMETERS})
        for limits in (USABLE_MAX, ROUGH_MAX)
    )
    return (
        f"a map is usable up to an expected error of {usable}, a rough guide up to {rough}, and "
        "above that not determined: a guess that knows only what materials there are is hardly "
        "worse"
    )


def _by_map(limits: Mapping[str, str]) -> str:
    if len(set(limits.values())) == 1:
        return limits[PARAMETERS[0]]
    return enumerated([f"{limit} ({name})" for name, limit in limits.items()], "or")


def enumerated(names: Sequence[str], last: str = "and") -> str:
    """Names with commas, and a word before the last."""
    *some, end = names
    return f"{', '.join(some)} {last} {end}" if some else end


def nothing_usable(verdicts: Mapping[str, Verdict]) -> bool:
    """Whether no map is usable, which `decompose --strict` refuses."""
    return all(one.level != "usable" for one in verdicts.values())
