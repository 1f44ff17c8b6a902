"""Cones and parts of cones: lamp shades, pots and cups of furnished rooms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pbrfit.synthetic.geometry import Array, Primitive, slabs


@dataclass(frozen=True, kw_only=True)
class Frustum(Primitive):
    """A capped, upright cone or part of one along the object's y axis.

    Its radius is `bottom` at y = -half and `top` at y = +half; one of them may be 0.
    """

    bottom: float
    top: float
    half: float

    def enter(self, origin: Array, directions: Array) -> tuple[Array, Array]:
        """Find where rays enter the frustum; see `Primitive.enter`."""
        # The radius at height y is m + s y. Within the infinite double cone
        #     x² + z² <= (m + s y)²   =>   a t² + 2 b t + c <= 0   along the ray o + t d.
        # For a > 0 that is an interval, of one nappe. For a < 0 the ray is steeper than the sides:
        # it leaves one nappe at the first root and enters the other at the second, so it has the
        # nappe that widens upwards (s > 0) ahead of it when it rises, else behind it. The caps
        # cut off the nappe that is no part of the solid, where m + s y < 0.
        slope = (self.top - self.bottom) / (2 * self.half)
        across, start = directions[:, ::2], origin[::2]
        rise = slope * directions[:, 1]
        radius = (self.top + self.bottom) / 2 + slope * origin[1]
        a = np.einsum("pi,pi->p", across, across) - rise**2
        a = np.where(np.abs(a) < 1e-300, 1e-300, a)
        b = across @ start - rise * radius
        c = start @ start - radius**2
        cap_near, cap_far = slabs(origin[1:2], directions[:, 1:2], np.array([self.half]))
        with np.errstate(invalid="ignore", divide="ignore"):
            # Both roots without cancellation; NaN, a miss, where there are none.
            q = -(b + np.copysign(np.sqrt(b * b - a * c), b))
            first, last = np.minimum(q / a, c / q), np.maximum(q / a, c / q)
            side = np.where(a > 0, first, np.where(rise > 0, last, -np.inf))
            leave = np.where(a > 0, last, np.where(rise > 0, np.inf, first))
            distance = np.maximum(side, cap_near[:, 0])
            hit = (distance < np.minimum(leave, cap_far[:, 0])) & (distance > 0.0)
            round_side = side >= cap_near[:, 0]
        # The side's normal is the gradient of sqrt(x² + z²) - (m + s y).
        normals = np.empty_like(directions)
        normals[:, ::2] = start + np.where(round_side, distance, 0.0)[:, None] * across
        normals[:, ::2] /= np.maximum(
            np.linalg.norm(normals[:, ::2], axis=-1, keepdims=True), 1e-300
        )
        normals[:, 1] = -slope
        normals /= np.sqrt(1 + slope**2)
        caps = np.stack([0 * a, -np.sign(directions[:, 1]), 0 * a], axis=-1)
        return np.where(hit, distance, np.inf), np.where(round_side[:, None], normals, caps)
