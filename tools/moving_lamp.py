"""Loops of a result under a lamp that moves, beside pictures and the maps: for the gallery."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from pbrfit import DirectionalLight, Result, relight
from pbrfit.display.tone import encoded
from pbrfit.result import metrics

SECONDS = 3.36
"""Time that the lamp takes to go round."""

SOFTNESS = 6.0
"""Angular radius of the lamp in degrees."""

FILL = 0.05
"""Radiance of the faint environment light; a white surface under the lamp alone has 1."""

SWEEP = (65.0, 25.0, 22.0)
"""The lamp goes round an ellipse: degrees to each side, mean elevation, degrees up and down."""

BULB = 9
"""Radius of the lamp in the dial, in pixels."""

GROUND = (27, 29, 32)
INK = (200, 197, 191)
GAP = 12
CAPTION = 30
"""Height of the line below a panel."""

Pixels = NDArray[np.floating[Any]]
Captioned = tuple[str, Image.Image]


def frames_of(
    result: Result,
    pictures: Sequence[Pixels],
    names: Sequence[str],
    *,
    count: int,
    height: int,
) -> list[Image.Image]:
    """A result under a lamp that goes round once, beside two pictures and the maps.

    Parameters
    ----------
    pictures
        (H, W, 3) linear radiance, as large as the maps.
    names
        What stands below them.
    count
        Of frames.
    height
        Of the relit surface, in pixels.
    """
    lights = [lamp(2 * math.pi * i / count) for i in range(count)]
    around = np.zeros((16, 3))
    around[0] = FILL * math.sqrt(4 * math.pi)  # of the constant harmonic
    faint = relight(result, around)
    relit = [relight(result, light) + faint for light in lights]
    white = float(np.median([white_of(one) for one in relit]))
    half = (height - GAP - CAPTION) // 2
    maps = dict(maps_of(result, height=half))
    given = [shown(radiance(one, white_of(one)), result.mask, height=half) for one in pictures]
    grid = [[*zip(names, given, strict=True), ("albedo", maps["albedo"])]]
    grid += [[(name, maps[name]) for name in ("roughness", "metallic", "normals")]]
    return [
        frame(shown(radiance(linear, white), result.mask, height=height), light, grid)
        for light, linear in zip(lights, relit, strict=True)
    ]


def save(frames: Sequence[Image.Image], path: Path, quality: int) -> None:
    """A loop, as WebP."""
    frames[0].save(
        path,
        save_all=True,
        append_images=frames[1:],
        duration=round(1000 * SECONDS / len(frames)),
        loop=0,
        quality=quality,
        method=4,
    )


def lamp(phase: float) -> DirectionalLight:
    """The lamp at a phase of its way round."""
    aside, middle, up = SWEEP
    return DirectionalLight(
        -aside * math.cos(phase), middle + up * math.sin(phase), softness=SOFTNESS
    )


def frame(
    surface: Image.Image, light: DirectionalLight, grid: list[list[Captioned]]
) -> Image.Image:
    """The relit surface with the lamp's dial, and two rows of small pictures to its right."""
    wide = grid[0][0][1].width
    columns = len(grid[0])
    width = surface.width + columns * wide + (columns + 2) * GAP
    height = surface.height
    canvas = Image.new("RGB", (width, height + CAPTION + GAP), GROUND)
    canvas.paste(surface, (GAP, GAP))
    dial(canvas, light)
    foot = GAP + height + CAPTION / 2
    write(canvas, "under a lamp of your own", (GAP + surface.width / 2, foot))
    top = GAP
    for row in grid:
        at = surface.width + 2 * GAP
        for caption, picture in row:
            canvas.paste(picture, (at, top))
            middle = (at + wide / 2, top + picture.height + CAPTION / 2)
            write(canvas, caption, middle)
            at += wide + GAP
        top += row[0][1].height + CAPTION + GAP
    return canvas


def dial(canvas: Image.Image, light: DirectionalLight) -> None:
    """A hemisphere seen from the camera, in the corner, and the lamp on it."""
    radius = 38
    x, y = GAP + radius + 4, GAP + radius + 4
    draw = ImageDraw.Draw(canvas)
    draw.ellipse((x - radius, y - radius, x + radius, y + radius), outline=(90, 92, 96), width=2)
    right, up, _ = light.direction
    at = (x + radius * right, y - radius * up)
    for grown, color in ((BULB, (120, 84, 36)), (BULB - 3, (255, 214, 140))):
        box = (at[0] - grown, at[1] - grown, at[0] + grown, at[1] + grown)
        draw.ellipse(box, fill=color)


def box_of(mask: NDArray[np.bool_], border: int = 6) -> tuple[slice, slice]:
    """Rows and columns that the mask fills, with a border."""
    spans = []
    for axis in (1, 0):
        at = np.flatnonzero(mask.any(axis=axis))
        spans.append(slice(max(0, at[0] - border), at[-1] + 1 + border))
    return spans[0], spans[1]


def shown(values: Pixels, mask: NDArray[np.bool_], *, height: int) -> Image.Image:
    """Values in [0, 1] as they go to the screen, (H, W) or (H, W, 3), cut to the mask."""
    rgb = np.broadcast_to(values[..., None] if values.ndim == 2 else values, (*mask.shape, 3))
    codes = np.where(mask[..., None], np.nan_to_num(rgb).clip(0, 1) * 255, GROUND)
    picture = Image.fromarray(np.round(codes[box_of(mask)]).astype(np.uint8))
    width = round(picture.width * height / picture.height)
    return picture.resize((width, height), Image.Resampling.LANCZOS)


def radiance(linear: Pixels, white: float) -> Pixels:
    """Linear radiance as it goes to the screen; `white` is nearly white there, and none clips."""
    return encoded(0.8 * np.nan_to_num(linear) / white, tone_map="neutral")


def maps_of(result: Result, *, height: int) -> list[Captioned]:
    """Albedo, roughness, metallic, normals."""
    maps = {
        "albedo": encoded(np.nan_to_num(result.albedo)),
        "roughness": result.roughness,
        "metallic": result.metallic,
        "normals": result.normals / 2 + 0.5,
    }
    return [(name, shown(values, result.mask, height=height)) for name, values in maps.items()]


def white_of(picture: Pixels) -> float:
    """Radiance that is to be shown as white."""
    return metrics.white_of(picture)


def write(canvas: Image.Image, text: str, middle: tuple[float, float], size: int = 15) -> None:
    """A caption about a point."""
    font = ImageFont.load_default(size)
    ImageDraw.Draw(canvas).text(middle, text, fill=INK, font=font, anchor="mm")
