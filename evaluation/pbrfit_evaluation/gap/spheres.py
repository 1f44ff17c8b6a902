"""Models against Cycles: spheres of one material under SH light, nothing else in the scene.

No light is blocked and none bounces, so what differs from Cycles is the reflection law and the
noise of the render. Red, green and blue of a sphere have the three albedos, which saves renders:
each channel is a material of its own. Two renders with different seeds are averaged; half of their
difference is the noise that is left.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from pbrfit.model.geometry import view_directions
from pbrfit.model.reflection import sh_basis
from pbrfit.synthetic.lights import random_lights
from pbrfit.synthetic.surfaces import Paint
from pbrfit_evaluation.cycles.job import Distribution
from pbrfit_evaluation.cycles.scene import inner_pixels
from pbrfit_evaluation.cycles.spheres import FOV, relative_rmse, render_sphere, under, where_met
from pbrfit_evaluation.gap import MODELS, Model
from pbrfit_evaluation.gap.principled import Choices, respond

Array = NDArray[np.float64]

ALBEDOS = (0.05, 0.5, 0.9)
"""Of red, green and blue."""

LEAST_COSINE = 0.15
"""Pixels with a smaller n·v are left out: there one pixel's normals differ by many degrees."""

NOISE = "noise of the renders"
SINGLE = "integral without light between facets"


@dataclass(frozen=True)
class Substance:
    """What a sphere is made of, but for roughness and albedo."""

    key: str
    name: str
    metallic: float


SUBSTANCES = (
    Substance("metal", "metal", 1.0),
    Substance("dielectric", "dielectric", 0.0),
    Substance("half", "metallic 0.5", 0.5),
)


@dataclass(frozen=True)
class Effort:
    """How it is measured.

    Attributes
    ----------
    size, samples
        Pixels a side; paths a pixel of both renders together.
    r
        Roughnesses.
    lights
        Number of random lights.
    distributions, substances
        What is rendered.
    """

    size: int = 64
    samples: int = 1600
    r: tuple[float, ...] = (0.35, 0.5, 0.7, 1.0)
    lights: int = 4
    distributions: tuple[Distribution, ...] = get_args(Distribution)
    substances: tuple[Substance, ...] = SUBSTANCES


@dataclass(frozen=True, eq=False)
class Spheres:
    """Errors of models on Cycles' spheres.

    Attributes
    ----------
    effort
        What was asked for.
    errors
        By distribution, substance and model: (R, 3) RMSE over the mean of Cycles' pictures, by
        roughness and albedo. Under the name `NOISE` stands that of the pictures.
    """

    effort: Effort
    errors: Mapping[tuple[Distribution, str, str], Array]

    def models(self, distribution: Distribution) -> list[str]:
        """Names of what is compared, in order, the noise last."""
        return list(dict.fromkeys(name for d, _, name in self.errors if d == distribution))


def measure(
    effort: Effort | None = None,
    *,
    models: Mapping[str, Model] = MODELS,
    cache: Path | None = None,
    threads: int = 2,
    progress: Callable[[float], None] = lambda _: None,
) -> Spheres:
    """Render the spheres, or take them from the cache, and compare.

    Beside the models stand the integrals of `principled.py` with other `Choices`, to tell what
    each is worth.

    Parameters
    ----------
    effort
        Default: as in the documentation.
    models
        By name.
    cache, threads
        As in `pbrfit_evaluation.cycles.render_scene`.
    progress
        Called with the roughness before it is worked on.

    Raises
    ------
    CyclesError
        As `render_scene`.
    """
    effort = effort or Effort()
    lights = random_lights(effort.lights, np.random.default_rng(0))
    errors: dict[tuple[Distribution, str, str], Array] = {}
    for i, r in enumerate(effort.r):
        progress(r)
        for distribution in effort.distributions:
            compared = {**models, **_integrals(distribution)}
            for substance in effort.substances:
                pictures, noise, normals, views = _pictures(
                    substance, r, distribution, effort, lights, cache, threads
                )
                found = {
                    name: _error(model, normals, views, r, substance.metallic, lights, pictures)
                    for name, model in compared.items()
                }
                for name, values in {**found, NOISE: noise}.items():
                    key = (distribution, substance.key, name)
                    errors.setdefault(key, np.empty((len(effort.r), 3)))[i] = values
    return Spheres(effort, errors)


