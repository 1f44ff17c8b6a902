"""Some pictures held out: how well materials explain what they were not fitted to.

The pictures of a scene are split. Materials come from the kept ones. For each held-out picture only
its light is fitted, 48 numbers for all pixels together, and what is left is the error of the
materials (and of the model). Real pictures have no other ground truth to compare with.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import Model, render
from pbrfit.result import metrics
from pbrfit.result.result import Result
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.real.lights import best_combination, fit_lights, nearest
from pbrfit_evaluation.real.matt import best_light, unknown_lamps
from pbrfit_evaluation.recipes import explain

Explanation = Literal[
    "default",
    "plain",
    "paper",
    "lambertian",
    "start",
    "constant",
    "rank-three",
    "nearest",
    "combination",
]
EXPLANATIONS: tuple[Explanation, ...] = get_args(Explanation)

IN_WORDS: dict[Explanation, str] = {
    "default": "our default",
    "plain": "ours without priors",
    "paper": "paper's recipe",
    "lambertian": "default's albedo, r = 1, m = 0",
    "start": "our start",
    "constant": "constant guess",
    "rank-three": "Lambert, rank 3",
    "nearest": "nearest picture",
    "combination": "sum of kept pictures",
}
"""The constant guess is the start's mean albedo with r = 0.5 and m = 0."""

FITTED: tuple[Literal["default", "plain", "paper"], ...] = ("default", "plain", "paper")
"""Recipes that are fitted; the others only change what these found or begin with."""

OF_KEPT_PICTURES: tuple[Explanation, ...] = ("rank-three", "nearest", "combination")
"""Those without materials."""

SHARE = 4
"""One picture in so many is held out."""

LEAST_KEPT = 2


@dataclass(frozen=True)
class Split:
    """Indices of the pictures that are fitted and of those that are not."""

    kept: tuple[int, ...]
    held_out: tuple[int, ...]


def split(pictures: int, held_out: int | None = None, fold: int = 0) -> Split:
    """Hold out every s-th picture, beginning with number `fold`; s = pictures // held_out.

    Parameters
    ----------
    pictures
        How many there are, at least 3.
    held_out
        How many are held out; None = a quarter, at least 1.
    fold
        Below `folds(pictures, held_out)`: no picture is held out in two folds.

    Raises
    ------
    InputError
        If fewer than two would be kept.
    """
    count = _held_out(pictures, held_out)
    step = pictures // count
    if not 0 <= fold < step:
        raise InputError(f"fold: expected a number from 0 to {step - 1}, found {fold}")
    out = tuple(range(fold, step * count, step))
    return Split(tuple(i for i in range(pictures) if i not in out), out)


def folds(pictures: int, held_out: int | None = None) -> int:
    """How many splits there are in which no picture is held out twice."""
    return pictures // _held_out(pictures, held_out)


