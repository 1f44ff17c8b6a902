"""The calibration as rows, verdicts and a table."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from pbrfit_evaluation.suite import Column, Results, Row, Section, Table, Verdict
from pbrfit_evaluation.uncertainty.measure import LIGHTS, Array, Lights, Task

WITHIN = 0.2
"""A ratio of found to predicted deviation this near to 1 counts as right."""

BARS: dict[Lights, tuple[float, float, float]] = {"known": (0.9, 1.1, 0.9), "free": (0.8, 1.25, 0)}
"""Least and largest median of the ratios, least share of them within `WITHIN` of 1."""

PARAMETERS = {"albedo": slice(0, 3), "roughness": slice(3, 4), "metallic": slice(4, 5)}

COLUMNS: tuple[Column | str, ...] = (
    *(Column("draws", "refits"), Column("compared", "share of\npixels"), "converged", "median"),
    *(Column("within", "within 20 %"), *(Column(f"median_{name}", name) for name in PARAMETERS)),
    *(Column("median_by_fit", "by a fit"), Column("within_by_fit", "within 20 %"), "variance"),
    *(Column("median_bias", "bias"), Column("albedo_scale", "scale")),
)


def _groups(results: Results[Task]) -> Iterator[tuple[str, Lights, Results[Task]]]:
    """Scenes with the same lights (known or free) and noise, together."""
    levels = sorted(
        {(task.lights, task.noise) for task, _ in results.finished},
        key=lambda level: (LIGHTS.index(level[0]), level[1]),
    )
    for lights, noise in levels:
        title = f"lights {lights}, noise {noise:g}"
        yield title, lights, results.of(lights=lights, noise=noise)


def _ratios(of: Results[Task], above: str = "found", below: str = "predicted") -> Array:
    """(Q, 5) of all scenes together."""

    def columns(values: Any) -> Array:
        return np.array(values, np.float64).reshape(-1, 5)

    with np.errstate(divide="ignore"):  # a fit may have ended on a bound, and predict 0
        return np.concatenate([columns(v[above]) / columns(v[below]) for _, v in of.finished])


def _median(values: Array) -> float:
    return float(np.median(values)) if values.size else math.nan


def _share_within(ratios: Array) -> float:
    return float(np.mean(np.abs(ratios - 1) <= WITHIN)) if ratios.size else math.nan


def figures(results: Results[Task]) -> list[Row]:
    """A row for each kind of lights and level of noise."""
    rows = []
    for title, lights, of in _groups(results):
        ratios, by_fit = _ratios(of), _ratios(of, below="predicted_by_fit")
        least, largest, share = BARS[lights]
        metrics = {
            "draws": of.finished[0][0].draws,
            "values": ratios.size,
            "median": _median(ratios),
            "within": _share_within(ratios),
            **{f"median_{name}": _median(ratios[:, at]) for name, at in PARAMETERS.items()},
            "median_by_fit": _median(by_fit),
            "within_by_fit": _share_within(by_fit),
            "median_bias": _median(np.abs(_ratios(of, "bias"))),
            **{name: of.mean(name).mean for name in ("variance", "compared", "converged")},
            "albedo_scale": max(of.numbers("albedo_scale")),
            "least_median": least,
            "largest_median": largest,
            "least_within": share,
        }
        held = all(verdict.holds for verdict in _judged(title, metrics))
        status = "ok" if held else "not held"
        rows.append(Row(title, len(of.finished), None, metrics, status=status))
    return rows


def verdicts(_: Results[Task], rows: Sequence[Row]) -> list[Verdict]:
    """What the ratios have to be; without any, nothing holds."""
    return [verdict for row in rows for verdict in _judged(row.name, row.metrics)]


def _judged(name: str, metrics: Mapping[str, Any]) -> Iterator[Verdict]:
    median, share = metrics["median"], metrics["least_within"]
    yield Verdict(f"{name}: median", median, metrics["least_median"], at_least=True)
    yield Verdict(f"{name}: median", median, metrics["largest_median"])
    if share:
        what = f"{name}: share within 20 % of 1"
        yield Verdict(what, metrics["within"], share, at_least=True)


def sections(_: Results[Task], rows: Sequence[Row]) -> list[Section]:
    """The table."""
    text = (
        "Predicted is the formula at the true materials, lights and noise. By a fit: what is "
        "predicted from one noisy set of pictures and its fit, which know neither; no bar. "
        "Variance: of the residual over its degrees of freedom, by the true one. Bias: median of "
        "the mean error, in predicted deviations. Scale: largest predicted relative deviation of "
        "the scale between albedo and light."
    )
    return [Section("Found by predicted", text, [Table.of(rows, COLUMNS)])]
