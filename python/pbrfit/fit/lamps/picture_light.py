"""The lamp and ambient light of one more picture, on a surface that is known.

What held-out pictures are explained by, and relighting by a photograph: 3 + 2 + 3 T numbers for all
pixels. Directions on a grid are tried, each with the colour and ambient light that are best by
linear least squares; from the best Gauss and Newton go on.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pbrfit import _core
from pbrfit.fit.lamps.problem import LampPixels, LampState, radiance, slopes, tangents
from pbrfit.fit.sampling import evenly_spaced
from pbrfit.model.geometry import view_directions
from pbrfit.model.lamps import Lamps
from pbrfit.model.lighting import spread_directions
from pbrfit.result.result import Result

Array = NDArray[np.float64]

PIXELS = 4000
"""That a light of some ten numbers is fitted to."""

DIRECTIONS = 400
"""On the whole sphere: 10 degrees apart."""

STEPS = 30

RIDGE = 1e-6
"""Added to the diagonal of the linear equations, as a share of their trace."""


def fit_picture_light(
    result: Result,
    picture: NDArray[np.floating],
    weights: NDArray[np.floating] | None = None,
    direction: Array | None = None,
    *,
    ambient_terms: int = 9,
) -> tuple[Lamps, Array]:
    """The light of a picture (H, W, 3) of the same view, linear Rec.709.

    Parameters
    ----------
    result
        Whose materials and normals are held.
    picture
        Radiance, as the result's pictures.
    weights
        (H, W, 3) or (H, W): how much samples count, 0 = not at all; None = all alike.
    direction
        (3,) unit vector to the lamp, if it is known.
    ambient_terms
        Coefficients of ambient light: 0, 1, 4 or 9.

    Returns
    -------
    lamps, ambient
        One lamp, and SH light (16, 3).
    """
    valid = np.flatnonzero(result.mask.ravel())
    samples = np.asarray(picture, np.float64).reshape(-1, 3)[valid]
    counted = np.ones_like(samples)
    if weights is not None:
        given = np.asarray(weights, np.float64)
        given = given[..., None] if given.ndim == 2 else given
        counted = np.broadcast_to(given, picture.shape).reshape(-1, 3)[valid].copy()
    counted[~np.isfinite(samples)] = 0
    samples = np.where(counted > 0, samples, 0.0)
    height, width = result.mask.shape
    views = view_directions(height, width, result.fov).reshape(-1, 3)[valid]
    scale = max(float(samples.mean()) / 0.4, 1e-12)
    pixels = LampPixels(
        samples[:, None] / scale,
        counted[:, None],
        np.zeros((len(valid), 1, 3), np.uint8),
        views,
        None,
        result.normals.reshape(-1, 3)[valid],
        np.zeros(len(valid), np.intp),
        valid,
        scale,
        result.model,
        0,
    )
    state = LampState(
        Lamps(np.zeros(1, np.intp), np.array([[0.0, 0, 1]]), colors=np.ones((1, 3))),
        np.zeros((1, 16, 3)),
        pixels.normals,
        np.asarray(result.albedo, np.float64).reshape(-1, 3)[valid],
        np.asarray(result.roughness, np.float64).reshape(-1)[valid],
        np.asarray(result.metallic, np.float64).reshape(-1)[valid],
    )
    found = light_of_picture(pixels, state, direction, ambient_terms)
    return replace(found.lamps, colors=found.lamps.colors * scale), found.ambient[0] * scale


def light_of_picture(
    pixels: LampPixels, state: LampState, direction: Array | None, terms: int
) -> LampState:
    """The state with the best light of its one picture, all else held."""
    rows = evenly_spaced(len(pixels), PIXELS).astype(np.intp)
    few, some = pixels.of_rows(rows), state.of_rows(rows)
    ambient = _core.shade(
        some.normals, few.views, some.albedo, some.roughness, some.metallic, few.model
    ).reshape(-1, 3, 16)[..., :terms]
    tried = spread_directions(DIRECTIONS) if direction is None else np.atleast_2d(direction)
    unit = _core.lamp_radiance(
        some.normals,
        few.views,
        some.albedo,
        some.roughness,
        some.metallic,
        np.broadcast_to(tried, (len(few), *tried.shape)).copy(),
        few.threads,
        few.model,
    )
    best, color, of_ambient = _linear(few, unit, ambient)
    lamps = replace(state.lamps, places=tried[best][None], colors=color[None])
    around = np.zeros((1, 16, 3))
    around[0, :terms] = of_ambient
    some = replace(some, lamps=lamps, ambient=around)
    if direction is None:
        some = _refined(few, some, terms)
    return replace(state, lamps=some.lamps, ambient=some.ambient)


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
        ridge = RIDGE * np.trace(matrix, axis1=1, axis2=2) + 1e-12
        ridged = matrix + ridge[:, None, None] * np.eye(1 + terms)
        found[:, c] = np.linalg.solve(ridged, right[..., None])[..., 0]
        found[:, c, 0] = np.maximum(found[:, c, 0], 0.0)
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
    for _ in range(STEPS):
        found = slopes(pixels, state)
        residual = found.radiance - pixels.samples
        frame = tangents(state.lamps.places)[0]
        parts = [np.einsum("pcx,tx->pct", found.by_place[:, 0], frame)]
        parts.append(found.by_color[:, 0, :, None] * np.eye(3))
        around = found.by_ambient[:, :, :terms, None] * np.eye(3)[:, None]
        parts.append(around.reshape(len(pixels), 3, -1))
        jacobian = np.concatenate(parts, axis=-1).reshape(3 * len(pixels), -1)
        w = pixels.weights[:, 0].reshape(-1)
        matrix = jacobian.T @ (w[:, None] * jacobian)
        gradient = jacobian.T @ (w * residual[:, 0].reshape(-1))
        while damping < 1e6:
            damped = matrix + np.diag(damping * np.diag(matrix) + 1e-12 * np.trace(matrix))
            change = -np.linalg.solve(damped, gradient)
            place = state.lamps.places[0] + np.clip(change[:2], -0.3, 0.3) @ frame
            ambient = state.ambient.copy()
            ambient[0, :terms] += change[5:].reshape(terms, 3)
            trial = replace(
                state,
                lamps=replace(
                    state.lamps,
                    places=(place / np.linalg.norm(place))[None],
                    colors=np.maximum(state.lamps.colors + change[2:5], 0.0),
                ),
                ambient=ambient,
            )
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
