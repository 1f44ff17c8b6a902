"""Lamps of named pictures, to and from the rows of files."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pbrfit.io.lamp_files import LampRow, Vector
from pbrfit.model.lamps import Lamps


def lamps_of_rows(rows: Sequence[LampRow], pictures: Sequence[int]) -> Lamps:
    """Lamps of rows, each with the index of its picture, in any order."""
    order = np.argsort(np.array(pictures, np.intp), kind="stable")
    sorted_rows = [rows[i] for i in order]
    return Lamps(
        np.array(pictures, np.intp)[order],
        _vectors([row.place for row in sorted_rows]),
        np.array([row.near for row in sorted_rows], bool),
        _vectors([row.color for row in sorted_rows]),
        _vectors([row.axis for row in sorted_rows]),
        np.array([row.exponent for row in sorted_rows], np.float64),
    )


def rows_of_lamps(lamps: Lamps, names: Sequence[str]) -> list[LampRow]:
    """Rows of lamps of pictures with these names; axes only where light is gathered about them."""
    return [
        LampRow(
            names[lamps.pictures[i]],
            _vector(lamps.places[i]),
            bool(lamps.near[i]),
            _vector(lamps.colors[i]),
            _vector(lamps.axes[i]) if lamps.exponents[i] > 0 else LampRow.axis,
            float(lamps.exponents[i]),
        )
        for i in range(len(lamps))
    ]


def _vectors(rows: Sequence[Vector]) -> NDArray[np.float64]:
    return np.array(rows, np.float64).reshape(-1, 3)


def _vector(row: NDArray[np.float64]) -> Vector:
    x, y, z = row.tolist()
    return x, y, z
