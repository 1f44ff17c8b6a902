"""Our fit under lamps, and the light of another picture on what it found."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.decompose import decompose
from pbrfit.fit.lamps.picture_light import fit_picture_light
from pbrfit.model.reflection import render_lamps
from pbrfit.result.result import Result
from pbrfit.scene.scene import Scene

Array = NDArray[np.float64]


def fit(scene: Scene, *, iterations: int, threads: int) -> Result:
    """Materials, normals and lamps of pictures; lamps that the scene has are known.

    Raises
    ------
    InputError
        If the pictures cannot be used.
    """
    return decompose(
        scene, light="lamps", iterations=iterations, threads=threads, refine_normals="auto"
    )


def relit(
    result: Result,
    picture: NDArray[np.floating[Any]],
    weights: NDArray[np.floating[Any]] | None,
    direction: Array | None,
    threads: int,
) -> Array:
    """(H, W, 3): another picture of the same view as a result explains it, its light alone fitted.

    Parameters
    ----------
    picture
        (H, W, 3) linear radiance.
    weights
        (H, W, 3) how much each sample counts; None = all the same.
    direction
        (3,) unit vector to the picture's lamp; None = unknown.
    """
    lamps, ambient = fit_picture_light(result, picture, weights, direction)
    shown = render_lamps(
        result.materials,
        result.normals,
        lamps,
        ambient[None],
        result.fov,
        threads=threads,
        model=result.model,
    )
    return np.asarray(shown[0])
