"""A loop and a still of a result under a lamp that moves, beside pictures and the maps.

python tools/moving_lamp.py [RESULT] [--scene SCENE] [--out NAME]

writes NAME.webp and NAME.png, docs/images/moving-lamp by default. RESULT is a result folder; by
default that of the helmet, whose pictures `tools/helmet_scene.py` renders.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path

import cards
import numpy as np
from PIL import Image, ImageDraw

from pbrfit import DirectionalLight, Result, Scene, relight

ROOT = Path(__file__).resolve().parents[1]

FRAMES = 48
MILLISECONDS = 70
"""Of a frame."""

HEIGHT = 440
"""Of the relit picture, in pixels; maps are half as high."""

SOFTNESS = 6.0
"""Angular radius of the lamp in degrees."""

FILL = 0.05
"""Radiance of the faint environment light; a white surface under the lamp alone has 1."""

PICTURES = (2, 12)
"""Those shown."""

SWEEP = (65.0, 25.0, 22.0)
"""The lamp goes round an ellipse: degrees to each side, mean elevation, degrees up and down."""

STILL = 5
"""Frame of the still."""

BULB = 9
"""Radius of the lamp in the dial, in pixels."""


def main() -> None:
    """Write both."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    default = ROOT / "out" / "helmet-result"
    parser.add_argument("result", metavar="RESULT", nargs="?", type=Path, default=default)
    parser.add_argument("--scene", type=Path, default=ROOT / "out" / "helmet")
    parser.add_argument(
        "--pictures", type=int, nargs=2, default=PICTURES, help="which pictures are shown"
    )
    out = ROOT / "docs" / "images" / "moving-lamp"
    parser.add_argument("--out", type=Path, default=out, help="both files, without suffix")
    options = parser.parse_args()
    result = Result.load(options.result)
    scene = Scene.load(options.scene, max_size=max(result.mask.shape))
    pictures = [scene.images[i] for i in options.pictures]
    names = [f"one of {len(scene.images)} pictures", "another"]
    frames = frames_of(result, pictures, names)
    save(frames, options.out.with_suffix(".webp"))
    frames[STILL].save(options.out.with_suffix(".png"), optimize=True)


def frames_of(
    result: Result,
    pictures: Sequence[cards.Pixels],
    names: Sequence[str],
    *,
    count: int = FRAMES,
    height: int = HEIGHT,
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
    white = float(np.median([cards.white_of(one) for one in relit]))
    half = (height - cards.GAP - cards.CAPTION) // 2
    maps = dict(cards.maps_of(result, height=half))
    given = [
        cards.shown(cards.radiance(one, cards.white_of(one)), result.mask, height=half)
        for one in pictures
    ]
    grid = [[*zip(names, given, strict=True), ("albedo", maps["albedo"])]]
    grid += [[(name, maps[name]) for name in ("roughness", "metallic", "normals")]]
    return [
        frame(cards.shown(cards.radiance(linear, white), result.mask, height=height), light, grid)
        for light, linear in zip(lights, relit, strict=True)
    ]


def save(frames: Sequence[Image.Image], path: Path, quality: int = 80) -> None:
    """A loop, as WebP."""
    frames[0].save(
        path,
        save_all=True,
        append_images=frames[1:],
        duration=MILLISECONDS * FRAMES // len(frames),
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
    surface: Image.Image, light: DirectionalLight, grid: list[list[cards.Captioned]]
) -> Image.Image:
    """The relit surface with the lamp's dial, and two rows of small pictures to its right."""
    wide = grid[0][0][1].width
    columns = len(grid[0])
    width = surface.width + columns * wide + (columns + 2) * cards.GAP
    height = surface.height
    canvas = Image.new("RGB", (width, height + cards.CAPTION + cards.GAP), cards.GROUND)
    canvas.paste(surface, (cards.GAP, cards.GAP))
    dial(canvas, light)
    foot = cards.GAP + height + cards.CAPTION / 2
    cards.write(canvas, "under a lamp of your own", (cards.GAP + surface.width / 2, foot))
    top = cards.GAP
    for row in grid:
        at = surface.width + 2 * cards.GAP
        for caption, picture in row:
            canvas.paste(picture, (at, top))
            middle = (at + wide / 2, top + picture.height + cards.CAPTION / 2)
            cards.write(canvas, caption, middle)
            at += wide + cards.GAP
        top += row[0][1].height + cards.CAPTION + cards.GAP
    return canvas


def dial(canvas: Image.Image, light: DirectionalLight) -> None:
    """A hemisphere seen from the camera, in the corner, and the lamp on it."""
    radius = 38
    x, y = cards.GAP + radius + 4, cards.GAP + radius + 4
    draw = ImageDraw.Draw(canvas)
    draw.ellipse((x - radius, y - radius, x + radius, y + radius), outline=(90, 92, 96), width=2)
    right, up, _ = light.direction
    at = (x + radius * right, y - radius * up)
    for grown, color in ((BULB, (120, 84, 36)), (BULB - 3, (255, 214, 140))):
        box = (at[0] - grown, at[1] - grown, at[0] + grown, at[1] + grown)
        draw.ellipse(box, fill=color)


if __name__ == "__main__":
    main()
