"""Write docs/images/furnished.png: rooms of the kind furnished, their maps, and one with textures.

    python tools/room_sheet.py FILE [TEXTURES]

TEXTURES is a folder of texture maps for the last column; without it, its detail is procedural.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from pbrfit.io.color import encode_srgb
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import make_scene

SEEDS, SIZE, HEADER = (101, 104, 12, 60), 150, 18
TITLES = ("furnished", "albedo", "roughness", "metallic", "detailed")


def picture(scene: Scene) -> NDArray[Any]:
    """Encode the first picture, exposed so that few of its pixels clip."""
    image = scene.images[0]
    return encode_srgb(image * 0.9 / np.percentile(image, 97))


def main(file: Path, textures: Path | None) -> None:
    """Render and write the sheet."""
    sheet = Image.new("RGB", (len(TITLES) * SIZE, HEADER + len(SEEDS) * SIZE), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(12)
    for column, title in enumerate(TITLES):
        draw.text(((column + 0.5) * SIZE, 2), title, fill="black", font=font, anchor="ma")
    for row, seed in enumerate(SEEDS):
        plain = make_scene("furnished", size=SIZE, lights=4, held_out=1, seed=seed)
        fine = make_scene("detailed", size=SIZE, lights=4, held_out=1, seed=seed, textures=textures)
        assert plain.truth is not None
        maps = plain.truth.materials
        grey = [np.repeat(m[..., None], 3, axis=-1) for m in (maps.roughness, maps.metallic)]
        cells = [picture(plain), encode_srgb(maps.albedo), *grey, picture(fine)]
        for column, cell in enumerate(cells):
            levels = np.round(255 * np.clip(cell, 0, 1)).astype(np.uint8)
            sheet.paste(Image.fromarray(levels), (column * SIZE, HEADER + row * SIZE))
    sheet.save(file, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else None)
