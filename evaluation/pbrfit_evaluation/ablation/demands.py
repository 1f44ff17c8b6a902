"""What the default priors have to hold on rooms with noise, and whether they do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pbrfit_evaluation.ablation.cases import CaseName

Metric = Literal["recon", "albedo", "roughness", "metallic", "relight"]
METRICS: tuple[Metric, ...] = ("recon", "albedo", "roughness", "metallic", "relight")


@dataclass(frozen=True)
class Demand:
    """At most `limit` of the RMSE of `metric`; of its ratio to that without priors, if `relative`.

    `part`: (a) segments and prior are right, (b) materials vary inside segments, (c) segments are
    wrong, (d) what is hoped for: roughness much better, and nothing worse.
    """

    part: Literal["a", "b", "c", "d"]
    case: CaseName
    metric: Metric
    limit: float
    relative: bool = True


ROUGHNESS: dict[CaseName, float] = {
    "constant": 0.5,
    "varying": 0.8,
    "shifted": 0.5,
    "merged": 0.5,
    "none": 0.5,
}
"""Limit of the roughness in (d)."""

DEMANDS: tuple[Demand, ...] = (
    Demand("a", "constant", "roughness", 0.5),
    Demand("a", "constant", "metallic", 0.03, relative=False),
    Demand("a", "constant", "albedo", 1.0),
    *(Demand("b", "varying", metric, 1.25) for metric in METRICS),
    *(Demand("c", "shifted", metric, 1.25) for metric in METRICS),
    *(Demand("c", "merged", metric, 1.25) for metric in METRICS),
    *(
        Demand("d", case, metric, limit if metric == "roughness" else 1.0)
        for case, limit in ROUGHNESS.items()
        for metric in METRICS[1:]
    ),
)


@dataclass(frozen=True)
class Judged:
    """A demand, mean RMSE without priors and with them, and the value held against the limit.

    `rooms` has that value room by room.
    """

    demand: Demand
    without: float
    found: float
    value: float
    rooms: tuple[float, ...]

    @property
    def holds(self) -> bool:
        """In the mean."""
        return self.value <= self.demand.limit

    @property
    def holding(self) -> int:
        """Number of rooms in which it holds."""
        return sum(room <= self.demand.limit for room in self.rooms)


def judge(demand: Demand, without: Sequence[float], found: Sequence[float]) -> Judged:
    """Judge by the RMSE of each room, without priors and with them; at least one room.

    The ratio in the mean is that of the mean errors. A mean of ratios would be ruled by rooms whose
    error is small either way.
    """
    before, after = np.asarray(without, np.float64), np.asarray(found, np.float64)
    rooms = after / before if demand.relative else after
    mean = float(after.mean() / before.mean()) if demand.relative else float(after.mean())
    return Judged(demand, float(before.mean()), float(after.mean()), mean, tuple(map(float, rooms)))
