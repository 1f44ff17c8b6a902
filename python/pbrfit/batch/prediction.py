"""How much memory a scene will take: of its pictures the first alone is decoded."""

from __future__ import annotations

import numpy as np

from pbrfit.fit import memory
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.io import images
from pbrfit.io.depth_files import DEPTH_FILES
from pbrfit.io.resampling import reduced_size
from pbrfit.io.weight_files import WEIGHT_FILE
from pbrfit.result.options import FitOptions
from pbrfit.result.refinement import PICTURES_MIN
from pbrfit.scene.folder import ScenePath, locate
from pbrfit.scene.options import ReadOptions

DECODING_BYTES = 64
"""Bytes a pixel of a file, at most, while it is read and averaged."""


def of_scene(
    scene: ScenePath, reading: ReadOptions, options: FitOptions, threads: int = 0
) -> memory.FitMemory:
    """What reading and fitting a scene needs at most, beside the interpreter and its libraries.

    Of what that does not tell, the dearer is assumed: no pixel is masked, no picture is grey,
    integer pictures have clipped samples. Raises InputError or OSError if there is no scene, or its
    first picture cannot be read.
    """
    files = locate(scene)
    folder, paths = files.folder, files.pictures
    how = reading.or_else(files.settings())
    full = how.picture(paths[0]).pixels.shape[:2]
    if how.crop is not None:
        full = min(full[0], how.crop[3]), min(full[1], how.crop[2])
    height, width = full if how.max_size is None else reduced_size(full, how.max_size)
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
