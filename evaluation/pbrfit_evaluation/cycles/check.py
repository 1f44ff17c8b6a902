"""Spheres whose pictures are known exactly: units, axes and materials, checked.

A sphere sees every direction, so a light with all 16 coefficients leaves no reflection or turn of
an axis unnoticed. Three spheres:

- White and diffuse (Principled, roughness 1, no specular reflection). Radiance is the light's
  irradiance over π: Σ A_l L_lm Y_lm(n) / π, with the clamped cosine's A = π, 2π/3, π/4, 0.
- White polished metal. It mirrors: radiance is L(2 (n·v) n - v), in all four bands.
- White and diffuse again, under one point light: radiance is cos θ / d² in `Rendered`'s unit.

A fourth, of plastic, is compared with the models that the package fits. What remains there is a
difference of models, not an error.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.model.geometry import view_directions
from pbrfit.model.reflection import MODELS, sh_basis, shade
from pbrfit.synthetic.lights import random_lights
from pbrfit.synthetic.surfaces import Paint
from pbrfit.synthetic.world import World
from pbrfit_evaluation.cycles.export import export
from pbrfit_evaluation.cycles.job import Job, rendered
from pbrfit_evaluation.cycles.scene import inner_pixels
from pbrfit_evaluation.cycles.spheres import FOV, relative_rmse, render_sphere, under, where_met

Array = NDArray[np.float64]

_POLISHED = 0.05  # roughness; α = 0.0025 spreads reflections by less than half a degree
_PLASTIC = Paint(albedo=np.array([0.6, 0.3, 0.1]), roughness=0.5, metallic=0.0)
_LAMP = np.array([1.5, 1.0, -0.5])
_BANDS = np.repeat([np.pi, 2 * np.pi / 3, np.pi / 4, 0.0], [1, 3, 5, 7])


@dataclass(frozen=True)
class SphereCheck:
    """Relative RMSE over a sphere's pixels: RMSE over the mean of what is expected.

    Attributes
    ----------
    diffuse, metal, point_light
        Of Cycles against the exact answer.
    mirrored
        The smallest that comes out if the expected light is mirrored in x, y or z, on the white or
        the metal sphere: what a wrong axis would show as.
    plastic
        Of the package's models against Cycles, by name; albedo (0.6, 0.3, 0.1), roughness 0.5.
    normals
        Largest angle between Cycles' normals and the sphere's, in degrees.
    size, samples
        Of the pictures.
    """

    diffuse: float
    metal: float
    point_light: float
    mirrored: float
    plastic: Mapping[str, float]
    normals: float
    size: int
    samples: int


@dataclass(frozen=True)
class TruthCheck:
    """Cycles' maps of a world against those of our own ray casting, at pixels away from edges.

    Attributes
    ----------
    normals
        Root mean square angle in degrees.
    albedo, roughness, metallic
        Largest difference.
    segments
        Share of all pixels whose object is another.
    pixels
        Share of all pixels that are away from edges.
    """

    normals: float
    albedo: float
    roughness: float
    metallic: float
    segments: float
    pixels: float


def check_spheres(
    size: int = 64, samples: int = 1024, *, cache: Path | None = None, threads: int = 2
) -> SphereCheck:
    """Render the spheres and compare.

    Parameters
    ----------
    size
        Width and height of the pictures in pixels.
    samples
        Light paths a pixel of those under panoramas.
    cache, threads
        As in `render_scene`.

    Raises
    ------
    CyclesError
        As `render_scene`.
    """
    lights = random_lights(4, np.random.default_rng(0))
    white = Paint(albedo=np.ones(3), roughness=1.0, metallic=0.0)
    chrome = Paint(albedo=np.ones(3), roughness=_POLISHED, metallic=1.0)
    pictures = partial(render_sphere, size=size, cache=cache, threads=threads)
    diffuse = pictures(white, samples=samples, specular=0.0)
    metal = pictures(chrome, samples=samples)
    plastic = pictures(_PLASTIC, samples=samples)
    lit = pictures(white, samples=1, specular=0.0, lamp=_LAMP)

    seen = inner_pixels(diffuse.segments, diffuse.normals, FOV)
    views = view_directions(size, size, FOV)[seen]
    normals, points = where_met(views)
    mirror = 2 * np.einsum("pi,pi->p", normals, views)[:, None] * normals - views
    expected = {
        "diffuse": sh_basis(normals) * _BANDS / np.pi,
        "metal": sh_basis(mirror),
    }
    found = {
        "diffuse": under(diffuse, lights)[:, seen],
        "metal": under(metal, lights)[:, seen],
    }
    errors = {name: relative_rmse(found[name], of @ lights) for name, of in expected.items()}
    # Y(±x, ±y, ±z): a mirrored axis changes the sign of some basis functions and of no other.
    probe = np.array([[0.36, 0.48, 0.8]])
    flips = [sh_basis(probe * (1 - 2 * axis)) / sh_basis(probe) for axis in np.eye(3)]
    mirrored = [
        relative_rmse(found[name], (of * flip) @ lights)
        for name, of in expected.items()
        for flip in flips
    ]

    towards = _LAMP - points
    distance = np.linalg.norm(towards, axis=-1)
    cosine = np.einsum("pi,pi->p", normals, towards) / distance
    radiance = np.maximum(cosine, 0.0) / distance**2

    of_plastic = (normals, views, _PLASTIC.albedo, _PLASTIC.roughness, _PLASTIC.metallic)
    by_model = {
        model: np.einsum("pck,nkc->npc", shade(*of_plastic, model=model), lights)
        for model in MODELS
    }
    angles = np.einsum("pi,pi->p", diffuse.normals[seen], normals)
    return SphereCheck(
        diffuse=errors["diffuse"],
        metal=errors["metal"],
        point_light=relative_rmse(lit.radiance[0][seen][:, 0], radiance),
        mirrored=min(mirrored),
        plastic={
            model: relative_rmse(closed, under(plastic, lights)[:, seen])
            for model, closed in by_model.items()
        },
        normals=float(np.degrees(np.arccos(np.minimum(angles, 1.0)).max())),
        size=size,
        samples=samples,
    )


def check_truth(
    world: World, size: int = 64, *, cache: Path | None = None, threads: int = 2
) -> TruthCheck:
    """Render a world's maps, and compare them with what our own rays see of it.

    Parameters
    ----------
    world
        Any that `render_scene` takes.
    size
        Width and height in pixels.
    cache, threads
        As in `render_scene`.

    Raises
    ------
    CyclesError
        As `render_scene`.
    """
    found = rendered(
        Job(export(world, size, FOV), None, "brdf", samples=1), cache=cache, threads=threads
    )
    ours = world.cast(size, FOV)
    inner = inner_pixels(found.segments, found.normals, FOV)
    angles = np.einsum("pi,pi->p", found.normals[inner], ours.normals[inner])

    def largest(a: NDArray[np.floating[Any]], b: NDArray[np.floating[Any]]) -> float:
        return float(np.abs(a[inner] - b[inner]).max())

    return TruthCheck(
        normals=float(np.degrees(np.sqrt(np.mean(np.arccos(np.minimum(angles, 1.0)) ** 2)))),
        albedo=largest(found.albedo, ours.materials.albedo),
        roughness=largest(found.roughness, ours.materials.roughness),
        metallic=largest(found.metallic, ours.materials.metallic),
        segments=float(np.mean(found.segments != ours.segments)),
        pixels=float(np.mean(inner)),
    )
