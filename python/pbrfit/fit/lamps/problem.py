"""Pixels under lamps: their samples, what lamps and ambient light make of a state, and its slopes.

The radiance of pixel p in picture i is

    I_pi = Σ_k in i  c_k s_pk V_pk R(n_p, v_p, ω_pk; m_p) + Σ_j w_j(n_p, v_p; m_p) L_ij,

with the colour c_k of a lamp, its strength s_pk there (1 of a far lamp, 1/d² of a near one), V_pk
whether it is seen, R = π f_r (n·ω)⁺ of the reflection model, and the weights w_j that the model
gives to ambient light L_i, spherical harmonics of a low order. Pictures are in units of one scale
that makes their mean radiance `MEAN_RADIANCE`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pbrfit import _core
from pbrfit.fit.settings import MEAN_RADIANCE
from pbrfit.io.limits import AT_LEAST, AT_MOST
from pbrfit.model.geometry import positions, views_at
from pbrfit.model.lamps import Lamps
from pbrfit.model.reflection import Model
from pbrfit.scene.scene import Scene

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LampPixels:
    """Samples of P pixels in N pictures, and what is known of these pixels."""

    samples: Array
    """(P, N, 3), in units of `scale`."""
    weights: Array
    """(P, N, 3): 0 = no data; else what the scene says."""
    limits: NDArray[np.uint8]
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

    @classmethod
    def of(
        cls,
        scene: Scene,
        normals: Array,
        model: Model,
        threads: int,
        places: NDArray[np.intp] | None = None,
        *,
        like: LampPixels | None = None,
    ) -> LampPixels:
        """Of the valid pixels of a scene, or some of them; `normals` (H, W, 3).

        Scale and largest weight are those of others of the same scene, where some are there.
        """
        valid = scene.places
        places = valid if places is None else places
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
        flat = np.zeros(scene.valid.size, np.intp)
        if scene.labels is not None:
            flat[valid] = scene.labels[0]
        points = None
        if scene.depth is not None:
            found = positions(scene.depth, scene.fov).reshape(-1, 3)[places].astype(np.float64)
            points = found if np.isfinite(found).all() else None
        return cls(
            samples / scale,
            weights / largest,
            limits,
            views_at((scene.height, scene.width), scene.fov, columns, rows),
            points,
            np.asarray(normals, np.float64).reshape(-1, 3)[places],
            flat[places],
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
    def told(self) -> NDArray[np.bool_]:
        """(P, N, 3): values that are data and at no limit."""
        return np.asarray((self.weights > 0) & (self.limits == 0))

    def residuals(self, radiance: Array) -> Array:
        """(P, N, 3): what a radiance is too much; 0 where a sample only bounds it, and is kept."""
        residual = radiance - self.samples
        kept = ((self.limits == AT_LEAST) & (residual > 0)) | (
            (self.limits == AT_MOST) & (residual < 0)
        )
        return np.where(kept | (self.weights == 0), 0.0, residual)


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
        """Unit vectors to the lamps (P, K, 3), and what colours are multiplied by (P, K)."""
        return self.lamps.at(pixels.points, len(pixels))


def surface_of(state: LampState) -> tuple[Array, Array, Array, Array]:
    """In the order that the core takes it."""
    return state.normals, state.albedo, state.roughness, state.metallic


def radiance(pixels: LampPixels, state: LampState) -> Array:
    """(P, N, 3)."""
    directions, strengths = state.incident(pixels)
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
        found += _ambient(weights.reshape(-1, 3, 16), state)
    return found


def _ambient(weights: Array, state: LampState) -> Array:
    """(P, N, 3): what ambient light brings, by the weights (P, 3, 16)."""
    used = np.flatnonzero(state.ambient.any(axis=(0, 2)))
    return sum((weights[:, None, :, j] * state.ambient[:, j] for j in used), np.zeros(()))


@dataclass(frozen=True, eq=False)
class Slopes:
    """Radiance of pixels and its derivatives."""

    radiance: Array
    """(P, N, 3)."""
    by_surface: Array
    """(P, N, 3, 7): by two offsets of the normal, the albedo's channels, roughness, metallic."""
    by_place: Array
    """(P, K, 3, 3): by the place of each lamp, channel before axis; of far lamps by a vector in the
    plane that is perpendicular to the direction."""
    by_color: Array
    """(P, K, 3): of each channel, by that channel of the colour."""
    by_ambient: Array
    """(P, 3, 16): by ambient light, of any picture."""


