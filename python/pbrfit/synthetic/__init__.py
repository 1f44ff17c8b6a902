"""Synthetic scenes with ground truth: exact normals, known materials, known positive lights.

Pictures are rendered with the package's own forward model, without shadows or interreflections, so
what a fit of them cannot recover is the fault of the fit, or of the noise.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pbrfit._core import InputError
from pbrfit.model.reflection import DEFAULT_MODEL, Model, checked_model, render
from pbrfit.scene.arrays import Truth
from pbrfit.scene.scene import Scene
from pbrfit.synthetic.lights import random_lights
from pbrfit.synthetic.scenes import draw
from pbrfit.synthetic.world import RayCast, World
from pbrfit.values.arrays import Array

__all__ = ["MEAN_RADIANCE", "RayCast", "World", "draw", "gains", "make_scene", "random_lights"]

MEAN_RADIANCE = 0.4
"""Mean radiance of the training pictures of a scene, all together."""


def make_scene(
    kind: str,
    *,
    size: int = 128,
    lights: int = 16,
    held_out: int = 16,
    sh_order: int = 3,
    noise: float = 0.0,
    seed: int = 0,
    fov: float = 60.0,
    model: Model = DEFAULT_MODEL,
    textures: Any = None,
) -> Scene:
    """Draw a scene and its lights, and render the pictures in float64.

    Each picture is first exposed on its own, to a level that varies by no more than a factor of 2
    over the set; then one constant takes all lights, the held-out ones included, to where the
    noise-free training pictures have a mean radiance of 0.4.

    Parameters
    ----------
    kind
        "room", "spheres", "textured", "furnished" or "detailed"; see `draw`.
    size
        Width and height of the pictures in pixels.
    lights, held_out
        Number of training pictures N and of held-out pictures M, each at least 1.
    sh_order
        2 or 3: the order of all lights.
    noise
        Standard deviation of the Gaussian noise added to the training pictures, in radiance.
    seed
        Non-negative. ``SeedSequence(seed)`` is split into four streams, in this order: geometry and
        materials, training lights, held-out lights, noise; so that each can change without the
        others.
    fov
        Horizontal field of view of the pictures in degrees, 0 < fov < 180.
    model
        "paper" or "principled": how surfaces reflect light. Neither geometry, materials nor lights
        depend on it, but for the exposure of the lights.
    textures
        For "detailed" alone: a folder of texture maps, or the sets that
        `pbrfit_evaluation.rooms.load_textures` read from one. None for procedural detail.

    Returns
    -------
    Scene
        float64 pictures (noise may make them negative) with segment ids from 1 for each piece and
        each wall, and the ground truth: materials, lights, noise-free held-out pictures and their
        lights in the same exposure.

    Raises
    ------
    InputError
        When an argument is out of its range, or the textures cannot be used.
    """
    if not 0.0 <= noise < np.inf:
        raise InputError(f"noise: expected a finite standard deviation >= 0, found {noise}")
    if seed < 0:
        raise InputError(f"seed: expected a non-negative integer, found {seed}")
    model = checked_model(model)
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(4)]
    view = draw(kind, streams[0], textures).cast(size, fov)

    lighting, images = _expose(view, random_lights(lights, streams[1], sh_order), model, streams[1])
    relight_lighting, relight_images = _expose(
        view, random_lights(held_out, streams[2], sh_order), model, streams[2]
    )
    exposure = MEAN_RADIANCE / images.mean()
    images *= exposure
    if noise > 0.0:
        images += streams[3].normal(scale=noise, size=images.shape)
    return Scene(
        images=images,
        normals=view.normals,
        fov=view.fov,
        segments=view.segments,
        names=tuple(f"light_{i:02d}" for i in range(lights)),
        model=model,
        truth=Truth(
            materials=view.materials,
            lighting=exposure * lighting,
            relight_images=exposure * relight_images,
            relight_lighting=exposure * relight_lighting,
        ),
    )


def _expose(
    view: RayCast, lighting: Array, model: Model, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Scale each light so that its picture's mean is between 1/√2 and √2; return both, scaled."""
    images = render(view.materials, view.normals, lighting, view.fov, model=model)
    gain = gains(images, rng)
    return gain[:, None, None] * lighting, gain[:, None, None, None] * images


def gains(images: Array, rng: np.random.Generator) -> Array:
    """(N,) factors that take the mean of each of N pictures (N, ...) to between 1/√2 and √2."""
    level = np.sqrt(2) ** rng.uniform(-1, 1, size=len(images))
    return np.asarray(level / images.reshape(len(images), -1).mean(axis=1))
