"""Rays through pixels, found from the points that the pixels show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError

Array = NDArray[np.float64]

FEWEST_POINTS = 3
"""Points a picture needs at least before rays can be told from them."""


@dataclass(frozen=True)
class Rays:
    """The ray of any place of a picture: origin + t direction, t > 0.

    Attributes
    ----------
    columns, rows
        Slope and intercept: −x/z of column j, or x if orthographic, is slope·j + intercept, and the
        same of −y/z with rows.
    orthographic
        Whether all rays are parallel.
    """

    columns: tuple[float, float]
    rows: tuple[float, float]
    orthographic: bool

    def at(self, rows: Array, columns: Array) -> tuple[Array, Array]:
        """Origins and unit directions, both (..., 3), of places (...) that may lie between pixels."""
        x = self.columns[0] * np.asarray(columns) + self.columns[1]
        y = self.rows[0] * np.asarray(rows) + self.rows[1]
        x, y = np.broadcast_arrays(x, y)
        flat = np.stack([x, y, np.zeros_like(x)], axis=-1)
        backwards = np.broadcast_to([0.0, 0.0, -1.0], flat.shape)
        if self.orthographic:
            return flat, np.array(backwards)
        directions = flat + backwards
        return np.zeros_like(flat), directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def rays_of(points: Array) -> Rays:
    """Find the camera whose pixels show these points.

    Parameters
    ----------
    points
        (H, W, 3), camera space, as `pbrfit.model.geometry.positions` gives them; NaN where there is
        none.

    Raises
    ------
    InputError
        If there are fewer than three points, or they lie on one row or column, or behind the camera.
    """
    rows, columns = np.nonzero(np.isfinite(points).all(axis=-1))
    if len(rows) < FEWEST_POINTS or np.ptp(rows) == 0 or np.ptp(columns) == 0:
        raise InputError(f"points: expected at least three, not in one line, found {len(rows)}")
    x, y, z = points[rows, columns].T
    if (z >= 0).any():
        raise InputError("points: expected z < 0, before the camera, found some behind it")
    (across, misfit), (parallel, parallel_misfit) = _line(columns, -x / z), _line(columns, x)
    orthographic = bool(parallel_misfit < 0.1 * misfit)
    return Rays(
        columns=parallel if orthographic else across,
        rows=_line(rows, y if orthographic else -y / z)[0],
        orthographic=orthographic,
    )


def _line(index: NDArray[np.intp], values: Array) -> tuple[tuple[float, float], float]:
    """Slope and intercept of values over an index, and the root mean square misfit over the spread."""
    middle, mean = index.mean(), values.mean()
    slope = float(((index - middle) * (values - mean)).sum() / ((index - middle) ** 2).sum())
    misfit = float(np.std(values - slope * index) / max(float(np.std(values)), 1e-300))
    return (slope, float(mean - slope * middle)), misfit
