"""Uncertainty: how far the maps of a result can be trusted, as data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, get_type_hints

import numpy as np
from numpy.typing import NDArray

from pbrfit.io.json_files import as_json, read_as
from pbrfit.model.materials import CHANNELS, Materials
from pbrfit.result.verdict import PARAMETERS, Verdict, verdicts_of

KINDS = ("", "low.", "high.")
"""Prefixes of the channels of deviations and of both quantiles."""

NUMBERS = ("noise", "effective_share", "albedo_scale")
"""Fields of `Uncertainty` that are in `result.json` as they are."""

TWO_SIDED = 1.96
"""Deviations of a normal distribution on each side that hold 0.95 of it."""


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """The posterior of each value: its deviation, an interval that holds it, and a verdict a map.

    It knows of noise, of how far pictures are from the model, of lights and of the scale between
    them and albedo, and of the priors on materials (docs/fit.md).
    """

    deviation: Materials
    """Standard deviations in place of values, at most 1; 0 if metallic is known; NaN elsewhere."""
    low: Materials
    high: Materials
    """Quantiles in place of values: the truth is between them with a probability of 0.95. Within
    [0, 1], and on both sides of the value found, or at it; NaN outside the mask."""
    noise: float | None
    """Standard deviation of a sample of the largest weight, in picture units, from the residual and
    its degrees of freedom; None where there are no more samples than unknowns."""
    effective_share: float
    """Share of the samples that would tell as much if what is left of them were independent."""
    albedo_scale: tuple[float, float, float]
    """Relative standard deviation, by channel, of the scale of the lights, which albedo undoes; 0
    where they are known. Deviations of albedo have it in them."""
    verdicts: Mapping[str, Verdict]
    """By name of the map."""

    def __repr__(self) -> str:
        """In a line: the verdicts, and no maps."""
        return f"Uncertainty({', '.join(f'{n} {one.level}' for n, one in self.verdicts.items())})"

    def summary(self) -> dict[str, Any]:
        """What is no map, and the maps in a few numbers, for result.json."""
        valid = np.isfinite(self.deviation.roughness)
        # In float32, as in files: a result that is read and written again stays the same.
        of_maps = {name: getattr(self.deviation, name).astype(np.float32) for name in PARAMETERS}
        return {
            **{name: getattr(self, name) for name in NUMBERS},
            "median_deviation": {n: float(np.median(of[valid])) for n, of in of_maps.items()},
            "verdicts": as_json(self.verdicts),
        }

    def layers(self) -> dict[str, NDArray[Any]]:
        """Maps (H, W) by channel name in `materials.exr`, in the order of `layer_names`."""
        maps = np.dstack([of.planes for of in (self.deviation, self.low, self.high)])
        return dict(zip(layer_names(), np.moveaxis(maps, -1, 0), strict=True))

    @classmethod
    def of(
        cls, layers: Mapping[str, NDArray[Any]], mask: NDArray[np.bool_], summary: Mapping[str, Any]
    ) -> Uncertainty:
        """From all that `layers` and `summary` gave, values outside the mask replaced by NaN.

        Raises one of `json_files.UNFIT` if they gave something else.
        """
        maps = np.stack([layers[name] for name in layer_names()], axis=-1).astype(np.float64)
        inside = np.where(mask[..., None], maps, np.nan)
        deviation, low, high = map(Materials.of_planes, np.split(inside, len(KINDS), axis=-1))
        if not ((maps[mask] >= 0) & (maps[mask] <= 1)).all():
            raise ValueError("deviations or bounds that are NaN or not from 0 to 1")
        return cls(
            deviation=deviation,
            low=low,
            high=high,
            **{name: read_as(get_type_hints(cls)[name], summary[name]) for name in NUMBERS},
            verdicts=verdicts_of(summary),
        )


def layer_names() -> list[str]:
    """Channels of `materials.exr` that hold an uncertainty."""
    return [f"uncertainty.{kind}{part}" for kind in KINDS for part in CHANNELS]
