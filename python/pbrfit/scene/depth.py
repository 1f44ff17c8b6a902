"""Depth of a scene: checked, compared with the normals, averaged down.

A depth map holds distances along the camera's axis. Its commonest fault is to hold their inverse,
disparity, as many networks give it. The normals tell: with n·P = c on a plane, ln z and ln 1/z have
opposite slopes, so a surface that is tilted from the pixel's ray by θ appears tilted by θ to the
other side, 2θ from where it is. Where depth or normals are themselves off by δ, the right reading
misses the normals by δ and the wrong one by about √(4θ² + δ²), twice as much as soon as θ > 0.87 δ.
The median over the pixels is taken, because jumps and noise make some normals of any map wrong.
"""

from __future__ import annotations

import logging
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io.resampling import at_centres, averaged
from pbrfit.model.depth_normals import DEPTH_MAX, from_depth
from pbrfit.model.geometry import angles_between, view_directions
from pbrfit.values.arrays import Array, Floats
from pbrfit.values.checks import any_array

log = logging.getLogger("pbrfit")

Depth = NDArray[np.float32]

AGREEMENT_MAX = 10.0
"""Median angle in degrees between the normals of the depth and the given ones up to which depth is
taken as it is: of errors of both, where surfaces face the camera too much to tell."""

INVERSE_RATIO_MAX = 0.5
"""Ratio of median angles of a map's inverse and itself, below which it is inverse depth; or of a
map of distances along the rays and one along the axis, below which it is the former."""

DISAGREEMENT_MIN = 45.0
"""Median angle in degrees from which on depth and normals are said to contradict each other."""

COMPARED_MAX = 1 << 16
"""Pixels that are compared: rows and columns are left out of larger maps."""

FAR_RATIO = 10.0
"""Ratio of a depth that several pixels have, to the bit, to the next smaller one of the map, from
which on it is a far plane: the direction to it is the same from everything nearer, to 1/10 rad."""

SAME_SURFACE = 0.1
"""Relative difference of inverse depth within which samples of a pixel that is averaged down are of
the surface under its centre; others lie beyond a jump."""


def checked_depth(
    given: Any, normals: Floats, fov: float, *, normals_known: bool = True
) -> tuple[Depth | None, list[str]]:
    """Depth as a scene keeps it, and what there is to say about it.

    Returns (H, W) float32, NaN where nothing was hit (`DEPTH_MAX`), and notes in words. Depth is
    not compared with normals (H, W, 3) that stand for unknown ones. Raises InputError if the map
    has another size or holds no distances.
    """
    if given is None:
        return None, []
    array = any_array("depth", given, normals.shape[:2])
    if array.dtype.kind not in "uif":
        raise InputError(f"depth: expected real numbers, found {array.dtype}")
    depth, notes = without_holes(array)
    if not normals_known:
        return depth, notes
    angle, of_inverse = compared(depth, normals, fov)
    if angle > AGREEMENT_MAX:
        height, width = depth.shape
        along = (depth * view_directions(height, width, fov)[..., 2]).astype(np.float32)
        if compared(along, normals, fov)[0] < INVERSE_RATIO_MAX * angle:
            notes.append("read as distances along the rays, as the normals show")
            return along, notes
    if of_inverse < INVERSE_RATIO_MAX * angle:
        raise InputError(
            "depth: expected distances, found inverse depth (normals of the map are "
            f"{angle:.0f} degrees from the given ones in the median, those of its inverse "
            f"{of_inverse:.0f})"
        )
    if angle > DISAGREEMENT_MIN:
        by = f"by {angle:.0f} degrees in the median"
        by += "; an orthographic view has to be 2 units wide" * (fov == 0)
        said = f"its normals and the given ones contradict each other, {by}"
        log.warning("depth: %s", said)
        notes.append(said)
    return depth, notes


