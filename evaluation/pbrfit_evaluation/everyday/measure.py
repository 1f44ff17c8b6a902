"""One scene after one disturbance, fitted with all defaults."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.decompose import decompose
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import chosen_model, render
from pbrfit.result import metrics
from pbrfit.result.options import FitOptions
from pbrfit.result.result import Result
from pbrfit.result.sheet import displayed
from pbrfit_evaluation.everyday.disturbances import (
    Array,
    Disturbance,
    Disturbed,
    Floats,
    Kind,
    NotRunError,
    disturbed,
)
from pbrfit_evaluation.panels import of_maps, packed
from pbrfit_evaluation.scores import score

CHANNELS = ("red", "green", "blue")

PICTURED: tuple[Disturbance, ...] = ("noise", "jpeg-90-420", "jpeg-75-420", "clipped", "shifted")
"""Disturbances whose maps are shown."""


@dataclass(frozen=True)
class Case:
    """A scene after a disturbance. `picture`: whether its maps are kept."""

    disturbance: Disturbance
    kind: Kind
    seed: int
    size: int
    picture: bool = False

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"{self.disturbance}_{self.kind}_{self.seed}"


def run(case: Case, _: int) -> dict[str, Any]:
    """Errors, processor seconds, the scale and what is said of the field of view; or why not run.

    One thread, so that processor seconds compare.
    """
    try:
        made = disturbed(case.disturbance, case.kind, case.seed, case.size)
    except NotRunError as error:
        return {"not_run": str(error)}
    scene = made.scene
    before = time.process_time()
    result = decompose(scene, threads=1, refine_normals=FitOptions().refine_normals)
    seconds = time.process_time() - before
    found: dict[str, Any] = {
        "scores": score(result, scene, 1).as_json(),
        "seconds": seconds,
        "refined": result.refinement.refined,
        "scale": _scale(result, made),
        "fov": {
            "degrees": result.fov,
            "error": abs(result.fov - made.fov),
            "said": result.assumed.get("fov"),
            "contradicted": contradicted(result),
        },
    }
    if case.picture:
        found["maps"] = maps(result, made)
        if case.disturbance == "noise":
            found["truth"] = true_maps(made)
    return found


def contradicted(result: Result) -> bool:
    """Whether the fit says that the field of view is another one than the scene has."""
    return result.camera is not None and result.camera.contradicted


def scale_errors(result: Result, made: Disturbed) -> Array:
    """(3,): relative error of the scale of the lights in each channel, which albedo undoes.

    True materials under the lights that were found are s times the pictures without noise, in least
    squares; the error is s − 1. To first order that is the number whose standard deviation is
    `Uncertainty.albedo_scale`.
    """
    truth = made.scene.truth
    assert truth is not None
    model = chosen_model(None, made.scene.model)
    lit = render(truth.materials, made.scene.normals, result.lighting, made.fov, 1, model=model)
    kept = [made.scene.names.index(name) for name in result.pictures]  # some may be left out
    expected = made.expected[kept]
    if result.camera is not None and result.camera.correction is not None:
        # Lights are those of pictures that it has undone.
        expected = result.camera.correction.applied(expected)
    used = np.isfinite(expected) & made.scene.valid[..., None]
    lit, expected = (np.where(used, of, 0.0) for of in (lit, expected))
    axes = (0, 1, 2)
    return np.asarray((lit * expected).sum(axis=axes) / np.square(expected).sum(axis=axes) - 1)


def _scale(result: Result, made: Disturbed) -> dict[str, dict[str, float]]:
    assert result.uncertainty is not None
    pairs = zip(scale_errors(result, made), result.uncertainty.albedo_scale, strict=True)
    return {
        channel: {"error": float(error), "deviation": float(deviation)}
        for channel, (error, deviation) in zip(CHANNELS, pairs, strict=True)
    }


# ------------------------------------------------------------------------------------- pictures


def maps(result: Result, made: Disturbed) -> dict[str, Any]:
    """Panels of a scene for a record: its pictures cut to a window, and the maps found."""
    number, rows, columns = window(made)
    expected, given = (of[number] for of in (made.expected, made.scene.images))
    at = np.ix_(rows, columns)
    return _panels(expected[at], given[at], metrics.white_of(expected), result.materials)


def true_maps(made: Disturbed) -> dict[str, Any]:
    """The same with a whole picture and the true maps."""
    assert made.scene.truth is not None
    expected, given = made.expected[0], made.scene.images[0]
    return _panels(expected, given, metrics.white_of(expected), made.scene.truth.materials)


def _panels(expected: Floats, given: Floats, white: float, of: Materials) -> dict[str, Any]:
    pictures = {"undisturbed": displayed(expected, white), "given": displayed(given, white)}
    return packed(pictures | of_maps(of))


def window(made: Disturbed) -> tuple[int, NDArray[np.intp], NDArray[np.intp]]:
    """Number of the picture that has changed most; rows and columns where most of it has.

    They are those of half its sides, each twice, so that they make a picture of the same size.
    """
    from scipy.ndimage import uniform_filter

    change = np.nan_to_num(np.abs(made.scene.images - made.expected)).sum(axis=-1)
    number = int(change.sum(axis=(1, 2)).argmax())
    sides = change.shape[1:]
    halves = [-(-side // 2) for side in sides]
    # A filter of h samples is centred h // 2 behind its first one: only windows that are whole.
    whole = tuple(
        slice(half // 2, half // 2 + side - half + 1)
        for half, side in zip(halves, sides, strict=True)
    )
    sums = uniform_filter(change[number], halves)[whole]
    first = np.unravel_index(int(sums.argmax()), sums.shape)
    rows, columns = (at + np.arange(side) // 2 for at, side in zip(first, sides, strict=True))
    return number, rows, columns
