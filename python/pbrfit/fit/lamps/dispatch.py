"""Whether a scene is fitted under lamps, and that fit; normals and height from pictures alone."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.fit.lamps.decision import choose
from pbrfit.fit.lamps.estimator import FirstShape, check_near, fit_lamps
from pbrfit.fit.whole_picture import FitOutput, FitSetup
from pbrfit.scene.integration import depth_from_normals
from pbrfit.scene.scene import Scene

log = logging.getLogger("pbrfit")

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Decided:
    """What was decided about the light of a scene."""

    found: FitOutput | None
    """The fit under lamps; None where light comes from all around."""
    scene: Scene
    """With normals, where it had none."""
    why: str


def fit_if_lit(scene: Scene, setup: FitSetup) -> Decided:
    """Fit a scene under lamps, if that is asked for or explains its pictures better.

    Raises
    ------
    InputError
        If lamps are asked for and cannot be fitted, or normals are missing and cannot be found.
    """
    asked = setup.options.light
    if asked == "sh" and scene.normals_known:
        return Decided(None, scene, "not asked for")
    check_light(scene, setup)
    start = None if scene.normals_known else first_shape(scene)
    for said in () if start is None else start.undetermined:
        log.warning("normals: %s", said)
    lamps, why = asked == "lamps", "asked for" if asked == "lamps" else "not asked for"
    if asked == "auto":
        choice = choose(scene, setup, start)
        lamps, why = choice.lamps, choice.why
    if not lamps:
        if start is not None:
            scene = replace(scene, normals=start.normals, normals_known=True)
        return Decided(None, scene, why)
    found = fit_lamps(scene, setup, start)
    if start is not None:
        found = replace(found, height=height_of(found.normals, scene))
        scene = replace(scene, normals=found.normals, normals_known=True)
    return Decided(found, scene, why)


def check_light(scene: Scene, setup: FitSetup) -> None:
    """Raise InputError if lamps are asked for, or known, and cannot be fitted."""
    if setup.options.light == "lamps" and scene.lighting is not None:
        raise InputError("light: expected unknown light for lamps, found known SH light")
    check_near(scene)


def first_shape(scene: Scene) -> FirstShape:
    """Normals, and directions of the lamps, that the pictures of a scene tell by themselves."""
    # Here and not above: scipy would double the time of `import pbrfit`.
    from pbrfit.fit.lamps.start import start_of_known_lamps, start_of_unknown_lamps

    images = np.stack([scene.picture(i, slice(None)) for i in range(len(scene.images))])
    usable = np.broadcast_to(scene.valid[..., None], images.shape).copy()
    if scene.weights is not None:
        usable &= scene.weights > 0
    images = np.where(usable, images, 0.0).astype(np.float64)
    if scene.limits is not None:
        usable &= scene.limits == 0
    known = scene.lamps
    if known is not None and not known.near.any() and len(known) == len(images):
        colors = known.colors if known.colored else None
        found = start_of_known_lamps(images, usable, scene.valid, scene.views, known.places, colors)
        note = "normals by known lamps"
    else:
        found = start_of_unknown_lamps(images, usable, scene.valid, scene.views, scene.fov)
        note = "normals and far lamps by the pictures"
    return FirstShape(
        found.normals,
        found.directions,
        found.strengths,
        found.albedo,
        "; ".join([note, *found.undetermined]),
        tuple(found.undetermined),
    )


def height_of(normals: Array, scene: Scene) -> NDArray[np.float32]:
    """(H, W): height towards the viewer in pixels, about 0 in the mean; NaN outside the mask."""
    depth = depth_from_normals(normals, 0.0, scene.valid, scene.segments)
    height = -depth.astype(np.float64) * scene.width / 2
    return np.asarray(height - np.nanmean(height), np.float32)
