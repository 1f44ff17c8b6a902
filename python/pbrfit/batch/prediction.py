"""How much memory a scene will take, from the heads of its files: no picture is decoded."""

from __future__ import annotations

import math
import re
import struct
import warnings
from pathlib import Path

import numpy as np
from PIL import Image, ImageSequence

from pbrfit._core import image_format
from pbrfit.fit import memory
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.io import images, raw_files
from pbrfit.io.depth_files import DEPTH_FILES
from pbrfit.io.input_files import open_file
from pbrfit.io.resampling import reduced_size
from pbrfit.io.weight_files import WEIGHT_FILE
from pbrfit.result.options import FitOptions
from pbrfit.result.refinement import PICTURES_MIN
from pbrfit.scene.folder import ScenePath, locate
from pbrfit.scene.options import ReadOptions

DECODING_BYTES = 64
"""Bytes a pixel of a file, at most, while it is read and averaged."""

_HEAD = 1 << 20
"""Bytes of an EXR or HDR file in which its size is sought."""


def of_scene(
    scene: ScenePath, reading: ReadOptions, options: FitOptions, threads: int = 0
) -> memory.FitMemory:
    """What reading and fitting a scene needs at most, beside the interpreter and its libraries.

    Of what no head tells, the dearer is assumed: no pixel is masked, no picture is grey, integer
    pictures have clipped samples. Raises InputError or OSError if there is no scene, or its first
    picture cannot be read.
    """
    files = locate(scene)
    folder, paths = files.folder, files.pictures
    full = picture_size(paths[0])
    if reading.crop is not None:
        full = min(full[0], reading.crop[3]), min(full[1], reading.crop[2])
    height, width = full if reading.max_size is None else reduced_size(full, reading.max_size)
    pixels, pictures = height * width, len(paths)
    integers = any(path.suffix.lower() not in (".exr", ".hdr") for path in paths)
    layout = ParameterLayout(
        valid=np.broadcast_to(np.True_, (height, width)),
        segments=None,
        segment_count=0,
        pictures=pictures,
        channels=3,
        coefficients=(options.sh_order + 1) ** 2,
        light_channels=1 if options.mono_light else 3,
        metallic_known=options.metallic is not None,
        lighting_known=(folder / "lighting.json").exists(),
        weighted=integers or (folder / WEIGHT_FILE).exists(),
    )
    # Pictures and weights in float32, limits, normals in float64, how far off they may be, depth.
    of_samples = 12 + 4 * (folder / WEIGHT_FILE).exists() + 3 * integers
    of_maps = 4 * sum((folder / name).exists() for name in ("normals.exr", *DEPTH_FILES))
    held = pixels * (pictures * of_samples + 24 + of_maps)
    refining = options.refine_normals != "off" and pictures >= PICTURES_MIN
    depth = any((folder / name).exists() for name in DEPTH_FILES)
    found = memory.plan(
        layout,
        options.solver,
        held=held,
        refine_normals=refining,
        optional=options.refine_normals == "auto",
        transport=options.transport if depth else "none",
        model=options.model or "principled",  # the dearer one
        threads=threads,
    ).needed
    stored = images.file_of(paths[0]).stat().st_size  # more than a picture of it, if it is a stack
    reading_takes = held + DECODING_BYTES * full[0] * full[1] + stored
    return found if found.peak >= reading_takes else memory.FitMemory(reading_takes, 0)


def picture_size(path: Path) -> tuple[int, int]:
    """(height, width) of a picture as it is stored: before it is turned as EXIF says.

    Raises InputError or OSError if it cannot be read.
    """
    stored = images.file_of(path)
    with open_file(stored) as file:
        head = file.read(_HEAD)
    kind = image_format(head)
    if raw_files.is_raw(path, head, kind):
        return raw_files.size(path)
    found = None
    if kind == "EXR":
        found = _of_exr(head)
    elif kind == "HDR":
        stated = re.search(rb"\n\n-Y (\d{1,9}) \+X (\d{1,9})\n", head)
        found = stated and (int(stated[1]), int(stated[2]))
    elif kind is not None:
        found = _of_raster(stored)
    if found is not None and min(found) > 0:
        return found
    height, width = images.read_picture(path).pixels.shape[:2]  # such as TIFF of floats
    return height, width


def _of_raster(path: Path) -> tuple[int, int] | None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about large pictures, and damage that is told later
        try:
            with open_file(path) as file, Image.open(file) as picture:
                pages = ImageSequence.Iterator(picture) if picture.format == "TIFF" else [picture]
                return max(((page.height, page.width) for page in pages), key=math.prod)
        except Exception:  # forms that Pillow does not know, or whatever damage leads to
            return None


def _of_exr(head: bytes) -> tuple[int, int] | None:
    """From `displayWindow`; an attribute is name, type, length and value (openexr.com)."""
    found = re.search(rb"\0displayWindow\0box2i\0\x10\0\0\0(.{16})", head, re.DOTALL)
    if found is None:
        return None
    left, top, right, bottom = struct.unpack("<4i", found[1])
    return bottom - top + 1, right - left + 1
