"""Maps averaged down."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.values.arrays import Array, Mask

if TYPE_CHECKING:
    from scipy.sparse import csr_array


def reduced_size(shape: tuple[int, ...], side: int) -> tuple[int, int]:
    """(height, width) with a longer side of at most `side` pixels, in the same proportion."""
    height, width = shape[:2]
    longer = max(height, width)
    side = min(side, longer)
    return max(1, round(height * side / longer)), max(1, round(width * side / longer))


def averaged(plane: NDArray[Any], size: tuple[int, int]) -> Array:
    """Average of a plane (H, W) over the area that falls on each pixel of (height, width).

    Parts of old pixels count by their size. NaN and infinity stay in what they have a part in.
    """
    down, across = (area_shares(old, new) for old, new in zip(plane.shape, size, strict=True))
    return np.asarray((across @ (down @ plane.astype(np.float64)).T).T)


def at_centres(ids: NDArray[Any], size: tuple[int, int]) -> NDArray[Any]:
    """What lies under the centre of each pixel of (height, width): for ids, which have no mean."""
    rows, columns = (
        np.minimum((np.arange(s) + 0.5) * f / s, f - 1).astype(int)
        for s, f in zip(size, ids.shape, strict=True)
    )
    return ids[np.ix_(rows, columns)]


def averaged_channels(image: NDArray[Any], size: tuple[int, int]) -> Array:
    """Each channel of an image (H, W, C) `averaged`, (height, width, C)."""
    return np.stack([averaged(image[..., c], size) for c in range(image.shape[-1])], axis=-1)


def averaged_where(image: NDArray[Any], used: Mask, size: tuple[int, int]) -> tuple[Array, Array]:
    """Means (height, width, ...) over what is `used` of (H, W, ...), 0 without; its shares."""
    planes = np.where(used[..., None], image.reshape(*used.shape, -1), 0)
    total, share = averaged_channels(planes, size), averaged(used, size)
    np.divide(total, share[..., None], out=total, where=share[..., None] > 0)
    return total.reshape(*size, *image.shape[2:]), share


def area_shares(old: int, new: int) -> csr_array[np.float64]:
    """(new, old): which share of a new pixel each old one has, along one side."""
    from scipy.sparse import csr_array

    # Borders of both in units of 1/(old · new) of the side: whole numbers, no rounding.
    borders = np.union1d(np.arange(new + 1) * old, np.arange(old + 1) * new)
    pieces = borders[:-1]
    shares = np.diff(borders) / old
    return csr_array((shares, (pieces // old, pieces // new)), shape=(new, old))
