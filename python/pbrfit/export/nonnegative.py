"""Panoramas without negative light that light the surfaces of a result as its SH lights do.

Nothing keeps recovered lights from being negative, least of all in directions that no surface
reflects to the camera, and no other tool can use that. To leave the negative part out would add
light. So, of each channel, a panorama E ≥ 0 is sought that changes least of what the surfaces show:

    minimise ½ (c − L)ᵀ M (c − L) + ε/2 ∫ E² dω,    c_k = ∫ E Y_k dω,    M = mean of w wᵀ.

L is the light, w are the weights of a pixel (`kernel.shade`), and ε keeps light out of directions
that the surfaces tell nothing of. With μ = M (L − c)/ε, the derivative by E is ε (E − Σ_k μ_k Y_k).
So where E is not held at 0 it vanishes, and

    E = max(0, Σ_k μ_k Y_k).

With M = S Sᵀ and μ = S ν that is the minimum of a convex function of 16 unknowns,

    f(ν) = ½ ∫ E² dω − (Sᵀ L)·ν + ε/2 |ν|²,    ∂f/∂ν = Sᵀ (c − L) + ε ν.
"""

from __future__ import annotations

import math

import numpy as np

from pbrfit.fit.sampling import evenly_spaced
from pbrfit.model import panorama
from pbrfit.model.geometry import view_directions
from pbrfit.model.reflection import sh_basis, shade
from pbrfit.result.result import Result
from pbrfit.values.arrays import Array

PIXELS = 4096
"""Number of pixels that stand for all in M, whose 136 numbers need no more."""

RIDGE = 1e-3
"""ε, in units of the mean eigenvalue of M. With 1e-2, 1e-3, 1e-4 panoramas of a single lamp light a
room by 11, 5, 2 % differently, and those of photographs of a figurine the figurine by 4.5, 3.6,
3.1 %; but where no surface tells of it, light grows, its peak from 3 to 5 to 15."""

STEPS = 500


def surface_response(result: Result) -> Array:
    """M of each channel: (3, 16, 16)."""
    pixels = np.flatnonzero(result.mask)
    pixels = pixels[evenly_spaced(len(pixels), PIXELS).astype(np.int64)]
    height, width = result.mask.shape
    views = view_directions(height, width, result.fov)
    weights = shade(
        result.normals.reshape(-1, 3)[pixels],
        views.reshape(-1, 3)[pixels],
        result.albedo.reshape(-1, 3)[pixels],
        result.roughness.reshape(-1)[pixels],
        result.metallic.reshape(-1)[pixels],
        model=result.model,
    )
    return np.asarray(np.einsum("pck,pcl->ckl", weights, weights) / len(pixels))


def nonnegative_radiance(
    light: Array, response: Array, height: int, whole: Array
) -> tuple[Array, float]:
    """Panorama (height, 2 height, 3), 0 or more, of an SH light (16, 3).

    A light that is nowhere negative is its own panorama. Beside it the difference that is left:
    RMS over pixels and channels of what surfaces of that `response` show, relative to what they
    show under the `whole` light (16, 3), of which this one is a part, or all.
    """
    radiance = panorama.radiance(light, height)
    negative = [c for c in range(3) if radiance[..., c].min() < 0]
    if not negative:
        return radiance, 0.0
    for c in negative:
        radiance[..., c] = _fitted(light[:, c], response[c], height)
    off = panorama.project(radiance) - light
    lost, shown = (float(np.einsum("kc,ckl,lc", of, response, of)) for of in (off, whole))
    return radiance, math.sqrt(max(lost, 0.0) / shown) if shown > 0 else 0.0


def _fitted(light: Array, response: Array, height: int) -> Array:
    """E of one channel: (height, 2 height)."""
    from scipy.optimize import minimize

    size = float(np.abs(light).max())
    values, vectors = np.linalg.eigh(response)
    ridge = RIDGE * float(values.mean())
    if size == 0 or ridge <= 0:  # nothing is lit, or black surfaces show nothing
        return np.zeros((height, 2 * height))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    basis = sh_basis(panorama.directions(height, 2 * height)) @ root
    angles = panorama.solid_angles(height, 2 * height)[:, None]
    target = root.T @ (light / size)

    def loss(unknown: Array) -> tuple[float, Array]:
        lit = np.maximum(basis @ unknown, 0.0)
        weighted = lit * angles
        value = 0.5 * np.sum(weighted * lit) - target @ unknown + 0.5 * ridge * unknown @ unknown
        slope = np.tensordot(weighted, basis, axes=((0, 1), (0, 1))) - target + ridge * unknown
        return float(value), np.asarray(slope)

    found = minimize(
        loss,
        np.zeros(16),
        jac=True,
        method="L-BFGS-B",
        options={"maxiter": STEPS, "ftol": 0.0, "gtol": 1e-8 * float(np.abs(target).max())},
    )
    return np.asarray(np.maximum(basis @ found.x, 0.0) * size)
