"""Ways to explain a scene that suites compare: ours, the paper's recipe, and guesses."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.fit.decompose import decompose
from pbrfit.fit.settings import MEAN_RADIANCE
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import Model, chosen_model, render
from pbrfit.result.options import Priors
from pbrfit.result.refinement import RefineNormals
from pbrfit.result.result import Result
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.scores import score

Array = NDArray[np.float64]

Recipe = Literal["plain", "default", "paper", "paper-priors", "constant", "start"]
RECIPES: tuple[Recipe, ...] = get_args(Recipe)

IN_WORDS: dict[Recipe, str] = {
    "plain": "ours without priors",
    "default": "our default",
    "paper": "paper's recipe",
    "paper-priors": "paper's recipe, its priors",
    "constant": "constant guess",
    "start": "our start",
}

OTHER: dict[Model, Model] = {"paper": "principled", "principled": "paper"}
"""By a model the one that it is not."""

PAPER_PRIORS = Priors(material=0.0, cohesion=0.1, smoothness=0.03, sparsity=1e-5, monochrome=1e-4)
"""The four priors of the paper, which gives no weights. Each alone, these lowered the errors of
noisy rooms of seeds 2000 and 2001 with true segments; ten times the sparsity raises that of albedo.
"""


def fit(scene: Scene, **options: Any) -> Result:
    """`pbrfit.decompose` with the normals as they are: what comparisons of solvers and priors do.

    `options` are those of `pbrfit.decompose`.
    """
    return decompose(scene, refine_normals="off", **options)


def lit_anew(scene: Scene, materials: Materials, lighting: Array, relight_lighting: Array) -> Scene:
    """A synthetic scene with other materials, and under other lights (N, 16, 3), without noise.

    Its pictures have the usual mean radiance, and lights and held-out pictures that exposure.
    """
    assert scene.truth is not None
    model = chosen_model(None, scene.model)
    rendered = partial(render, materials, scene.normals, fov=scene.fov, model=model)
    images = rendered(lighting)
    exposure = MEAN_RADIANCE / np.nanmean(images)
    lighting, relight_lighting = exposure * lighting, exposure * relight_lighting
    truth = replace(
        scene.truth,
        materials=materials,
        lighting=lighting,
        relight_images=rendered(relight_lighting),
        relight_lighting=relight_lighting,
    )
    return replace(scene, images=exposure * images, truth=truth)


def within(maps: Materials, valid: NDArray[np.bool_]) -> Materials:
    """Maps that were found as the materials of a scene: in [0, 1], NaN outside of `valid`."""

    def kept(plane: NDArray[np.floating[Any]]) -> Array:
        where = valid if plane.ndim == 2 else valid[..., None]
        return np.where(where, np.clip(plane.astype(np.float64), 0, 1), np.nan)

    return Materials(kept(maps.albedo), kept(maps.roughness), kept(maps.metallic))


def fit_and_score(scene: Scene, threads: int, **options: Any) -> tuple[Result, dict[str, Any]]:
    """`fit`, and the errors of what it finds, with its seconds: what a record keeps."""
    result = fit(scene, threads=threads, **options)
    return result, score(result, scene, threads).as_json()


def explain(
    scene: Scene,
    recipe: Recipe,
    *,
    iterations: int = 500,
    sh_order: int = 3,
    refine_normals: RefineNormals = "off",
    model: Model | None = None,
    threads: int = 0,
) -> Result:
    """Explain a scene by one of the recipes.

    Parameters
    ----------
    scene
        With ground truth for `"constant"`.
    recipe
        `"default"`: `pbrfit.decompose` as it is. `"plain"`: the same without priors. `"paper"`: one
        run of L-BFGS-B from `paper_start`, without priors. `"paper-priors"`: the same with
        `PAPER_PRIORS`. `"constant"`: `constant_guess` with the lights that fit it best. `"start"`:
        where the default starts, lights fitted.
    iterations
        Of all but the last two.
    sh_order, threads
        As for `pbrfit.decompose`.
    refine_normals
        Likewise, but for `"default"` and `"plain"` alone: the paper and guesses take normals as
        they are. "off", other than there, so that recipes compare.
    model
        As for `pbrfit.decompose`; the paper's recipe too is run with any model.
    """
    common = partial(decompose, scene, sh_order=sh_order, model=model, threads=threads)
    ours = partial(common, iterations=iterations, refine_normals=refine_normals)
    fixed = partial(common, refine_normals="off", light="sh", uncertainty=False)
    by_lbfgsb = partial(fixed, solver="lbfgsb", iterations=iterations)
    match recipe:
        case "default":
            return ours()
        case "plain":
            return ours(priors=None)
        case "paper":
            return by_lbfgsb(start=paper_start(scene), priors=None)
        case "paper-priors":
            return by_lbfgsb(start=paper_start(scene), priors=PAPER_PRIORS)
        case "constant":
            return fixed(iterations=0, start=constant_guess(scene), priors=None)
        case "start":
            return fixed(iterations=0, priors=None)


def paper_start(scene: Scene) -> Materials:
    """Our reading of the paper, which does not say where it starts.

    Albedo is the mean picture (with the weights of its samples), exposed to a mean of 0.4 and
    clipped to [0, 1]; roughness 0.5, metallic 0.1.
    """
    pixels = int(np.count_nonzero(scene.valid))
    total, counts = np.zeros((pixels, 3)), np.zeros((pixels, 3))
    for i in range(len(scene.images)):
        # What has no weight, or is clipped, is not known: it is left out of the mean, unless there
        # is nothing else.
        weights = np.ones((pixels, 3))
        given = scene.channel_weights(i)
        if given is not None:
            weights = np.maximum(given[scene.valid].astype(np.float64), np.finfo(np.float32).tiny)
        total += weights * scene.samples(i)
        counts += weights
    mean = total / counts
    albedo = np.empty((*scene.valid.shape, 3))
    albedo[scene.valid] = np.clip(mean * (MEAN_RADIANCE / mean.mean()), 0.0, 1.0)
    return _constant(scene, albedo, 0.5, 0.1)


def constant_guess(scene: Scene) -> Materials:
    """The same dielectric everywhere: roughness 0.5, metallic 0, albedo the mean of the truth.

    No map at all does as well as this one in albedo without knowing the truth, so a method that
    does worse has recovered nothing.

    Raises
    ------
    InputError
        Without ground truth.
    """
    if scene.truth is None:
        raise InputError("scene: expected ground truth for a constant guess, found none")
    return _constant(scene, scene.truth.materials.albedo[scene.valid].mean(axis=0), 0.5, 0.0)


def _constant(scene: Scene, albedo: Array, roughness: float, metallic: float) -> Materials:
    return Materials(
        albedo=np.where(scene.valid[..., None], albedo, np.nan),
        roughness=np.where(scene.valid, roughness, np.nan),
        metallic=np.where(scene.valid, metallic, np.nan),
    )
