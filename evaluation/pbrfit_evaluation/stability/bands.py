"""Band weights and their slopes against exact values."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from pbrfit.model.reflection import ggx_band_weights
from pbrfit.report import notation
from pbrfit_evaluation.jobs import Values
from pbrfit_evaluation.stability.exact_bands import errors_of, exact_bands
from pbrfit_evaluation.stability.measure import Array, Figure

BRANCH = 0.4
"""Roughness at which band weights change from the closed form to series."""


def measure(_: Generator, __: int, points: int) -> Values:
    """h_l(r) and dh_l/dr over [0, 1] against 150-digit arithmetic."""
    exact = exact_bands(_roughness_grid(points))
    r = exact.r
    h, dh = ggx_band_weights(r)
    of_h, of_dh = errors_of(h, exact.weight), errors_of(dh, exact.slope)
    # Near r = 0 slopes fall like r³, so that an absolute bound says nothing.
    slope = exact.slope.astype(np.float64)
    below = (r < BRANCH) & (np.abs(slope).min(axis=-1) > 1e-300)
    figures: dict[str, Figure] = {
        "value_error": _worst_band(r, of_h),
        "slope_error": _worst_band(r, of_dh),
        "slope_relative_error": _worst_band(r[below], of_dh[below] / slope[below]),
    }
    return {"figures": figures}


def _roughness_grid(count: int) -> Array:
    """All of [0, 1], denser towards 0, 0.4, 1 and the paper's switch."""
    part = count // 5
    steps = np.arange(-16, 17)
    near = 10.0 ** np.linspace(-17, -2, part // 2)
    switch = (1 - 1e-3) ** 0.25  # where the paper's rule turns to a series
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
    point, band = np.unravel_index(np.argmax(np.abs(errors)), errors.shape)  # NaN is the largest
    where = f"{notation.band(int(band))} at r = {r[point]:.6g}"
    return float(np.abs(errors[point, band])), where
