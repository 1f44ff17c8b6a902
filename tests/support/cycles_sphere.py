"""One sphere before the camera, by Cycles, and where exactly its pixels lie."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.synthetic.geometry import Sphere
from pbrfit.synthetic.surfaces import Layers, Paint
from pbrfit.synthetic.world import World
from pbrfit.values.arrays import Array
from pbrfit_evaluation.cycles.export import export
from pbrfit_evaluation.cycles.job import Distribution, Job, Rendered, rendered

FOV = 60.0
"""Horizontal field of view in degrees."""

_CENTRE = np.array([0.0, 0.0, -3.0])  # the radius is 1


def render_sphere(
    paint: Paint,
    size: int,
    samples: int,
    *,
    specular: float = 0.5,
    distribution: Distribution = "MULTI_GGX",
    lamp: Array | None = None,
    seed: int = 0,
    cache: Path | None = None,
    threads: int = 2,
) -> Rendered:
    """Render a sphere of one material without shadows and bounces.

    Parameters
    ----------
    paint
        The material.
    size
        Width and height of the picture in pixels.
    samples, specular, distribution, seed
        As in `Job`.
    lamp
        (3,) place of a white point light; None = the SH basis functions.
    cache, threads
        As in `render_scene`.

    Raises
    ------
    CyclesError
        As `render_scene`.
    """
    world = World(
        primitives=(Sphere(centre=_CENTRE, radius=1.0),),
        surfaces=(Layers(paint),),
        walls=0,
        eye=np.zeros(3),
        turn=np.eye(3),
    )
    job = Job(
        export(world, size, FOV),
        None if lamp is None else lamp[None],
        "brdf",
        samples=samples,
        seed=seed,
        specular=specular,
        distribution=distribution,
    )
    return rendered(job, cache=cache, threads=threads)


def where_met(views: Array) -> tuple[Array, Array]:
    """Normals (P, 3) and points (P, 3) where rays along -views (P, 3) meet the sphere."""
    along = -views @ _CENTRE
    offset = -along[:, None] * views - _CENTRE
    half_chord = np.sqrt(1.0 - np.einsum("pi,pi->p", offset, offset))
    points = -(along - half_chord)[:, None] * views
    return points - _CENTRE, points


def under(of: Rendered, lights: Array) -> Array:
    """(N, H, W, 3): pictures under SH lights (N, 16, 3), from those under the basis functions."""
    return np.asarray(np.einsum("khwc,nkc->nhwc", of.radiance.astype(np.float64), lights))


def relative_rmse(found: NDArray[np.floating[Any]], expected: NDArray[np.floating[Any]]) -> float:
    """RMSE over the mean of what is expected."""
    return float(np.sqrt(np.mean((found - expected) ** 2)) / np.mean(expected))