def _held_out(pictures: int, held_out: int | None) -> int:
    count = max(1, pictures // SHARE) if held_out is None else held_out
    if count < 1 or pictures - count < LEAST_KEPT:
        raise InputError(
            f"held-out pictures: expected 1 or more and {LEAST_KEPT} to keep, "
            f"found {count} of {pictures}"
        )
    return count


@dataclass(frozen=True)
class PictureScore:
    """How well one held-out picture is explained.

    Attributes
    ----------
    name
        Of the picture.
    rms
        Root mean square of the picture, in its units.
    rmse
        Root mean square error, likewise. Both without samples of weight 0.
    psnr, ssim
        In sRGB, exposed so that the picture's 98th percentile is white.
    """

    name: str
    rms: float
    rmse: float
    psnr: float
    ssim: float


@dataclass(frozen=True, eq=False)
class Explained:
    """One way to explain the held-out pictures.

    Attributes
    ----------
    explanation
        Which one.
    scores
        One for each held-out picture.
    kept_error
        RMSE relative to the RMS of the kept pictures, their lights fitted in the same way; None
        where it would be 0 by construction.
    seconds
        Of the fit of materials, 0 without one.
    materials
        None without any.
    rendered
        (M, H, W, 3): the held-out pictures as explained, NaN outside the mask.
    """

    explanation: Explanation
    scores: tuple[PictureScore, ...]
    kept_error: float | None
    seconds: float
    materials: Materials | None
    rendered: NDArray[np.float64]


def relative_error(scores: tuple[PictureScore, ...]) -> float:
    """RMSE relative to the RMS of several pictures together; NaN if they are black."""
    error, signal = (
        math.fsum(getattr(score, name) ** 2 for score in scores) for name in ("rmse", "rms")
    )
    return math.sqrt(error / signal) if signal > 0 else math.nan


def part(scene: Scene, pictures: tuple[int, ...]) -> Scene:
    """Scene of some of the pictures."""
    of = list(pictures)
    return replace(
        scene,
        images=scene.images[of],
        weights=None if scene.weights is None else scene.weights[of],
        limits=None if scene.limits is None else scene.limits[of],
        file_noise=None if scene.file_noise is None else tuple(scene.file_noise[i] for i in of),
        names=tuple(scene.names[i] for i in of),
        lighting=None,
        lamps=None if scene.lamps is None else scene.lamps.of_pictures(pictures),
        truth=None,
        assumed={},
        inputs={},
        source=None,
    )


def explain_held_out(
    scene: Scene,
    which: Split,
    *,
    model: Model | None = None,
    iterations: int = 500,
    threads: int = 0,
) -> tuple[Explained, ...]:
    """Explain the held-out pictures in every way of `EXPLANATIONS`.

    Parameters
    ----------
    scene
        All pictures, with unknown lights.
    which
        From `split`.
    model
        As for `pbrfit.decompose`; of all explanations that have materials.
    iterations
        Of the fits of materials.
    threads
        0 = one for each processor.
    """
    kept = part(scene, which.kept)
    by = partial(explain, kept, model=model, threads=threads)
    fitted = {name: by(name, iterations=iterations) for name in FITTED}
    default, start = fitted["default"], by("start")
    maps: dict[Explanation, tuple[Materials, Result, float]] = {
        **{name: (fit.materials, fit, fit.seconds) for name, fit in fitted.items()},
        "lambertian": (_same(default.materials, roughness=1.0), default, 0.0),
        "start": (start.materials, start, 0.0),
        "constant": (_constant(start.materials), start, 0.0),
    }
    found = []
    for name, (materials, fit, seconds) in maps.items():
        rendered, of_kept = (
            explained_by(materials, scene, pictures, threads, model=fit.model, normals=fit.normals)
            for pictures in (which.held_out, which.kept)
        )
        found.append(
            Explained(
                name,
                picture_scores(scene, which.held_out, rendered),
                relative_error(picture_scores(scene, which.kept, of_kept, looks=False)),
                seconds,
                materials,
                rendered,
            )
        )
    for name, rendered in _of_kept_pictures(kept, scene, which).items():
        scores = picture_scores(scene, which.held_out, rendered)
        found.append(Explained(name, scores, None, 0.0, None, rendered))
    return tuple(found)


def _of_kept_pictures(
    kept: Scene, scene: Scene, which: Split
) -> dict[Explanation, NDArray[np.float64]]:
    """(M, H, W, 3): the held-out pictures as the kept ones explain them, without materials."""
    valid = kept.valid
    basis = unknown_lamps(kept.images[:, valid].astype(np.float64))
    ways: dict[Explanation, Callable[..., NDArray[np.float64]]] = {
        "rank-three": partial(best_light, basis),
        "nearest": partial(nearest, kept.images),
        "combination": partial(best_combination, kept.images),
    }
    return {
        name: np.stack(
            [way(scene.images[i], scene.channel_weights(i), valid) for i in which.held_out]
        )
        for name, way in ways.items()
    }


def explained_by(
    materials: Materials,
    scene: Scene,
    pictures: tuple[int, ...],
    threads: int = 0,
    *,
    model: Model,
    normals: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """(M, H, W, 3): some pictures of a scene as the materials explain them, lights fitted.

    `model` and `normals` are those that belong to the materials; None = the scene's normals.
    """
    normals = np.asarray(scene.normals, np.float64) if normals is None else normals
    of = list(pictures)
    each = [scene.channel_weights(i) for i in pictures]
    weights = None if each[0] is None else np.stack([one for one in each if one is not None])
    lights = fit_lights(scene.images[of], weights, materials, normals, scene.fov, model)
    return render(materials, normals, lights, scene.fov, threads, model=model)


def picture_scores(
    scene: Scene,
    pictures: tuple[int, ...],
    rendered: NDArray[np.float64],
    *,
    looks: bool = True,
) -> tuple[PictureScore, ...]:
    """Errors of some pictures of a scene as explained, (M, H, W, 3).

    Without `looks`, PSNR and SSIM are NaN.
    """
    scores = []
    for i, found in zip(pictures, rendered, strict=True):
        weights = scene.channel_weights(i)
        counted = np.isfinite(found)
        if weights is not None:
            counted &= weights > 0
        true = np.where(counted, scene.images[i].astype(np.float64), np.nan)
        psnr = ssim = np.nan
        if looks:
            white = metrics.white_of(true)
            pair = metrics.display(found, white), metrics.display(true, white)
            psnr, ssim = metrics.psnr(*pair), metrics.ssim(*pair)
        scores.append(
            PictureScore(
                scene.names[i],
                metrics.rmse(true, np.zeros_like(true)),
                metrics.rmse(found, true),
                psnr,
                ssim,
            )
        )
    return tuple(scores)


def _same(materials: Materials, *, roughness: float) -> Materials:
    """The same albedo on a dielectric of one roughness."""
    valid = np.isfinite(materials.roughness)
    return replace(
        materials,
        roughness=np.where(valid, roughness, np.nan),
        metallic=np.where(valid, 0.0, np.nan),
    )


def _constant(start: Materials) -> Materials:
    valid = np.isfinite(start.roughness)
    mean = start.albedo[valid].mean(axis=0)
    even = replace(start, albedo=np.where(valid[..., None], mean, np.nan))
    return _same(even, roughness=0.5)