def _integrals(distribution: Distribution) -> dict[str, Model]:
    """What the model might be instead, by name."""
    chosen: dict[Distribution, dict[str, Choices]] = {
        "GGX": {
            SINGLE: Choices(multiple=False),
            "and E_d/E held back": Choices(multiple=False, held_back="full"),
        },
        "MULTI_GGX": {
            "integral": Choices(),
            "integral, Schlick's Fresnel": Choices(fresnel="fit"),
            "and E_d held back, not M E_d": Choices(fresnel="fit", held_back="lobe"),
        },
    }
    return {
        name: partial(integral, choices=choices) for name, choices in chosen[distribution].items()
    }


def _pictures(
    substance: Substance,
    r: float,
    distribution: Distribution,
    effort: Effort,
    lights: Array,
    cache: Path | None,
    threads: int,
) -> tuple[Array, Array, Array, Array]:
    """Radiance (N, P, 3), its noise (3,), normals (P, 3) and views (P, 3) of a sphere."""
    two = [
        render_sphere(
            Paint(albedo=np.array(ALBEDOS), roughness=r, metallic=substance.metallic),
            effort.size,
            max(effort.samples // 2, 1),
            distribution=distribution,
            seed=seed,
            cache=cache,
            threads=threads,
        )
        for seed in (0, 1)
    ]
    inner = inner_pixels(two[0].segments, two[0].normals, FOV)
    views = view_directions(effort.size, effort.size, FOV)[inner]
    normals, _ = where_met(views)
    seen = np.einsum("pi,pi->p", normals, views) > LEAST_COSINE
    a, b = (under(one, lights)[:, inner][:, seen] for one in two)
    mean = (a + b) / 2
    # Of the mean of both: half of their difference.
    noise = np.array([relative_rmse(a[..., c], b[..., c]) / 2 for c in range(3)])
    return mean, noise, normals[seen], views[seen]


def _error(
    model: Model,
    normals: Array,
    views: Array,
    r: float,
    metallic: float,
    lights: Array,
    pictures: Array,
) -> Array:
    """(3,): of each channel."""
    count = len(normals)
    weights = model(
        normals,
        views,
        np.broadcast_to(np.array(ALBEDOS), (count, 3)),
        np.full(count, r),
        np.full(count, metallic),
    )
    found = np.einsum("pck,nkc->npc", weights, lights)
    return np.array([relative_rmse(found[..., c], pictures[..., c]) for c in range(3)])


# --------------------------------------------------------------------- the integral, on any normals

_NODES = 24


def integral(
    normals: Array, views: Array, albedo: Array, r: Array, m: Array, choices: Choices
) -> Array:
    """(P, 3, 16): weights by brute force, in the frame of the camera.

    Parameters
    ----------
    normals, views, albedo, r, m
        As for `pbrfit.shade`, P pixels that all have one roughness.
    choices
        Of the BRDF.
    """
    angle = np.arccos(np.clip(np.einsum("pi,pi->p", normals, views), 0.0, 1.0))
    local = _between(float(r[0]), float(angle.max()), choices, tuple(albedo[0]), float(m[0]))(angle)
    return np.asarray(np.einsum("pcj,pjk->pck", local, _turn(normals, views)))


@lru_cache(maxsize=64)
def _between(
    r: float, widest: float, choices: Choices, albedo: tuple[float, ...], metallic: float
) -> Callable[[Array], Array]:
    """Weights in the pixel's frame by the view angle up to `widest`, from `_NODES` integrals.

    A response is smooth in the angle, so a Chebyshev polynomial through that many is exact to 1e-6.
    """
    nodes = np.polynomial.chebyshev.chebpts1(_NODES)
    angles = widest / 2 * (1 + nodes)
    values = np.stack(
        [
            respond(r, x).weights(np.array(albedo), np.array(metallic), choices)
            for x in np.cos(angles).tolist()
        ]
    )
    fit = np.polynomial.chebyshev.chebfit(nodes, values.reshape(_NODES, -1), _NODES - 1)

    def at(angle: Array) -> Array:
        found = np.polynomial.chebyshev.chebval(2 * angle / widest - 1, fit)
        return np.asarray(found.T.reshape(len(angle), *values.shape[1:]))

    return at


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
