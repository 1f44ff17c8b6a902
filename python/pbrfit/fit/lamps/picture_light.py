"""The lamp and ambient light of one more picture, on a surface that is known.

What held-out pictures are explained by, and relighting by a photograph: 3 + 2 + 3 T numbers for all
pixels. Directions on a grid are tried, each with the colour and ambient light that are best by
linear least squares; from the best Gauss and Newton go on. Neither the lamp nor what is constant of
the ambient light is below 0.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pbrfit import _core
from pbrfit.fit.lamps.problem import LampPixels, LampState, radiance, surface_of, tangents
from pbrfit.fit.lamps.samples import MATT_PIXELS
from pbrfit.fit.sampling import evenly_spaced
from pbrfit.fit.settings import MEAN_RADIANCE
from pbrfit.model.lamps import Lamps
from pbrfit.model.lighting import spread_directions
from pbrfit.model.reflection import Model

Array = NDArray[np.float64]


def light_of_picture(
    samples: Array,
    weights: Array,
    normals: Array,
    views: Array,
    materials: tuple[Array, ...],
    model: Model,
    terms: int = 1,
    threads: int = 0,
) -> tuple[Lamps, Array, Array]:
    """The light of a picture of pixels whose surfaces are known.

    That is one lamp, SH light (16, 3), and their radiance (P, 3). `samples` (P, 3) are linear
    Rec.709, and `weights` (P, 3) how much each counts, 0 = not at all; `normals` and `views` (P, 3)
    are unit vectors, the latter to the camera; `materials` albedo (P, 3), roughness (P,) and
    metallic (P,). Ambient light has so many `terms`: 0, 1, 4 or 9 coefficients.
    """
    scale = max(float(samples.mean()) / MEAN_RADIANCE, 1e-12)
    places = np.arange(len(samples))
    pixels = LampPixels(
        samples[:, None] / scale,
        weights[:, None],
        np.zeros((len(samples), 1, 3), np.uint8),
        views,
        None,
        normals,
        np.zeros(len(samples), np.intp),
        places,
        scale,
        model,
        threads,
    )
    one = Lamps(np.zeros(1, np.intp), np.array([[0.0, 0, 1]]), colors=np.ones((1, 3)))
    state = LampState(one, np.zeros((1, 16, 3)), normals, *materials)
    rows = evenly_spaced(len(pixels), MATT_PIXELS).astype(np.intp)
    few, some = pixels.of_rows(rows), state.of_rows(rows)
    surfaces = some.normals, few.views, some.albedo, some.roughness, some.metallic
    ambient = _core.shade(*surfaces, model).reshape(-1, 3, 16)[..., :terms]
    tried = spread_directions(400)  # 10 degrees apart
    directions = np.broadcast_to(tried, (len(few), *tried.shape)).copy()
    unit = _core.lamp_radiance(*surfaces, directions, threads, model)
    best, color, of_ambient = _linear(few, unit, ambient)
    around = np.zeros((1, 16, 3))
    around[0, :terms] = of_ambient
    lamps = replace(one, places=tried[best][None], colors=color[None])
    found = _refined(few, replace(some, lamps=lamps, ambient=around), terms)
    state = replace(state, lamps=found.lamps, ambient=found.ambient)
    lamps = replace(found.lamps, colors=found.lamps.colors * scale)
    return lamps, found.ambient[0] * scale, radiance(pixels, state)[:, 0] * scale


def _linear(pixels: LampPixels, unit: Array, ambient: Array) -> tuple[int, Array, Array]:
    """Which of the directions leaves least with its best colour and ambient light, and these."""
    count, terms = unit.shape[1], ambient.shape[-1]
    left, found = np.zeros(count), np.zeros((count, 3, 1 + terms))
    for c in range(3):
        w, y, lamps = pixels.weights[:, 0, c], pixels.samples[:, 0, c], unit[..., c]
        around = w[:, None] * ambient[:, c]
        matrix, right = np.empty((count, 1 + terms, 1 + terms)), np.empty((count, 1 + terms))
        matrix[:, 0, 0], right[:, 0] = w @ lamps**2, (w * y) @ lamps
        matrix[:, 0, 1:] = matrix[:, 1:, 0] = lamps.T @ around
        matrix[:, 1:, 1:], right[:, 1:] = ambient[:, c].T @ around, y @ around
        ridge = 1e-6 * np.trace(matrix, axis1=1, axis2=2) + 1e-12
        ridged = matrix + ridge[:, None, None] * np.eye(1 + terms)
        found[:, c] = np.linalg.solve(ridged, right[..., None])[..., 0]
        dark = found[:, c] < 0
        dark[:, 2:] = False
        ridged = np.where(dark[:, None] | dark[..., None], np.eye(1 + terms), ridged)
        found[:, c] = np.linalg.solve(ridged, np.where(dark, 0.0, right)[..., None])[..., 0]
        found[:, c, :2] = np.maximum(found[:, c, :2], 0.0)
        shown = (matrix @ found[:, c, :, None])[..., 0]
        left += w @ y**2 + ((shown - 2 * right) * found[:, c]).sum(axis=1)
    best = int(left.argmin())
    return best, np.maximum(found[best, :, 0], 1e-9), found[best, :, 1:].T


def _refined(pixels: LampPixels, state: LampState, terms: int) -> LampState:
    """Gauss-Newton with damping on direction, colour and ambient light."""
    damping = 1e-3

    def cost_of(one: LampState) -> float:
        residual = radiance(pixels, one) - pixels.samples
        return float((pixels.weights * residual**2).sum())

    cost = cost_of(state)
    for _ in range(30):
        residual = radiance(pixels, state) - pixels.samples
        normals, albedo, roughness, metallic = surface_of(state)
        surfaces = normals, pixels.views, albedo, roughness, metallic
        frame = tangents(state.lamps.places)[0]
        step = np.cbrt(np.finfo(np.float64).eps)  # where differences round as much as they bend
        beside = np.concatenate([np.zeros((1, 3)), step * frame, -step * frame])
        beside += state.lamps.places
        beside /= np.linalg.norm(beside, axis=-1, keepdims=True)
        directions = np.broadcast_to(beside, (len(pixels), *beside.shape)).copy()
        unit = _core.lamp_radiance(*surfaces, directions, pixels.threads, pixels.model)
        by_place = (unit[:, 1:3] - unit[:, 3:]).swapaxes(1, 2) / (2 * step)
        by_ambient = _core.shade(*surfaces, pixels.model).reshape(-1, 3, 16)[..., :terms, None]
        parts = [by_place * state.lamps.colors[0, :, None], unit[:, 0, :, None] * np.eye(3)]
        parts.append((by_ambient * np.eye(3)[:, None]).reshape(len(pixels), 3, -1))
        jacobian = np.concatenate(parts, axis=-1).reshape(3 * len(pixels), -1)
        w = pixels.weights[:, 0].reshape(-1)
        matrix = jacobian.T @ (w[:, None] * jacobian)
        gradient = jacobian.T @ (w * residual[:, 0].reshape(-1))
        dark = np.append(state.lamps.colors, state.ambient[0, : min(terms, 1)]) <= 0
        at = 2 + np.flatnonzero(dark & (gradient[2 : 2 + len(dark)] > 0))
        matrix[at] = matrix[:, at] = gradient[at] = 0.0
        while damping < 1e6:
            damped = matrix + np.diag(damping * np.diag(matrix) + 1e-12 * np.trace(matrix))
            change = -np.linalg.solve(damped, gradient)
            place = state.lamps.places + np.clip(change[:2], -0.3, 0.3) @ frame
            place /= np.linalg.norm(place)
            colors = np.maximum(state.lamps.colors + change[2:5], 0.0)
            ambient = state.ambient.copy()
            ambient[0, :terms] += change[5:].reshape(terms, 3)
            np.maximum(ambient[0, 0], 0.0, out=ambient[0, 0])
            lamps = replace(state.lamps, places=place, colors=colors)
            trial = replace(state, lamps=lamps, ambient=ambient)
            new = cost_of(trial)
            if new < cost:
                break
            damping *= 10
        else:
            return state
        gain, state, cost, damping = cost - new, trial, new, damping * 0.2
        if gain < 1e-8 * cost:
            break
    return state
