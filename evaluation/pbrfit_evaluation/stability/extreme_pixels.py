"""Random and extreme pixels, lights and pictures that the stability suite evaluates."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.random import Generator

from pbrfit_evaluation.arrays import Array, unit
from pbrfit_evaluation.stability.double_precision import Case, Pixels

NEAR = 1e-8
"""How near to a special value "near" is."""

Change = Callable[[Generator, Case], Case]
"""Gives random pixels something special."""


def random_pixels(rng: Generator, count: int) -> Pixels:
    """Draw materials all over their range, seen at all cosines from 0.05 to 1."""
    views = unit(np.stack([*rng.uniform(-0.6, 0.6, (2, count)), np.ones(count)], axis=-1))
    return Pixels(
        seen_at(rng, views, rng.uniform(0.05, 1.0, count)),
        views,
        rng.uniform(0, 1, (count, 3)),
        rng.uniform(0, 1, count),
        rng.uniform(0, 1, count),
    )


def seen_at(rng: Generator, views: Array, cosine: Array) -> Array:
    """Normals (P, 3) with the given n·v, turned about the view direction at random."""
    across = unit(np.cross(views, rng.normal(size=views.shape)))
    return np.asarray(cosine[:, None] * views + np.sqrt(1 - cosine**2)[:, None] * across)


def random_lights(rng: Generator, count: int, variation: float = 0.5) -> Array:
    """Lights (N, 16, 3) of radiance about 1, with bands that vary by `variation` and fall off."""
    spread = np.repeat([0.3, 1.0, 0.6, 0.4], [1, 3, 5, 7])
    lights = variation * spread[:, None] * rng.normal(size=(count, 16, 3))
    lights[:, 0] += 2.0
    return np.asarray(lights)


def random_case(rng: Generator, pixels: int, pictures: int) -> Case:
    """Pixels and lights, and pictures that have nothing to do with them: residuals like them."""
    drawn, lighting = random_pixels(rng, pixels), random_lights(rng, pictures)
    return Case(drawn, lighting, rng.uniform(0, 2, (pictures, pixels, 3)).astype(np.float32))


def _with_roughness(center: float, low: float, high: float) -> Change:
    """Roughness within [low, high] of `center`, one pixel in eight exactly on it."""

    def change(rng: Generator, case: Case) -> Case:
        r = center + rng.uniform(low, high, len(case.pixels))
        r[::8] = center
        return replace(case, pixels=replace(case.pixels, roughness=r))

    return change


def grazing(lowest: float, away: int = 0) -> Change:
    """n·v from 1 to ten to the power of `lowest`; one in `away` faces away."""

    def change(rng: Generator, case: Case) -> Case:
        cosine = 10.0 ** rng.uniform(lowest, 0, len(case.pixels))
        if away:
            cosine[::away] *= -1
        normals = seen_at(rng, case.pixels.views, cosine)
        return replace(case, pixels=replace(case.pixels, normals=normals))

    return change


def _on_bounds(rng: Generator, case: Case) -> Case:
    # Albedo, roughness and metallic exactly 0 or 1, in all combinations.
    n = len(case.pixels)
    albedo = rng.integers(0, 2, (n, 3)).astype(np.float64)
    roughness, metallic = rng.integers(0, 2, (2, n)).astype(np.float64)
    pixels = replace(case.pixels, albedo=albedo, roughness=roughness, metallic=metallic)
    return replace(case, pixels=pixels)


def scaled(low: float, high: float) -> Change:
    """Pictures of different exposure, log-uniform between low and high."""

    def change(rng: Generator, case: Case) -> Case:
        scale = np.exp(rng.uniform(np.log(low), np.log(high), (len(case.lighting), 1, 1)))
        scale[0], scale[-1] = low, high
        images = (case.images * scale).astype(np.float32)
        return Case(case.pixels, case.lighting * scale, images)

    return change


def _dark_channel(_: Generator, case: Case) -> Case:
    # Blue is black in light and picture, in half of the pictures in the picture alone.
    lighting, images = case.lighting.copy(), case.images.copy()
    images[..., 2] = 0
    lighting[: len(lighting) // 2, :, 2] = 0
    return Case(case.pixels, lighting, images)


_AT_ALL_ANGLES = grazing(-7, away=8)
"""From facing the camera to beyond the clamp."""


def _everything(rng: Generator, case: Case) -> Case:
    for change in (_AT_ALL_ANGLES, _on_bounds, scaled(1e-6, 1e6), _dark_channel):
        case = change(rng, case)
    return case


KINDS: Mapping[str, Change] = {
    "random": lambda _, case: case,
    "r near 0": _with_roughness(0.0, 0.0, NEAR),
    "r near 1": _with_roughness(1.0, -NEAR, 0.0),
    "r across 0.4": _with_roughness(0.4, -NEAR, NEAR),
    "n·v from 1 to 10⁻⁷, or negative": _AT_ALL_ANGLES,
    "ρ, r, m exactly 0 or 1": _on_bounds,
    "lights × 10⁻⁶": scaled(1e-6, 1e-6),
    "lights × 10⁶": scaled(1e6, 1e6),
    "lights × 10⁻⁶ … 10⁶ in one problem": scaled(1e-6, 1e6),
    "blue dark": _dark_channel,
    "grazing, on bounds, mixed lights, blue dark": _everything,
}
