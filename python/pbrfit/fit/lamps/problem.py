"""Pixels under lamps: their samples, what lamps and ambient light make of a state, and its slopes.

The radiance of pixel p in picture i is

    I_pi = Σ_k in i  c_k s_pk V_pk R(n_p, v_p, ω_pk; m_p) + Σ_j w_j(n_p, v_p; m_p) L_ij,

with the colour c_k of a lamp, its strength s_pk there (1 of a far lamp, 1/d² of a near one), V_pk
whether it is seen, R = π f_r (n·ω)⁺ of the reflection model, and the weights w_j that the model
gives to ambient light L_i, spherical harmonics of a low order. Pictures are in units of one scale
that makes their mean radiance `MEAN_RADIANCE`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pbrfit import _core
from pbrfit.fit.noise import satisfied
from pbrfit.fit.sampling import slices
from pbrfit.fit.settings import MEAN_RADIANCE, PIXELS_AT_ONCE
from pbrfit.model.geometry import positions, views_at
from pbrfit.model.lamps import Lamps
from pbrfit.model.reflection import Model
from pbrfit.scene.scene import Scene
from pbrfit.threads import in_pieces
from pbrfit.values.arrays import Array, Codes, Mask


@dataclass(frozen=True, eq=False)
class LampPixels:
    """Samples of P pixels in N pictures, and what is known of these pixels."""

    samples: Array
    """(P, N, 3), in units of `scale`."""
    weights: Array
    """(P, N, 3): 0 = no data; else what the scene says."""
    limits: Codes
    """(P, N, 3), as `SceneArrays.limits`."""
    views: Array
    points: Array | None
    """(P, 3) each: unit vectors to the camera, and places; None without depth."""
    normals: Array
    """(P, 3): the given normals, or those that were found first; offsets are from these."""
    labels: NDArray[np.intp]
    """(P,): of groups whose roughness is much alike; 0 = unclassified."""
    places: NDArray[np.intp]
    """(P,): in the picture, row by row."""
    scale: float
    model: Model
    threads: int
    largest_weight: float = 1.0
    """Of the scene's samples, by which all are divided."""
    _kept: tuple[Lamps, Array, _core.LampSamples] | None = field(default=None, init=False)
    """What `under` made last, and the lights that it is of."""

    @classmethod
    def of(
        cls,
        scene: Scene,
        normals: Array,
        model: Model,
        threads: int,
        places: NDArray[np.intp],
        *,
        like: LampPixels | None = None,
    ) -> LampPixels:
        """Of pixels of a scene at places, with the normals (P, 3) that they have.

        Scale and largest weight are those of others of the same scene, where some are there.
        """
        count = len(scene.images)
        samples = np.empty((len(places), count, 3))
        weights = np.ones((len(places), count, 3))
        limits = np.zeros((len(places), count, 3), np.uint8)
        for i in range(count):
            samples[:, i] = scene.samples(i, places)
            if scene.weights is not None:
                weights[:, i] = scene.weights[i].reshape(-1, 3)[places]
            if scene.limits is not None:
                limits[:, i] = scene.limits[i].reshape(-1, 3)[places]
        if like is not None:
            scale, largest = like.scale, like.largest_weight
        else:
            scale = scene.mean_brightness() / MEAN_RADIANCE
            scale = scale if scale > 0 else 1.0
            largest = 1.0 if scene.weights is None else float(scene.weights.max())
        rows, columns = np.divmod(places, scene.width)
        labels = np.zeros(len(places), np.intp)
        if scene.label_map is not None:
            labels = scene.label_map.ravel()[places].astype(np.intp)
        points = None
        if scene.depth is not None:
            slab = slice(int(rows.min()), int(rows.max()) + 1)
            found = positions(scene.depth, scene.fov, slab)[rows - slab.start, columns]
            points = found if np.isfinite(found).all() else None
        return cls(
            samples / scale,
            weights / largest,
            limits,
            views_at((scene.height, scene.width), scene.fov, columns, rows),
            points,
            normals,
            labels,
            places,
            scale,
            model,
            threads,
            largest,
        )

    def __len__(self) -> int:
        return len(self.samples)

    @property
    def pictures(self) -> int:
        """N."""
        return int(self.samples.shape[1])

    def of_rows(self, rows: NDArray[np.intp] | slice) -> LampPixels:
        """Some of the pixels."""
        names = ("samples", "weights", "limits", "views", "normals", "labels", "places")
        of_rows = {name: getattr(self, name)[rows] for name in names}
        return replace(self, points=None if self.points is None else self.points[rows], **of_rows)

    @property
    def told(self) -> Mask:
        """(P, N, 3): values that are data and at no limit."""
        return np.asarray((self.weights > 0) & (self.limits == 0))

    def under(self, state: LampState) -> _core.LampSamples:
        """The samples in the core, under the lights of a state; the last ones are kept."""
        if self._kept and self._kept[0] is state.lamps and self._kept[1] is state.ambient:
            return self._kept[2]
        directions, strengths = state.incident(self)
        made = _core.LampSamples(
            self.samples,
            self.limits,
            self.views,
            directions,
            strengths[..., None] * state.lamps.colors,
            state.lamps.pictures.astype(np.uint64),
            np.ascontiguousarray(state.ambient[:, 0]),
            self.threads,
            self.model,
        )
        object.__setattr__(self, "_kept", (state.lamps, state.ambient, made))
        return made

    def residuals(self, radiance: Array) -> Array:
        """(P, N, 3): what a radiance is too much; 0 where a sample only bounds it, and is kept."""
        residual = radiance - self.samples
        none = satisfied(self.limits, residual) | (self.weights == 0)
        return np.where(none, 0.0, residual)


