"""Normals, and a height, that pictures alone tell, where a fit begins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.lamps.samples import FirstShape
from pbrfit.scene.arrays import every_channel
from pbrfit.scene.integration import depth_from_normals
from pbrfit.scene.scene import Scene
from pbrfit.values.arrays import Array, Mask

FOV_MEAN, FOV_SPREAD, FOV_MAX = 10.0, 12.0, 75.0
"""Degrees of what is likely before: who takes pictures of an object stands back, and cuts out what
is around it."""


def first_shape(scene: Scene, threads: int = 0) -> FirstShape:
    """Normals, and directions of the lamps, that the pictures of a scene tell by themselves."""
    # Here and not above: scipy would double the time of `import pbrfit`.
    from pbrfit.fit.lamps.start import start_of_known_lamps, start_of_unknown_lamps

    count = range(len(scene.images))
    images = [scene.picture(i, slice(None)).astype(np.float32, copy=False) for i in count]
    valid = every_channel(scene.valid)

    def counted(i: int) -> Mask:
        weights = scene.channel_weights(i)
        return valid if weights is None else valid & (weights > 0)

    usable = [counted(i) for i in count]
    seen = scene if scene.fov_known else scene.through(FOV_MEAN)
    known, pictures = scene.lamps, (images, usable, scene.valid, seen.views)
    if known is not None and not known.near.any() and len(known) == len(images):
        colors = known.colors if known.colored else None
        found = start_of_known_lamps(*pictures, known.places, colors, threads=threads)
        note = "normals by known lamps"
    else:
        fov = scene.fov if scene.fov_known else 0.0
        found = start_of_unknown_lamps(*pictures, fov, threads=threads)
        note = "normals and far lamps by the pictures"
    return replace(found, note="; ".join([note, *found.undetermined]))


def height_of(normals: Array, scene: Scene, threads: int = 0) -> NDArray[np.float32]:
    """(H, W): height towards the viewer in pixels, about 0 in the mean; NaN outside the mask."""
    depth = depth_from_normals(normals, 0.0, scene.valid, scene.segments, threads=threads)
    height = -depth.astype(np.float64) * scene.width / 2
    return np.asarray(height - np.nanmean(height), np.float32)
