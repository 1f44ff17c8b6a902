"""Band weights and their slopes against exact values."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.random import Generator

from pbrfit.model.reflection import ggx_band_weights
from pbrfit.report import notation
from pbrfit.report.notation import scientific
from pbrfit_evaluation.jobs import Values
from pbrfit_evaluation.stability.exact_bands import exact_bands, paper_rule
from pbrfit_evaluation.stability.measure import BRANCH, Array, Effort, Figure

RULES = {
    "pbrfit": "",
    "paper's rule, float64": "paper_float64_",
    "paper's rule, float32": "paper_float32_",
}
"""Rules that are compared, and how keys of their figures begin."""

BINS = 120
"""Of each curve, which has the largest error in each."""


def measure(effort: Effort, _: Generator, __: int) -> Values:
    """h_l(r) and dh_l/dr over [0, 1] against 150-digit arithmetic, by three rules."""
    exact = exact_bands(_roughness_grid(effort.band_points))
    r = exact.r
    found = (ggx_band_weights(r), paper_rule(r, np.float64), paper_rule(r, np.float32))
    figures: dict[str, Figure] = {}
    curves: dict[str, Any] = {"value": {}, "slope": {}}
    for (rule, short), (h, dh) in zip(RULES.items(), found, strict=True):
        errors = {
            "value": np.abs(exact.weight_errors(h)),
            "slope": np.abs(exact.slope_errors(dh)),
        }
        for key, of in errors.items():
            nan = np.inf if rule == "pbrfit" else -1.0  # of the others only what is a number
            worst, where = _worst_band(r, np.where(np.isnan(of), nan, of))
            failed = r[np.isnan(of).any(axis=-1)]
            if failed.size:
                where += f"; no number up to r = {scientific(failed.max())}"
            figures[f"{short}{key}_error"] = worst, where
            curves[key][rule] = _curves(r, of.max(axis=-1))
    # Near r = 0 slopes fall like r³, so that an absolute bound says nothing.
    below = (r < BRANCH) & (np.abs(exact.slope).min(axis=-1) > 1e-300)
    relative = np.abs(exact.slope_errors(found[0][1])[below] / exact.slope[below])
    figures["slope_relative_error"] = _worst_band(r[below], relative)
    return {"figures": figures, "curves": curves}


def _roughness_grid(count: int) -> Array:
    """All of [0, 1], denser towards 0, 0.4, 1 and the paper's switch."""
    part = count // 5
    steps = np.arange(-16, 17)
    near = 10.0 ** np.linspace(-17, -2, part // 2)
    switch = (1 - 1e-3) ** 0.25
    parts = [
        np.linspace(0, 1, 2 * part),
        10.0 ** np.linspace(-12, -1, part),
        10.0 ** np.linspace(-90, -12, part // 2),
        10.0 ** np.linspace(-323, -90, part // 8),
        [0, 5e-324, 2.2250738585072014e-308, 1e-300, 1e-81, 1e-80, 1.0],
        BRANCH + near,
        BRANCH - near,
        BRANCH + np.spacing(BRANCH) * steps,
        1 - 10.0 ** np.linspace(-17, -1, part),
        1 - np.spacing(0.5) * np.abs(steps),
        switch + 0.1 * near,
        switch - 0.1 * near,
    ]
    return np.unique(np.clip(np.concatenate(parts), 0, 1))


def _worst_band(r: Array, errors: Array) -> Figure:
    point, band = np.unravel_index(np.argmax(errors), errors.shape)
    return float(errors[point, band]), f"{notation.band(int(band))} at r = {r[point]:.6g}"


def _curves(r: Array, errors: Array) -> dict[str, Any]:
    """Towards r = 0, over all of [0, 1], and by 1 − r."""
    zero, one = (r >= 1e-90) & (r <= 0.1), (r < 1) & (r > 0.9)
    return {
        "zero": _envelope(r[zero], errors[zero], log=True),
        "all": _envelope(r, errors, log=False),
        "one": _envelope(1 - r[one], errors[one], log=True),
    }


def _envelope(x: Array, errors: Array, *, log: bool) -> dict[str, list[Any]]:
    """Bins of x, the largest error in each, and whether a value there is no number."""
    position = np.log10(x) if log else x
    edges = np.linspace(position.min(), position.max(), BINS + 1)
    bins = np.clip(np.searchsorted(edges, position, side="right") - 1, 0, BINS - 1)
    worst, failed = np.full(BINS, np.nan), np.zeros(BINS, dtype=bool)
    for i in np.unique(bins):
        inside = errors[bins == i]
        finite = inside[np.isfinite(inside)]
        failed[i] = finite.size < inside.size
        if finite.size:
            worst[i] = finite.max()
    middle = (edges[1:] + edges[:-1]) / 2
    at = 10.0**middle if log else middle
    return {"x": at.tolist(), "error": worst.tolist(), "failed": failed.tolist()}