@dataclass(frozen=True, eq=False)
class LampState:
    """Lamps, ambient light and the surface of the pixels."""

    lamps: Lamps
    """With colours in units of the pictures' scale."""
    ambient: Array
    """(N, 16, 3), likewise."""
    normals: Array
    albedo: Array
    roughness: Array
    metallic: Array
    """(P, 3), (P, 3), (P,), (P,)."""

    def with_surface(
        self, normals: Array, albedo: Array, roughness: Array, metallic: Array
    ) -> LampState:
        """The same lights on another surface."""
        return replace(self, normals=normals, albedo=albedo, roughness=roughness, metallic=metallic)

    def of_rows(self, rows: NDArray[np.intp] | slice) -> LampState:
        """The same lights on some of the pixels."""
        return self.with_surface(*(values[rows] for values in surface_of(self)))

    def incident(self, pixels: LampPixels) -> tuple[Array, Array]:
        """Unit vectors to the lamps (P, K, 3), and what colours are multiplied by (P, K).

        Both are (1, ...) where all lamps are far, as these are alike of all pixels.
        """
        return self.lamps.at(pixels.points if self.lamps.near.any() else None)


def surface_of(state: LampState) -> tuple[Array, Array, Array, Array]:
    """In the order that the core takes it."""
    return state.normals, state.albedo, state.roughness, state.metallic


def radiance(pixels: LampPixels, state: LampState) -> Array:
    """(P, N, 3)."""
    directions, strengths = state.incident(pixels)
    directions = np.broadcast_to(directions, (len(pixels), *directions.shape[1:]))
    normals, albedo, roughness, metallic = surface_of(state)
    of_lamps = _core.lamp_radiance(
        normals, pixels.views, albedo, roughness, metallic, directions, pixels.threads, pixels.model
    )
    of_lamps *= strengths[..., None] * state.lamps.colors
    found = of_lamps
    if not np.array_equal(state.lamps.pictures, np.arange(pixels.pictures)):
        found = np.zeros(pixels.samples.shape)
        for k, picture in enumerate(state.lamps.pictures):
            found[:, picture] += of_lamps[:, k]
    if state.ambient.any():
        weights = _core.shade(normals, pixels.views, albedo, roughness, metallic, pixels.model)
        weights, used = weights.reshape(-1, 3, 16), np.flatnonzero(state.ambient.any(axis=(0, 2)))
        found += sum((weights[:, None, :, j] * state.ambient[:, j] for j in used), np.zeros(()))
    return found


def by_pieces(
    pixels: LampPixels, work: Callable[[LampPixels, slice], tuple[Array, ...]]
) -> tuple[Array, ...]:
    """What `work` makes of pixels that know nothing of each other, on all processors."""
    alone, at_once = replace(pixels, threads=1), max(PIXELS_AT_ONCE // pixels.pictures, 1)
    if len(pixels) <= at_once:
        return work(alone, slice(None))
    parts = in_pieces(
        pixels.threads, lambda rows: work(alone.of_rows(rows), rows), slices(len(pixels), at_once)
    )
    return tuple(np.concatenate(of) for of in zip(*parts, strict=True))


def tangents(normals: Array) -> Array:
    """(P, 2, 3): unit vectors that are perpendicular to a normal and to each other.

    As the core has them: the x and y axes under the smallest rotation that takes +z to the normal.
    """
    x, y, z = normals.T
    sign = np.where(z > -0.99, 1.0, -1.0)
    inverse = 1 / (1 + sign * z)
    across = -x * y * inverse
    first = np.stack([1 - x * x * inverse, across, -sign * x], axis=-1)
    second = np.stack([across, 1 - y * y * inverse, -sign * y], axis=-1)
    return np.stack([first, second], axis=1)


def by_place(pixels: LampPixels, lamps: Lamps, directions: Array) -> Array:
    """(P, K, 4): how directions and strengths change with the lamps' places.

    By how much a small change of place, across the direction, turns this, and the derivative of the
    strength's logarithm. The place of a far lamp is its direction.
    """
    found = np.zeros((*directions.shape[:2], 4))
    found[..., 0] = 1.0
    near = lamps.near
    if near.any():
        assert pixels.points is not None
        distance = np.linalg.norm(lamps.places[near] - pixels.points[:, None], axis=-1)[..., None]
        along = -np.einsum("pkx,kx->pk", directions[:, near], lamps.axes[near])[..., None]
        gathered = lamps.exponents[near, None] / np.maximum(along, np.finfo(np.float64).tiny)
        # d/dq of 1/d² (axis·(p−q)/d)^e, over itself.
        across = lamps.axes[near] + along * directions[:, near]
        by_strength = -2 * directions[:, near] - gathered * across
        found[:, near] = np.concatenate([np.ones_like(distance), by_strength], axis=-1) / distance
    return found
