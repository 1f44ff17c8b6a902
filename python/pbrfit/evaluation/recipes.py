"""Ways to explain a scene that suites compare: our default, the paper's recipe, and guesses."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.materials import Materials
from pbrfit.objective import MEAN_RADIANCE
from pbrfit.result import Result
from pbrfit.scene import Scene
from pbrfit.solve import decompose

Recipe = Literal["default", "paper", "constant", "start"]
RECIPES: tuple[Recipe, ...] = get_args(Recipe)

IN_WORDS: dict[Recipe, str] = {
    "default": "our default",
    "paper": "paper's recipe",
    "constant": "constant guess",
    "start": "our start",
}


def explain(
    scene: Scene, recipe: Recipe, *, iterations: int = 500, sh_order: int = 3, threads: int = 0
) -> Result:
    """Explain a scene by one of the recipes.

    Parameters
    ----------
    scene
        With ground truth for `"constant"`.
    recipe
        `"default"`: `pbrfit.decompose` as it is. `"paper"`: one run of L-BFGS-B from
        `paper_start`. `"constant"`: `constant_guess` with the lights that fit it best. `"start"`:
        where the default starts, lights fitted.
    iterations
        Of `"default"` and `"paper"`.
    sh_order, threads
        As for `pbrfit.decompose`.
    """
    if recipe == "default":
        return decompose(scene, iterations=iterations, sh_order=sh_order, threads=threads)
    if recipe == "paper":
        return decompose(
            scene,
            start=paper_start(scene),
            iterations=iterations,
            sh_order=sh_order,
            threads=threads,
        )
    start = constant_guess(scene) if recipe == "constant" else None
    return decompose(scene, start=start, iterations=0, sh_order=sh_order, threads=threads)


def paper_start(scene: Scene) -> Materials:
    """Our reading of the paper, which does not say where it starts.

    Albedo is the mean picture, exposed to a mean of 0.4 and clipped to [0, 1]; roughness 0.5,
    metallic 0.1.
    """
    pictures = range(len(scene.images))
    mean = np.mean([scene.samples(i) for i in pictures], axis=0, dtype=np.float64)
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


def _constant(
    scene: Scene, albedo: NDArray[np.float64], roughness: float, metallic: float
) -> Materials:
    return Materials(
        albedo=np.where(scene.valid[..., None], albedo, np.nan),
        roughness=np.where(scene.valid, roughness, np.nan),
        metallic=np.where(scene.valid, metallic, np.nan),
    )
