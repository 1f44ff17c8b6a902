"""One view under many lights, as a camera shows it; and pictures damaged on purpose.

Damage is what generators do: move, bend, paint over. All works on linear radiance (H, W, 3).
Lengths are in pixels at a longer side of 512 and grow with the picture.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pbrfit.io.color import decode_srgb, encode_srgb
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import draw, make_scene
from pbrfit_evaluation.arrays import Array, Floats, Mask, known

Kind = Literal["shift", "warp", "recolour", "recolour-object", "clone", "fill", "texture"]
KINDS: tuple[Kind, ...] = get_args(Kind)
"""Moved as a whole; bent smoothly; an area, or one object, in another colour of about the same
brightness; an area replaced by another part of the picture, filled smoothly from around it, or
under coloured stripes in the light that was there."""

REPAINTS: tuple[Kind, ...] = KINDS[2:]

SHIFT = (2.0, 8.0)
WARP = (3.0, 8.0)
AREA = (0.02, 0.05)
OBJECT = (0.02, 0.25)
SEEN = 0.08
"""Mean change of sRGB values in a repainted area, below which it does not count as repainted."""

CHANGED = 0.05
"""... and the change above which a pixel counts; `AREA[0]` of the picture must."""

_TRIES = 200


def damaged(
    image: Floats, kind: Kind, segments: NDArray[Any] | None, rng: np.random.Generator
) -> tuple[Array, dict[str, float]]:
    """A picture (H, W, 3), linear with white = 1, damaged in a way.

    `segments` (H, W) are ids of objects, 0 = none. Returns it, and how much was done to it: pixels,
    or share of the area and change.
    """
    unit = max(image.shape[:2]) / 512
    if kind == "shift":
        angle, length = rng.uniform(0, 2 * np.pi), rng.uniform(*SHIFT)
        whole = np.full(image.shape[:2], unit * length)
        found = moved(image, np.sin(angle) * whole, np.cos(angle) * whole)
        return found, {"pixels": length}
    if kind == "warp":
        width, length = unit * rng.uniform(25, 60), rng.uniform(*WARP)
        field = bent(image.shape[:2], width, unit * length, rng)
        return moved(image, *field), {"pixels": length, "width": width}
    for _ in range(_TRIES):
        area = _area(kind, known(segments), rng)
        found = _repainted(image, area, kind, rng)
        change = np.abs(_shown(found) - _shown(image)).mean(axis=-1)
        seen = np.count_nonzero(change[area] > CHANGED) >= AREA[0] * area.size
        if seen and change[area].mean() > SEEN:
            return found, {"area": float(area.mean()), "change": float(change[area].mean())}
    raise ValueError(f"{kind}: expected a place where a repaint can be seen, found none")


def _shown(image: Floats) -> Array:
    return encode_srgb(np.clip(image, 0, 1))


def bent(shape: tuple[int, ...], width: float, most: float, rng: np.random.Generator) -> Array:
    """(2, H, W): smooth fields by which pixels move down and right, at most so far."""
    from scipy.ndimage import gaussian_filter

    field = np.stack([gaussian_filter(rng.normal(size=shape), width) for _ in range(2)])
    return np.asarray(field * (most / np.hypot(*field).max()))


def moved(image: Floats, down: Array, right: Array) -> Array:
    """Move a picture (H, W, 3) by fields of pixels (H, W); cubic, its edge repeated."""
    from scipy.ndimage import map_coordinates

    row, column = np.mgrid[: image.shape[0], : image.shape[1]]
    places = [row - down, column - right]
    planes = [map_coordinates(image[..., c], places, order=3, mode="nearest") for c in range(3)]
    return np.asarray(np.stack(planes, axis=-1).clip(0))


def _area(kind: Kind, segments: NDArray[Any], rng: np.random.Generator) -> Mask:
    """Where to paint: an object, else a rounded patch."""
    from scipy.ndimage import gaussian_filter

    height, width = segments.shape
    if kind == "recolour-object":
        ids, counts = np.unique(segments[segments > 0], return_counts=True)
        shares = counts / segments.size
        fit = ids[(shares >= OBJECT[0]) & (shares <= OBJECT[1])]
        if fit.size:
            return np.asarray(segments == rng.choice(fit))
    share = rng.uniform(*AREA)
    ragged = gaussian_filter(rng.normal(size=segments.shape), 0.05 * max(height, width))
    row, column = np.mgrid[:height, :width]
    centre = rng.uniform(0.12, 0.88, 2) * (height, width)
    distance = np.hypot(row - centre[0], column - centre[1])
    outline = distance / np.sqrt(share * height * width / np.pi) + 0.35 * ragged / ragged.std()
    return np.asarray(outline < np.quantile(outline, share))


def _repainted(image: Floats, area: Mask, kind: Kind, rng: np.random.Generator) -> Array:
    from scipy.ndimage import gaussian_filter

    unit = max(image.shape[:2]) / 512

    def smooth(plane: Floats, width: float) -> Array:
        return np.asarray(gaussian_filter(plane, unit * width))

    if kind in ("recolour", "recolour-object"):
        gain = np.exp(rng.uniform(-0.9, 0.9, 3))
        new = image * gain / gain.mean()
    elif kind == "clone":
        away = [rng.integers(side // 8, side - side // 8) for side in image.shape[:2]]
        new = np.roll(image, away, axis=(0, 1))
    elif kind == "fill":
        around = smooth((~area).astype(np.float64), 25) + 1e-6
        new = np.stack([smooth(image[..., c] * ~area, 25) / around for c in range(3)], axis=-1)
        new *= 1 + rng.normal(scale=0.02, size=new.shape)
    else:
        light = smooth(image.mean(axis=-1), 15)[..., None]
        row, column = np.mgrid[: image.shape[0], : image.shape[1]]
        angle, period = rng.uniform(0, np.pi), unit * rng.uniform(8, 30)
        along = column * np.cos(angle) + row * np.sin(angle)
        stripe = (np.sin(2 * np.pi * along / period) > 0)[..., None]
        colors = rng.uniform(0.3, 1.7, (2, 3))
        new = light * np.where(stripe, *colors)
    soft = smooth(area.astype(np.float64), 0.8)[..., None]
    return np.asarray((image * (1 - soft) + new * soft).clip(0))


Renderer = Literal["own", "cycles", "cycles-full"]
"""Our forward model under SH lights; Cycles, lamps with hard shadows and even light; the same, with
panoramas and interreflections in place of the even light."""

FILL = (0.1, 0.5)
"""Share of the even light, or of the panorama, in a picture by Cycles."""

LAMPS = 3
"""At most so many lamps in one picture by Cycles."""

PANORAMA_SAMPLES = 64
"""Light paths a pixel; the noise, 3 to 6 %, stays in the pictures."""


def relights(
    kind: str,
    renderer: Renderer,
    seed: int,
    *,
    size: int,
    count: int,
    threads: int = 1,
) -> Scene:
    """A scene with `count` pictures, linear, exposed: white = 1, brighter values there.

    By Cycles every picture has one to three lamps without size, which cast hard shadows, and no two
    pictures have the same first one. Light adds up, so a sum of renders is a render.
    """
    rng = np.random.default_rng(np.random.SeedSequence([seed, 77]))
    if renderer == "own":
        scene = make_scene(kind, size=size, lights=count, held_out=1, seed=seed)
        linear = scene.images
    else:
        linear, scene = _by_cycles(kind, renderer, seed, rng, size, count, threads)
    return replace(scene, images=np.stack([exposed(picture, rng) for picture in linear]))


def codes(linear: Floats) -> NDArray[np.uint8]:
    """What an 8-bit sRGB file holds of pictures."""
    return np.round(255 * encode_srgb(np.clip(linear, 0, 1))).astype(np.uint8)


def camera(linear: Floats) -> Array:
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
