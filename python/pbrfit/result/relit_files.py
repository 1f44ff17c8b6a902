"""Relit pictures as files: linear EXR, PNG for a screen, folders of frames, animations."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, PngImagePlugin

from pbrfit.display import tone
from pbrfit.display.tone import ToneMap
from pbrfit.io import images
from pbrfit.values.arrays import Array, Codes

Radiance = Array
"""(H, W, 3) linear Rec.709; NaN outside the mask."""

NEARLY_BLACK = 8
"""Codes up to this are hard to tell from black."""

ANIMATIONS = {".gif": "GIF", ".webp": "WEBP", ".png": "PNG"}
"""Pillow's names of animated formats."""


def write_exr(path: Path, radiance: Radiance) -> None:
    """Write linear Rec.709 float32: R, G, B, and A where there is a mask; 0 outside it."""
    inside = np.asarray(np.isfinite(radiance).all(axis=-1))
    largest = float(np.finfo(np.float32).max)
    pixels = np.clip(np.where(inside[..., None], radiance, 0.0), -largest, largest)
    channels: dict[str, NDArray[Any]] = {name: pixels[..., c] for c, name in enumerate("RGB")}
    if not inside.all():
        channels["A"] = inside.astype(np.float64)
    images.write_exr(path, channels)


def write_animation(path: Path, kind: str, frames: Iterable[Codes], fps: float) -> None:
    """Write frames of `Screen.shown` that are repeated for ever; WebP and PNG are lossless.

    `kind` is a key of `ANIMATIONS`, whatever the path is called. GIF holds each frame for a whole
    number of hundredths of a second.
    """
    pictures = (Image.fromarray(frame) for frame in frames)
    first = next(pictures)
    options: dict[str, Any] = {"duration": round(1000 / fps)}
    if kind == ".gif":
        options = {"duration": 10 * round(100 / fps), "disposal": 2}
    elif kind == ".webp":
        options["lossless"] = True
        if first.mode == "RGBA":
            # Every frame whole: cropped to a mask that is a rectangle, frames have no transparent
            # pixel left, and the file then says that it has no alpha.
            options |= {"kmin": 1, "kmax": 1}
    else:
        options["pnginfo"] = PngImagePlugin.PngInfo()
        options["pnginfo"].add(b"sRGB", b"\0")  # perceptual, as the other PNG files say
    # Pillow goes through the frames of a PNG twice.
    others = list(pictures) if kind == ".png" else pictures
    # Opened here: Pillow leaves a file that it opened itself open when a frame fails.
    with path.open("w+b") as file:
        first.save(file, ANIMATIONS[kind], save_all=True, append_images=others, loop=0, **options)


@dataclass
class Screen:
    """Encodes radiance for a screen, and keeps account of what that cost."""

    exposure: float = 0.0
    tone_map: ToneMap = "neutral"
    """As for `tone.encoded`."""
    clipped: int = 0
    black: int = 0
    pixels: int = 0
    """Pixels so far with a channel at 255, with none above `NEARLY_BLACK`, and all."""

    def shown(self, radiance: Radiance) -> Codes:
        """(H, W, 3) sRGB codes; (H, W, 4) where there is a mask, 0 outside it."""
        inside = np.isfinite(radiance).all(axis=-1)
        codes = tone.codes(tone.encoded(radiance, self.exposure, self.tone_map))
        largest = codes[..., :3].max(axis=-1)[inside]
        self.pixels += largest.size
        self.clipped += int(np.sum(largest == 255))
        self.black += int(np.sum(largest <= NEARLY_BLACK))
        return codes