def tangents(normals: Array) -> Array:
    """(P, 2, 3): unit vectors that are perpendicular to a normal and to each other.

    Those of T. Duff et al., "Building an orthonormal basis, revisited", JCGT 6, 2017.
    """
    x, y, z = normals.T
    sign = np.where(z >= 0, 1.0, -1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    first = np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=-1)
    second = np.stack([b, sign + y * y * a, -y], axis=-1)
    return np.stack([first, second], axis=1)


def slopes(pixels: LampPixels, state: LampState) -> Slopes:
    """At a state."""
    lamps = state.lamps
    directions, strengths = state.incident(pixels)
    normals, albedo, roughness, metallic = surface_of(state)
    args = pixels.views, albedo, roughness, metallic
    # Pixels last: planes (K, 3, P), which numpy goes through fast.
    of_core = _core.lamp_slopes(normals, *args, directions, pixels.threads, pixels.model)
    of_lamps = np.ascontiguousarray(of_core.T).swapaxes(1, 2)
    value = of_lamps[0]
    frames = tangents(normals).transpose(1, 2, 0)
    lit = strengths.T[:, None] * lamps.colors[..., None]
    planes = np.zeros((8, *lit.shape))
    planes[0] = lit * value
    for t in range(2):
        planes[1 + t] = lit * sum(of_lamps[1 + a] * frames[t, a] for a in range(3))
    for c in range(3):
        planes[3 + c, :, c] = lit[:, c] * of_lamps[7, :, c]
    planes[6:] = lit * of_lamps[8:]
    if not np.array_equal(lamps.pictures, np.arange(pixels.pictures)):
        of_pictures = np.zeros((8, pixels.pictures, 3, len(pixels)))
        for k, picture in enumerate(lamps.pictures):
            of_pictures[:, picture] += planes[:, k]
        planes = of_pictures
    by_place = (of_lamps[4:7] * lit).T.swapaxes(1, 2)
    near = lamps.near
    if near.any():
        assert pixels.points is not None
        distance = np.linalg.norm(lamps.places[near] - pixels.points[:, None], axis=-1)[..., None]
        along = -np.einsum("pkx,kx->pk", directions[:, near], lamps.axes[near])[..., None]
        gathered = lamps.exponents[near, None] / np.maximum(along, np.finfo(np.float64).tiny)
        # d/dq of 1/d² (axis·(p−q)/d)^e, over itself.
        across = lamps.axes[near] + along * directions[:, near]
        by_strength = -2 * directions[:, near] - gathered * across
        shown = (lit * value).transpose(2, 0, 1)[:, near, :, None]
        by_place[:, near] += shown * by_strength[:, :, None, :]
        by_place[:, near] /= distance[..., None]
    by_ambient = _core.shade(normals, *args, pixels.model).reshape(-1, 3, 16)
    found = planes.transpose(3, 1, 2, 0)
    found[..., 0] += _ambient(by_ambient, state)
    _add_ambient_by_surface(planes[1:], pixels, state, frames)
    by_color = (strengths.T[:, None] * value).transpose(2, 0, 1)
    return Slopes(found[..., 0], found[..., 1:], by_place, by_color, by_ambient)


def _add_ambient_by_surface(
    planes: Array, pixels: LampPixels, state: LampState, frames: Array
) -> None:
    """Add to planes (7, N, 3, P) by the surface: slopes of the weights, times ambient light."""
    normals, albedo, roughness, metallic = surface_of(state)
    for j in np.flatnonzero(state.ambient.any(axis=(0, 2))):
        for c in range(3):
            cotangent = np.zeros((len(pixels), 3, 16))
            cotangent[:, c, j] = 1.0
            by_albedo, by_roughness, by_metallic, by_normal = _core.shade_vjp(
                normals, pixels.views, albedo, roughness, metallic, cotangent, pixels.model
            )
            turned = np.einsum("px,txp->tp", by_normal, frames)
            of_weight = [*turned, *by_albedo.T, by_roughness, by_metallic]
            for unknown, slope in enumerate(of_weight):
                planes[unknown, :, c] += slope * state.ambient[:, j, c, None]