def without_holes(depth: NDArray[Any], *, inverse: bool = False) -> tuple[Depth, list[str]]:
    """Depth with NaN where no distance is, and which other numbers stood there, in words.

    A far plane is none (`FAR_RATIO`), nor the largest half float, to which renderers clip; but
    numbers that are `inverse` have no far end. Raises InputError if no pixel has a distance.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # what float32 cannot hold is infinite then
        kept: Depth = depth.astype(np.float32)
        hit = (kept > 1 / DEPTH_MAX) & (kept < DEPTH_MAX)  # products of less are denormal: slow
    if not hit.any():
        found = f"none below {DEPTH_MAX:g}"
        if (numbers := kept[np.isfinite(kept)]).size:
            found += f" but {numbers.min():.3g} to {numbers.max():.3g}"
        raise InputError(f"depth: expected distances above 0, found {found}")
    notes = []
    if holes := int(np.count_nonzero(~hit & ~np.isnan(kept))):
        notes.append(f"{holes} pixels of 0, negative or infinite depth left out")
    top = kept[hit].max()
    at_top = hit & (kept == top)
    nearer = kept[hit & ~at_top].max(initial=0)
    far = np.count_nonzero(at_top) > 1 and top >= FAR_RATIO * nearer
    if nearer > 0 and not inverse and (far or top == np.finfo(np.float16).max):
        notes.append(f"{np.count_nonzero(at_top)} pixels of a far plane, {top:g}, left out")
        hit &= ~at_top
    kept[~hit] = np.nan
    return kept, notes


def in_words(depth: Depth) -> str:
    """Its range, median and share of unknown pixels."""
    numbers = (float(f"{one:.3g}") for one in np.nanpercentile(depth, [0, 100, 50]))
    said = "{:g} to {:g}, median {:g}".format(*numbers)
    unknown = 100 * np.isnan(depth).mean()
    return f"{said}; {unknown:.2g} % of the pixels unknown" if unknown else said


def compared(depth: Depth, normals: Floats, fov: float) -> tuple[float, float]:
    """Median angles in degrees between given normals (H, W, 3) and those of a depth map (H, W).

    Taken as it is, and as inverse depth; NaN = not comparable, or not looked at, as the first is up
    to `AGREEMENT_MAX`. Of larger maps `COMPARED_MAX` pixels are compared.
    """
    some = every_few(depth.shape, COMPARED_MAX)
    few, wanted = depth[some].astype(np.float64), normals[some]
    # A camera without perspective sees a width of 2 units (`geometry.positions`).
    width = 2.0 if fov == 0 else None

    def angle_in_any_unit(values: Array) -> float:
        if width is not None:  # only here its unit matters, and nobody told it
            found, known = from_depth(values, fov=fov, view_width=width)
            known &= np.isfinite(wanted[..., 0])
            steepness = _slope(found[known])
            if not steepness > 0:  # most of it faces the camera: no unit explains the normals
                return math.nan
            values = values * (_slope(wanted[known]) / steepness)
        return median_angle(values, wanted, fov, width)

    as_depth = median_angle(few, wanted, fov, width)
    if not as_depth > AGREEMENT_MAX or not angle_in_any_unit(few) > AGREEMENT_MAX:
        return as_depth, math.nan
    return as_depth, angle_in_any_unit(1.0 / few)


def median_angle(
    depth: Array, normals: Floats, fov: float, view_width: float | None = None
) -> float:
    """In degrees between normals of depth (H, W) and given ones (H, W, 3); NaN = none are known."""
    found, known = from_depth(depth, fov=fov, view_width=view_width)
    angles = angles_between(found, normals)[known]
    angles = angles[np.isfinite(angles)]
    return float(np.median(angles)) if angles.size else math.nan


def every_few(shape: tuple[int, ...], at_most: int) -> tuple[slice, slice]:
    """Every s-th row and column of (H, W), so that about `at_most` pixels remain."""
    step = math.ceil(math.sqrt(shape[0] * shape[1] / at_most))
    return slice(step // 2, None, step), slice(step // 2, None, step)


def _slope(normals: Floats) -> float:
    """Median tangent of the angle that normals (..., 3) make with the camera's axis."""
    x, y, z = np.moveaxis(normals, -1, 0)
    return float(np.nanmedian(np.hypot(x, y) / np.maximum(z, 1e-6)))


def reduced(depth: Floats, size: tuple[int, int]) -> Depth:
    """Depth (H, W) averaged down to (height, width), nowhere across a jump.

    Inverse depth is linear on a plane, so its mean over the area of a new pixel is that at the
    centre. The mean is of the samples within `SAME_SURFACE` of the one under the centre, of all
    where that is unknown. NaN where no part of a new pixel has depth.
    """
    inverse = 1.0 / depth
    under = (
        ((np.arange(f) + 0.5) * s / f).astype(int) for f, s in zip(depth.shape, size, strict=True)
    )
    centre = at_centres(inverse, size)[np.ix_(*under)]
    near = np.isfinite(inverse) & ~(np.abs(inverse - centre) > SAME_SURFACE * centre)
    total = averaged(np.where(near, inverse, 0.0), size)
    share = averaged(near.astype(np.float64), size)
    found = np.divide(share, total, out=np.full(size, np.nan), where=total > 0)
    return np.asarray(found, np.float32)
