"""Normals of a sphere from its outline."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError

PART = 0.98
"""Share of the radius that is used: pixels further out are part sphere, part background, and their
normals turn by ten degrees and more within a pixel."""


def sphere_normals(
    disc: NDArray[np.bool_], name: str
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Normals of a sphere seen from far away, and the pixels that have one.

    Parameters
    ----------
    disc
        (H, W): where the sphere is seen.
    name
        Of the file, for the error.

    Returns
    -------
    (H, W, 3) and (H, W). The outermost 2 % of the radius are left out.

    Raises
    ------
    InputError
        If it is no disc.
    """
    rows, columns = (np.flatnonzero(disc.any(axis=axis)) for axis in (1, 0))
    found = "nothing"
    if rows.size:
        height, width = (float(np.ptp(at)) + 1 for at in (rows, columns))
        radius = (height + width) / 4
        fill = np.count_nonzero(disc) / (np.pi * radius**2)
        if abs(height - width) <= 0.02 * radius and abs(fill - 1) <= 0.02:
            y, x = np.indices(disc.shape, dtype=np.float64)
            right = (x - (columns[0] + columns[-1]) / 2) / radius
            up = ((rows[0] + rows[-1]) / 2 - y) / radius
            inside = right**2 + up**2 < PART**2
            towards = np.sqrt(np.where(inside, 1 - right**2 - up**2, 0.0))
            return np.stack([right, up, towards], axis=-1), inside & disc
        found = f"{width:.0f} × {height:.0f} pixels, of which {100 * fill:.0f} % of a disc are set"
    raise InputError(f"{name}: expected the disc of a sphere, found {found}")
