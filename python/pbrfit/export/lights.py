"""The lights of a result as files that other tools read: panoramas and coefficients."""

from __future__ import annotations

import csv
import math
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pbrfit.export.nonnegative import nonnegative_radiance, surface_response
from pbrfit.io import images
from pbrfit.model import panorama
from pbrfit.model.lighting import Lighting
from pbrfit.result.result import Result
from pbrfit.threads import one_blas_thread
from pbrfit.values.arrays import Array
from pbrfit.values.quoting import cell

HEIGHT = 64
"""Rows of a panorama. Nothing in l ≤ 3 is finer than 20 of them; what linear interpolation between
pixels takes from l = 3 is h²/8 · 9 = 0.3 % at most, h = π/64 being their distance."""

FILES = {
    "lighting.json": "the lights as pbrfit keeps them (formats.md)",
    "panoramas.csv": "which panorama is whose, and how much differently it lights",
}


@dataclass(frozen=True)
class LightPanorama:
    """The panorama of a light."""

    picture: str
    """Whose light it is."""
    file: str
    """Its name in the folder of lights."""
    difference: float
    """By how much the surfaces look different under it than under the light, whose SH part may be
    negative in places: RMS, relative to all that they show; 0 where it is not."""


def write_lights(folder: Path, result: Result) -> tuple[LightPanorama, ...]:
    """Write all of `FILES` and a panorama a light into an existing folder."""
    lighting = Lighting(result.pictures, result.lighting, result.lamps)
    response = surface_response(result)
    lighting.save(folder / "lighting.json")
    soft = Lighting(result.pictures, result.sh_lighting())
    of_lamps = _lamps_as_texels(result)
    panoramas = []
    names = file_names(lighting.pictures)
    lights = zip(lighting.pictures, names, lighting.coefficients, soft.coefficients, strict=True)
    for picture, name, ambient, whole in lights:
        with one_blas_thread():  # the same bits whatever the processor count
            radiance, difference = nonnegative_radiance(ambient, response, HEIGHT, whole)
        radiance += of_lamps.get(picture, 0.0)
        file = f"{name}.exr"
        radiance = np.minimum(radiance, np.finfo(np.float32).max)
        images.write_exr(folder / file, {c: radiance[..., i] for i, c in enumerate("RGB")})
        panoramas.append(LightPanorama(picture, file, difference))
    with (folder / "panoramas.csv").open("w", newline="", encoding="utf-8") as table:
        writer = csv.writer(table)
        writer.writerow(["picture", "file", "relit_difference"])
        writer.writerows(
            [cell(of.picture), cell(of.file), f"{of.difference:.6f}"] for of in panoramas
        )
    return tuple(panoramas)


def _lamps_as_texels(result: Result) -> dict[str, Array]:
    """Panoramas of the lamps alone by picture, as the middle of the surface sees them.

    A lamp of irradiance E = π · colour is E over a solid angle: it is shared among the four texels
    about its direction, linearly, so that their mean is that direction.
    """
    found: dict[str, Array] = {}
    if result.lamps is None:
        return found
    angles = panorama.solid_angles(HEIGHT, 2 * HEIGHT)
    for i, direction, color in zip(result.lamps.pictures, *result.lamps_seen(), strict=True):
        shown = found.setdefault(result.pictures[i], np.zeros((HEIGHT, 2 * HEIGHT, 3)))
        x, y, z = direction.tolist()
        # The inverse of `panorama.directions`, whose texels have their centres half way.
        row = HEIGHT * (0.5 - math.asin(max(-1.0, min(1.0, y))) / math.pi) - 0.5
        column = HEIGHT * (1 - math.atan2(x, z) / math.pi) + HEIGHT - 0.5
        top, left = math.floor(row), math.floor(column)
        for down, right in np.ndindex(2, 2):
            share = abs(1 - down - row + top) * abs(1 - right - column + left)
            at = top + down
            beyond = not 0 <= at < HEIGHT  # a pole, behind which the other side goes on
            at = min(max(at, 0), HEIGHT - 1)
            texel = at, (left + right + beyond * HEIGHT) % (2 * HEIGHT)
            shown[texel] += share * math.pi * color / angles[at]
    return found


def file_names(pictures: Sequence[str]) -> tuple[str, ...]:
    """Names of pictures as names of files, without suffix, which no file system confuses.

    Windows reserves some names, and file systems take 255 bytes, the suffix among them. Windows and
    macOS tell neither cases nor ways to write an accent apart.
    """
    names: list[str] = []
    taken: set[str] = set()
    for picture in pictures:
        name = re.sub(r'[<>:"/\\|?*\x00-\x1f]', "_", picture)
        name = name.encode()[:200].decode(errors="ignore").strip(". ") or "light"
        if re.fullmatch(r"(?i)con|prn|aux|nul|(com|lpt)\d", name.partition(".")[0].rstrip()):
            name = f"_{name}"
        unique, count = name, 2
        while _folded(unique) in taken:
            unique, count = f"{name}_{count}", count + 1
        taken.add(_folded(unique))
        names.append(unique)
    return tuple(names)


def _folded(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()
