"""The lamp and ambient light of one more picture, on a surface that is known.

What held-out pictures are explained by: 2 + 3 + 3 numbers for all pixels. Directions on a grid are
tried, each with the colour and the constant ambient light that are best by linear least squares;
from the best Levenberg and Marquardt go on. No light is below 0.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pbrfit import _core
from pbrfit.fit.lamps.problem import LampPixels, LampState, by_place, radiance, surface_of
from pbrfit.fit.lamps.samples import MATT_PIXELS
from pbrfit.fit.sampling import evenly_spaced
from pbrfit.fit.settings import MEAN_RADIANCE
from pbrfit.model.lamps import Lamps
from pbrfit.model.lighting import spread_directions
from pbrfit.model.reflection import Model
from pbrfit.values.arrays import Array


def light_of_picture(
    samples: Array,
    weights: Array,
    normals: Array,
    views: Array,
    materials: tuple[Array, ...],
    model: Model,
    threads: int = 0,
) -> tuple[Lamps, Array, Array]:
    """The light of a picture of pixels whose surfaces are known.

    That is one lamp, SH light (16, 3), and their radiance (P, 3). `samples` (P, 3) are linear
    Rec.709, and `weights` (P, 3) how much each counts, 0 = not at all; `normals` and `views` (P, 3)
    are unit vectors, the latter to the camera; `materials` albedo (P, 3), roughness (P,) and
    metallic (P,).
    """
    scale = max(float(samples.mean()) / MEAN_RADIANCE, 1e-12)
    pixels = LampPixels(
        samples[:, None] / scale,
        weights[:, None],
        np.zeros((len(samples), 1, 3), np.uint8),
        views,
        None,
        normals,
        np.zeros(len(samples), np.intp),
        np.arange(len(samples)),
        scale,
        model,
        threads,
    )
    one = Lamps(np.zeros(1, np.intp), np.array([[0.0, 0, 1]]), colors=np.ones((1, 3)))
    state = LampState(one, np.zeros((1, 16, 3)), normals, *materials)
    rows = evenly_spaced(len(pixels), MATT_PIXELS).astype(np.intp)
    few, some = pixels.of_rows(rows), state.of_rows(rows)
    surfaces = some.normals, few.views, some.albedo, some.roughness, some.metallic
    tried = spread_directions(400)  # 10 degrees apart
    directions = np.broadcast_to(tried, (len(few), *tried.shape)).copy()
    unit = _core.lamp_radiance(*surfaces, directions, threads, model)
    ambient = _core.shade(*surfaces, model).reshape(-1, 3, 16)[..., 0]
    best, light = _linear(few, unit, ambient)
    found = _refined(few, _under(some, tried[best], light))
    state = replace(state, lamps=found.lamps, ambient=found.ambient)
    lamps = replace(found.lamps, colors=found.lamps.colors * scale)
    return lamps, found.ambient[0] * scale, radiance(pixels, state)[:, 0] * scale


def _under(state: LampState, place: Array, light: Array) -> LampState:
    """Surfaces under a lamp along a vector (3,) and constant light, of colours `light` (2, 3)."""
    around = np.zeros((1, 16, 3))
    lamp, around[0, 0] = np.maximum(light, 0.0)
    place = place / np.linalg.norm(place)
    lamps = replace(state.lamps, places=place[None], colors=lamp[None])
    return replace(state, lamps=lamps, ambient=around)


def _linear(pixels: LampPixels, unit: Array, ambient: Array) -> tuple[int, Array]:
    """Which direction leaves least with its best lamp and constant light, and their colours (2, 3).

    `unit` (P, 400, 3) is the radiance under lamps there, `ambient` (P, 3) under constant light.
    """
    left, found = np.zeros(unit.shape[1]), np.zeros((unit.shape[1], 2, 3))
    for c in range(3):
        w, y, lamps = pixels.weights[:, 0, c], pixels.samples[:, 0, c], unit[..., c]
        around = w * ambient[:, c]
        matrix, right = np.empty((*left.shape, 2, 2)), np.empty((*left.shape, 2))
        matrix[:, 0, 0], right[:, 0] = w @ lamps**2, (w * y) @ lamps
        matrix[:, 0, 1] = matrix[:, 1, 0] = around @ lamps
        matrix[:, 1, 1], right[:, 1] = around @ ambient[:, c], around @ y
        ridge = 1e-6 * np.trace(matrix, axis1=1, axis2=2) + 1e-12
        ridged = matrix + ridge[:, None, None] * np.eye(2)
        light = np.linalg.solve(ridged, right[..., None])[..., 0]
        # Where one would be below 0, the other alone.
        alone = np.maximum(right, 0.0) / np.einsum("kii->ki", ridged)
        light = np.where((light[:, ::-1] < 0), alone, np.maximum(light, 0.0))
        left += w @ y**2 + (((matrix @ light[..., None])[..., 0] - 2 * right) * light).sum(axis=1)
        found[..., c] = light
    best = int(left.argmin())
    return best, found[best]


def _refined(pixels: LampPixels, state: LampState) -> LampState:
    """Levenberg–Marquardt on direction, colour and constant ambient light."""
    damping, strength = 1e-3, np.ones((1, 1))

    def cost_of(one: LampState) -> float:
        return float((pixels.weights * (radiance(pixels, one) - pixels.samples) ** 2).sum())

    cost = cost_of(state)
    for _ in range(30):
        light = np.concatenate([state.lamps.colors, state.ambient[:, 0]])
        turn = by_place(pixels, state.lamps, state.lamps.places[None])
        _, mixed, matrix = pixels.under(state).system(
            pixels.weights, surface_of(state), strength, turn
        )
        assert matrix is not None
        gradient = mixed[:, -1].sum(axis=0)
        dark = 3 + np.flatnonzero((light.ravel() <= 0) & (gradient[3:] > 0))
        matrix[dark] = matrix[:, dark] = gradient[dark] = 0.0
        while damping < 1e6:
            damped = matrix + np.diag(damping * np.diag(matrix) + 1e-12 * np.trace(matrix))
            change = -np.linalg.solve(damped, gradient)
            place = state.lamps.places[0] + np.clip(change[:3], -0.3, 0.3)
            trial = _under(state, place, light + change[3:].reshape(2, 3))
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
