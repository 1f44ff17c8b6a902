"""Normals of the surface that a depth map describes.

A map up to an unknown factor is enough, because scaling a scene about the camera turns no surface.
A map up to an unknown offset, as some estimators give it ("relative depth"), is not.
"""

from __future__ import annotations

import math
from typing import Literal, get_args

import numpy as np

from pbrfit._core import InputError
from pbrfit.model import geometry
from pbrfit.values.arrays import Array, Mask

FACING = np.array([0.0, 0.0, 1.0])
"""The normal of a surface that faces the viewer: of all pixels that have none."""

DepthKind = Literal["z", "ray", "disparity"]
"""What a number says: the distance along the optical axis; that along the pixel's own ray; or the
inverse of the former."""

DEPTH_MAX = 1e9
"""Depth, in any unit, from which on nothing was hit: Blender writes 1e10 there."""

FINITE_MAX = 1e100
"""Depth or disparity from which on, and below the inverse of which, nothing is said either: squares
overflow."""

EDGE_BEND_RATIO = 6.0
"""Second difference, in medians of the map, above which it is taken to lie across an edge. Of
Gaussian noise 6 medians are 4 standard deviations."""


def from_depth(
    depth: Array, *, fov: float, kind: DepthKind = "z", view_width: float | None = None
) -> tuple[Array, Mask]:
    """Unit normals of the surface that a depth map describes; they all face the camera.

    Pixel (i, j) looks along r = (x, y, -1) with x = (2i + 1 - W)/W t, y = (H - 1 - 2j)/W t and
    t = tan(fov/2), and sees the point P = z r. On a plane, n·P = c, the inverse depth

        u = 1/z = n·r / c = (n_x x + n_y y - n_z) / c

    is linear in i and j. So differences of u are exact on planes at any distance and tilt, which
    those of points are not. With p = W/(2t) pixels to a unit of x,

        g = (n_x, n_y)/c = (p ∂u/∂i, -p ∂u/∂j),     -n_z/c = u - g_x x - g_y y.

    A surface is seen from the side where n·P < 0, so c < 0, and n has the direction of -n/c:

        n ∝ (-g_x, -g_y, u - g_x x - g_y y).

    n·P = -1 before it is normalised, whatever g is: no normal faces away.

    An orthographic camera that sees a width of w sees (x w/2, y w/2, -z) with t = 1, a plane's z is
    linear itself, and n ∝ (∂z/∂X, ∂z/∂Y, 1) with W/w pixels to a unit of X. Raises InputError if
    `kind` is none, or an orthographic camera comes without `view_width` or with disparity.

    0, negative, infinite (or beyond 1e9) and NaN say that nothing was hit. `view_width` is what an
    orthographic camera sees from left to right, in units of the depth; it has no meaning for
    others. Returns normals, known: (H, W, 3) in camera space, and (H, W): where the depth told
    them.
    """
    geometry.check_fov(fov)
    if kind not in get_args(DepthKind):
        raise InputError(f"depth kind: expected {', '.join(get_args(DepthKind))}, found {kind!r}")
    height, width = depth.shape
    # Squares of inverses have to be finite too.
    hit = (depth > 1 / FINITE_MAX) & (depth < FINITE_MAX)
    if kind != "disparity":
        hit &= depth < DEPTH_MAX
    values = np.where(hit, depth, np.nan).astype(np.float64)
    if fov == 0:
        if kind == "disparity":
            raise InputError("disparity: expected a field of view above 0, found an orthographic")
        if view_width is None or not view_width > 0:
            raise InputError(
                "depth of an orthographic camera: expected the width of the view in units of the "
                f"depth (--view-width), found {view_width}"
            )
        pixels = width / view_width
        right, down = (_slopes(values, axis) for axis in (1, 0))
        components = [pixels * right, -pixels * down, np.ones_like(values)]
    else:
        views = geometry.view_directions(height, width, fov)
        if kind == "ray":
            values = values * views[..., 2]
        inverse = values if kind == "disparity" else 1.0 / values
        x, y = (-views[..., i] / views[..., 2] for i in (0, 1))
        pixels = width / (2 * math.tan(math.radians(fov) / 2))
        g_x, g_y = pixels * _slopes(inverse, 1), -pixels * _slopes(inverse, 0)
        components = [-g_x, -g_y, inverse - g_x * x - g_y * y]
    normals = np.stack(components, axis=-1)
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    known = np.isfinite(length[..., 0])
    with np.errstate(invalid="ignore"):
        return np.where(known[..., None], normals / length, FACING), known


def _slopes(values: Array, axis: int) -> Array:
    """Derivatives by pixels along an axis, from one side where an edge is near.

    A parabola through three neighbours has the slope of a smooth surface but for the third
    derivative, wherever in the three the pixel is: in the middle, (r - l)/2, or at an end,
    ±(3 v - 4 v₁ + v₂)/2. The middle is the quietest, variance 1/2 of that of a value against 13/2
    at the ends, so it is taken unless its second difference is suspicious: more than
    `EDGE_BEND_RATIO` medians. Then the one of the three with the smallest second difference is
    taken. A parabola that bends more than the smaller step to a neighbour is none of this surface:
    then that step is the slope. NaN where no neighbour is known.
    """
    v = np.moveaxis(values, axis, -1)
    padded = np.pad(v, [(0, 0)] * (v.ndim - 1) + [(2, 2)], constant_values=np.nan)
    count = v.shape[-1]
    left2, left, right, right2 = (padded[..., k : k + count] for k in (0, 1, 3, 4))
    bends = np.stack([left2 - 2 * left + v, left - 2 * v + right, v - 2 * right + right2])
    slopes = np.stack(
        [(3 * v - 4 * left + left2) / 2, (right - left) / 2, (4 * right - 3 * v - right2) / 2]
    )
    steps = np.stack([v - left, right - v])
    size = np.where(np.isnan(bends), np.inf, np.abs(bends))
    finite = size[1][np.isfinite(size[1])]
    allowed = EDGE_BEND_RATIO * float(np.median(finite)) if finite.size else 0.0
    best = np.where(size[1] <= allowed, 1, np.argmin(size, axis=0))[None]
    bend = np.take_along_axis(size, best, axis=0)[0]
    slope = np.take_along_axis(slopes, best, axis=0)[0]
    step_size = np.where(np.isnan(steps), np.inf, np.abs(steps))
    nearer = np.argmin(step_size, axis=0)[None]
    step = np.take_along_axis(steps, nearer, axis=0)[0]
    smallest = np.take_along_axis(step_size, nearer, axis=0)[0]
    by_step = (bend > allowed) & (bend > smallest)
    return np.moveaxis(np.where(by_step, step, slope), -1, axis)
