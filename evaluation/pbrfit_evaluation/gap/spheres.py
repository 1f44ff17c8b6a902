"""Models against Cycles: spheres of one material under SH light, nothing else in the scene.

No light is blocked and none bounces, so what differs from Cycles is the reflection law and the
noise of the render. Red, green and blue of a sphere have the three albedos, which saves renders:
each channel is a material of its own. Two renders with different seeds are averaged; half of their
difference is the noise that is left.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from pbrfit.model.geometry import view_directions
from pbrfit.model.reflection import sh_basis
from pbrfit.synthetic.lights import random_lights
from pbrfit.synthetic.surfaces import Paint
from pbrfit_evaluation.cycles.job import Distribution
from pbrfit_evaluation.cycles.scene import inner_pixels
from pbrfit_evaluation.cycles.spheres import FOV, relative_rmse, render_sphere, under, where_met
from pbrfit_evaluation.gap.measure import MODELS, Array, Model
from pbrfit_evaluation.gap.principled import respond

ALBEDOS = (0.05, 0.5, 0.9)
"""Albedo of red, green and blue."""

LEAST_COSINE = 0.15
"""Pixels with a smaller n·v are left out: there one pixel's normals differ by many degrees."""

NOISE = "noise of the renders"

WITHOUT = "integral without light between facets"
"""What is compared beside the models where Cycles has no such light."""

SUBSTANCES = {"metal": 1.0, "dielectric": 0.0, "half": 0.5}
"""Metallic by name; the last is metallic 0.5."""

ROUGHNESSES = (0.35, 0.5, 0.7, 1.0)


@dataclass(frozen=True)
class Sphere:
    """A sphere, rendered with `samples` paths a pixel in both renders together."""

    distribution: Distribution
    substance: str
    r: float
    size: int = 64
    samples: int = 1600
    lights: int = 4
    cache: Path | None = field(default=None, repr=False)

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"{self.distribution}_{self.substance}_r_{self.r:g}"


def run(case: Sphere, threads: int = 2) -> dict[str, list[float]]:
    """RMSE over the mean of Cycles' pictures, by model and albedo; `NOISE` is that of the pictures.

    Renders a sphere, or takes it from the cache.

    Raises
    ------
    CyclesError
        As `pbrfit_evaluation.cycles.render_scene`.
    """
    metallic = SUBSTANCES[case.substance]
    lights = random_lights(case.lights, np.random.default_rng(0))
    pictures, noise, normals, views = _pictures(case, metallic, lights, threads)
    models: dict[str, Model] = dict(MODELS)
    if case.distribution == "GGX":
        models[WITHOUT] = partial(integral, multiple=False)
    count = len(normals)
    albedo = np.broadcast_to(np.array(ALBEDOS), (count, 3))
    found = {}
    for name, model in models.items():
        weights = model(normals, views, albedo, np.full(count, case.r), np.full(count, metallic))
        found[name] = _by_channel(np.einsum("pck,nkc->npc", weights, lights), pictures)
    return {**found, NOISE: noise}


def _by_channel(found: Array, expected: Array) -> list[float]:
    return [relative_rmse(found[..., c], expected[..., c]) for c in range(3)]


def _pictures(
    case: Sphere, metallic: float, lights: Array, threads: int
) -> tuple[Array, list[float], Array, Array]:
    """Radiance (N, P, 3), its noise by channel, normals (P, 3) and views (P, 3) of a sphere."""
    two = [
        render_sphere(
            Paint(albedo=np.array(ALBEDOS), roughness=case.r, metallic=metallic),
            case.size,
            max(case.samples // 2, 1),
            distribution=case.distribution,
            seed=seed,
            cache=case.cache,
            threads=threads,
        )
        for seed in (0, 1)
    ]
    inner = inner_pixels(two[0].segments, two[0].normals, FOV)
    views = view_directions(case.size, case.size, FOV)[inner]
    normals, _ = where_met(views)
    seen = np.einsum("pi,pi->p", normals, views) > LEAST_COSINE
    a, b = (under(one, lights)[:, inner][:, seen] for one in two)
    # Of the mean of both: half of their difference.
    noise = [error / 2 for error in _by_channel(a, b)]
    return (a + b) / 2, noise, normals[seen], views[seen]


# --------------------------------------------------------------------- the integral, on any normals

_NODES = 24
"""View angles that are integrated. A response is smooth in the angle, so a Chebyshev polynomial
through that many is exact to 1e-6."""


def integral(
    normals: Array, views: Array, albedo: Array, r: Array, m: Array, *, multiple: bool = True
) -> Array:
    """(P, 3, 16): weights by brute force, in the frame of the camera.

    Arguments as for `kernel.shade`, P pixels that all are of one material.
    """
    angle = np.arccos(np.clip(np.einsum("pi,pi->p", normals, views), 0.0, 1.0))
    widest = float(angle.max())
    nodes = np.polynomial.chebyshev.chebpts1(_NODES)
    values = np.stack(
        [
            respond(float(r[0]), cosine, multiple=multiple).weights(albedo[0], m[0])
            for cosine in np.cos(widest / 2 * (1 + nodes)).tolist()
        ]
    )
    fit = np.polynomial.chebyshev.chebfit(nodes, values.reshape(_NODES, -1), _NODES - 1)
    found = np.polynomial.chebyshev.chebval(2 * angle / widest - 1, fit)
    local = found.T.reshape(len(angle), *values.shape[1:])
    return np.asarray(np.einsum("pcj,pjk->pck", local, _turn(normals, views)))


def _turn(normals: Array, views: Array) -> Array:
    """(P, 16, 16): SH functions about the pixels' frames by those of the camera.

    The view direction lies in the frame's x-z plane with x ≥ 0, as in `brute_force.py`.
    """
    across = views - np.einsum("pi,pi->p", normals, views)[:, None] * normals
    length = np.linalg.norm(across, axis=-1, keepdims=True)
    # Seen straight on any direction will do.
    other = np.cross(normals, np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]]))
    x = np.where(length > 1e-9, across, other)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    frame = np.stack([x, np.cross(normals, x), normals], axis=1)  # rows: axes
    probes = np.random.default_rng(0).normal(size=(64, 3))
    probes /= np.linalg.norm(probes, axis=-1, keepdims=True)
    local = sh_basis(np.einsum("pij,dj->pdi", frame, probes))  # (P, 64, 16)
    return np.asarray(np.einsum("kd,pdj->pjk", np.linalg.pinv(sh_basis(probes)), local))
