"""Normals, and a height, by nothing but pictures under lamps."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.fit.lamps.estimator import check_light, fit_lamps
from pbrfit.fit.lamps.shape import first_shape, height_of
from pbrfit.fit.run import FitSetup, Progress
from pbrfit.model.lamps import Lamps
from pbrfit.model.reflection import chosen_model, whole_number
from pbrfit.registration.placement import aligned
from pbrfit.result.options import FitOptions
from pbrfit.scene.arrays import SHAPE_PICTURES_MIN
from pbrfit.scene.scene import Scene

Array = NDArray[np.float64]


class PictureNormals(NamedTuple):
    """What pictures tell of shape."""

    normals: Array
    """(H, W, 3), NaN outside the mask."""
    sigma_degrees: Array
    """(H, W): how uncertain they are by noise and by the lamps, both tangent offsets together."""
    height: NDArray[np.float32]
    """(H, W), as in `Result`."""
    lamps: Lamps
    undetermined: tuple[str, ...]
    """What the pictures leave open, each in words."""


def normals_from_pictures(
    scene: Scene, *, threads: int = 0, progress: Callable[[Progress], None] | None = None
) -> PictureNormals:
    """Fit a scene without normals under lamps.

    Raises
    ------
    InputError
        If the scene has normals, fewer than three pictures, known SH light, or near lamps without
        depth.
    """
    if scene.normals_known:
        raise InputError("normals: expected none, which the pictures are to tell, found some")
    count = len(scene.images)
    if count < SHAPE_PICTURES_MIN:
        raise InputError(
            f"images: expected {SHAPE_PICTURES_MIN} or more pictures under different lamps, found "
            f"{count}"
        )
    began = time.perf_counter()
    options = FitOptions(light="lamps", model=chosen_model(None, scene.model), uncertainty=True)
    scene = aligned(scene)
    setup = FitSetup(options, whole_number("threads", threads), progress, began)
    check_light(scene, setup)
    start = first_shape(scene)
    found = fit_lamps(scene, setup, start)
    assert found.lamps is not None
    assert found.normal_sigma is not None
    height = height_of(found.normals, scene)
    return PictureNormals(
        found.normals, found.normal_sigma, height, found.lamps, start.undetermined
    )
