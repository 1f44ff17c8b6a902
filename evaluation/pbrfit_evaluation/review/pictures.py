"""Honest relights: one view under many lights, as a camera shows them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pbrfit.io.color import decode_srgb, encode_srgb
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import draw, make_scene

Array = NDArray[np.float64]

Renderer = Literal["own", "cycles", "cycles-full"]
"""Our forward model under SH lights; Cycles, lamps with hard shadows and even light; the same, with
panoramas and interreflections in place of the even light."""

FILL = (0.1, 0.5)
"""Share of the even light, or of the panorama, in a picture by Cycles."""

LAMPS = 3
"""At most so many lamps in one picture by Cycles."""

PANORAMA_SAMPLES = 64
"""Light paths a pixel; the noise, 3 to 6 %, stays in the pictures."""


@dataclass(frozen=True, eq=False)
class View:
    """One view under many lights."""

    pictures: Array
    """(N, H, W, 3) linear, exposed: white = 1, brighter values there."""
    segments: NDArray[np.integer[Any]]
    """(H, W) ids of objects."""


def relights(
    kind: str,
    renderer: Renderer,
    seed: int,
    *,
    size: int,
    count: int,
    threads: int = 1,
) -> View:
    """Render `count` pictures of a scene.

    By Cycles every picture has one to three lamps without size, which cast hard shadows, and no two
    pictures have the same first one. Light adds up, so a sum of renders is a render.
    """
    rng = np.random.default_rng(np.random.SeedSequence([seed, 77]))
    if renderer == "own":
        scene = make_scene(kind, size=size, lights=count, held_out=1, seed=seed)
        linear = scene.images
    else:
        linear, scene = _by_cycles(kind, renderer, seed, rng, size, count, threads)
    assert scene.segments is not None
    return View(np.stack([exposed(picture, rng) for picture in linear]), scene.segments)


def codes(linear: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    """What an 8-bit sRGB file holds of pictures."""
    return np.round(255 * encode_srgb(np.clip(linear, 0, 1))).astype(np.uint8)


def camera(linear: Array) -> NDArray[np.float64]:
    """What an 8-bit sRGB file keeps of a picture, decoded again."""
    return decode_srgb(codes(linear) / 255)


def _by_cycles(
    kind: str,
    renderer: Renderer,
    seed: int,
    rng: np.random.Generator,
    size: int,
    count: int,
    threads: int,
) -> tuple[Array, Scene]:
    from pbrfit_evaluation import cycles

    def rendered(light: Literal["points", "panorama"], samples: int | None) -> Scene:
        return cycles.render_scene(
            draw(kind, np.random.default_rng(seed)),
            size,
            light=light,
            transport="shadows" if light == "points" else "full",
            lights=count,
            held_out=1,
            seed=seed,
            samples=samples,
            threads=threads,
        )

    scene = rendered("points", None)
    lamps = _equal(np.asarray(scene.images, np.float64))
    if renderer == "cycles-full":
        even = _equal(np.asarray(rendered("panorama", PANORAMA_SAMPLES).images, np.float64))
    else:
        even = _equal(np.repeat(lamps.mean(axis=0, keepdims=True), count, axis=0))
    pictures = []
    for i in range(count):
        others = rng.choice(np.delete(np.arange(count), i), rng.integers(LAMPS), replace=False)
        chosen = [i, *others]
        lit = sum(rng.uniform(0.5, 1) * lamps[j] for j in chosen) / len(chosen)
        fill = rng.uniform(*FILL)
        pictures.append((1 - fill) * lit + fill * even[i])
    return np.stack(pictures), scene


def _equal(pictures: Array) -> Array:
    """Of equal brightness: a tenth of each is brighter than 1."""
    bright = np.quantile(pictures.mean(axis=-1).reshape(len(pictures), -1), 0.9, axis=1)
    return np.asarray(pictures / bright[:, None, None, None])


def exposed(picture: Array, rng: np.random.Generator) -> Array:
    """As a camera would: 3 % of the pixels above 0.6 to 1.1 of white."""
    bright = np.quantile(picture.mean(axis=-1), 0.97)
    return np.asarray(rng.uniform(0.6, 1.1) / max(float(bright), 1e-9) * picture)
