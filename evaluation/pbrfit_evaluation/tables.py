"""Means with intervals, and CSV files."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

CONFIDENCE = 0.95
RESAMPLES = 2000


@dataclass(frozen=True)
class Mean:
    """Mean over `count` scenes and its bootstrap interval.

    `low` and `high` are NaN for a single scene, all three without any.
    """

    mean: float
    low: float
    high: float
    count: int


def mean_with_interval(values: Iterable[float]) -> Mean:
    """Mean of the numbers that are finite, with a percentile bootstrap interval of 95 %.

    Scenes are drawn again with replacement, 2000 times from a fixed seed (Efron 1979), so the
    interval says how far the mean depends on which scenes happened to be in the set.
    """
    from scipy.stats import bootstrap

    finite = np.array([value for value in values if math.isfinite(value)], dtype=np.float64)
    if not finite.size:
        return Mean(math.nan, math.nan, math.nan, 0)
    mean = float(finite.mean())
    if finite.size == 1:
        return Mean(mean, math.nan, math.nan, 1)
    found = bootstrap(
        (finite,),
        np.mean,
        n_resamples=RESAMPLES,
        confidence_level=CONFIDENCE,
        method="percentile",
        rng=np.random.default_rng(0),
    )
    interval = found.confidence_interval
    return Mean(mean, float(interval.low), float(interval.high), finite.size)


def write_csv(path: Path, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write CSV with a header line; numbers in full precision, None and NaN as empty cells."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for row in rows:
            writer.writerow([_text(cell) for cell in row])


def _text(cell: object) -> str:
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return ""
    return repr(float(cell)) if isinstance(cell, float) else str(cell)
