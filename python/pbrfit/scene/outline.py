"""What the outline of an object says: normals there, and its rough shape.

Where a smooth surface turns away from the camera, at its outline, its normal is perpendicular to
the view and to the outline, and points outwards (Koenderink, "What does the occluding contour tell
us about solid shape?", Perception 13, 1984). Just inside, at a distance of d from the outline, the
normal of a ball of radius R has n·v = √(1 - (1 - d/R)²) and the same azimuth. R is not known; it is
taken to be like the radius of the largest disc in the mask that covers the place.

Where a mask ends at the picture's border, or at the edge of a table, nothing turns away. Of the
first nothing is used. The second is what the share of `CUT` allows for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter

from pbrfit.model.geometry import unit
from pbrfit.values.arrays import Array, Mask


@dataclass(frozen=True, eq=False)
class Outline:
    """Pixels just inside the outline."""

    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    """(E,) each: where they are."""
    normals: Array
    """(E, 3) of the ball there."""

    def __len__(self) -> int:
        return len(self.rows)


def outline(mask: Mask, views: Array) -> Outline:
    """Outline of a mask (H, W) seen along views (H, W, 3); of length 0 if it has none."""
    nowhere = np.zeros(0, np.intp)
    none = Outline(nowhere, nowhere, np.zeros((0, 3)))
    if mask.all() or not mask.any():
        return none
    distance = np.asarray(distance_transform_edt(mask)) - 0.5
    # Nearer pixels show part of the background, farther ones have turned towards the camera.
    rows, columns = np.nonzero(mask & (distance >= 1.5) & (distance <= 4.5))
    # Evens out the stairs of pixels.
    blurred = gaussian_filter(mask.astype(np.float64), 2.5, mode="nearest")
    down, right = np.gradient(blurred)
    slope = np.stack([-right, down], axis=-1)[rows, columns]
    length = np.linalg.norm(slope, axis=-1)
    clear = length > 0.02  # of a pixel's step; smaller where thin parts have two outlines
    rows, columns, slope = rows[clear], columns[clear], slope[clear] / length[clear, None]
    if len(rows) < 40:
        return none
    view = views[rows, columns]
    outward = np.concatenate([slope, np.zeros((len(rows), 1))], axis=1)
    outward = unit(outward - np.einsum("ei,ei->e", outward, view)[:, None] * view)
    radius = local_radius(distance)[rows, columns]
    across = 1 - np.clip(distance[rows, columns] / radius, 0.0, 1.0)[:, None]
    return Outline(rows, columns, across * outward + np.sqrt(1 - across**2) * view)


def local_radius(distance: Array) -> Array:
    """Radius of the largest disc inside the mask that covers each pixel, in pixels, (H, W).

    `distance` (H, W) is in pixels to the mask's outside; not above 0 there.
    """
    largest = float(distance.max())
    found = np.maximum(distance, 0.5)
    for radius in np.geomspace(max(2.0, largest / 64), max(largest, 2.0), 12):
        centres = distance >= min(radius, largest)
        if centres.any():
            covered = distance_transform_edt(~centres) <= radius
            found = np.where(covered, np.maximum(found, radius), found)
    return found


def rough_shape(mask: Mask, views: Array) -> Array:
    """Normals (H, W, 3) of the mask blown up as a balloon; of a plane if it has no outline.

    n·v is as in `Outline`, the azimuth away from the nearest middle.
    """
    if not len(outline(mask, views)):
        return np.array(views, np.float64)
    padded = np.pad(mask, 1, mode="edge")
    distance = np.asarray(distance_transform_edt(padded))[1:-1, 1:-1] - 0.5
    radius = local_radius(distance)
    scale = max(1.0, 0.15 * float(distance.max()))
    depth = gaussian_filter(distance, scale, mode="nearest")
    down, right = np.gradient(depth)
    share = np.clip(distance / radius, 0.0, 1.0)
    slope = unit(np.stack([-right, down], axis=-1), 1e-3)
    facing = np.sqrt(1 - (1 - share) ** 2)[..., None]
    normals = np.concatenate([slope * np.sqrt(1 - facing**2), facing], axis=-1)
    normals[..., :2] += views[..., :2]
    return unit(normals, 1e-12)
