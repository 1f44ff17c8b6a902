"""Ways to explain a scene that suites compare: ours, the paper's recipe, and guesses."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from pbrfit._core import InputError
from pbrfit.fit.decompose import Start, decompose
from pbrfit.fit.settings import MEAN_RADIANCE
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import Model, chosen_model, render
from pbrfit.result.options import Priors
from pbrfit.result.result import Result
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.arrays import Array, known

OTHER: dict[Model, Model] = {"paper": "principled", "principled": "paper"}
"""By a model the one that it is not."""

PAPER_PRIORS = Priors(material=0.0, cohesion=0.1, smoothness=0.03, sparsity=1e-5, monochrome=1e-4)
"""The four priors of the paper, which gives no weights. Each alone, these lowered the errors of
noisy rooms of seeds 2000 and 2001 with true segments; ten times the sparsity raises that of albedo.
"""


def lit_anew(scene: Scene, materials: Materials, lighting: Array, relight_lighting: Array) -> Scene:
    """A synthetic scene with other materials, and under other lights (N, 16, 3), without noise.

    Its pictures have the usual mean radiance, and lights and held-out pictures that exposure.
    """
    model = chosen_model(None, scene.model)
    rendered = partial(render, materials, scene.normals, fov=scene.fov, model=model)
    images = rendered(lighting)
    exposure = MEAN_RADIANCE / np.nanmean(images)
    lighting, relight_lighting = exposure * lighting, exposure * relight_lighting
    truth = replace(
        known(scene.truth),
        materials=materials,
        lighting=lighting,
        relight_images=rendered(relight_lighting),
        relight_lighting=relight_lighting,
    )
    return replace(scene, images=exposure * images, truth=truth)


@dataclass(frozen=True)
class Way:
    """A way to explain a scene: `pbrfit.decompose`, by some options, from some start."""

    words: str
    """In tables; empty where there is but one way."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Of `pbrfit.decompose`."""
    start: Callable[[Scene], Start] | None = None
    """Of a scene, where the fit starts, perhaps with lights; None = where it starts by itself."""
    guess: bool = False
    """Whether nothing is fitted but the lights."""

    def explain(self, scene: Scene, **common: Any) -> Result:
        """Fit a scene by the options, which take precedence over those that ways have in common.

        Normals are as they are unless options say otherwise, so that ways compare.
        """
        start = None if self.start is None else self.start(scene)
        return decompose(scene, start=start, **{"refine_normals": "off", **common, **self.options})


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
    return _constant(scene, albedo, 0.1)


def constant_guess(scene: Scene) -> Materials:
    """The same dielectric everywhere: roughness 0.5, metallic 0, albedo the mean of the truth.

    No map at all does as well as this one in albedo without knowing the truth, so a method that
    does worse has recovered nothing.

    Raises InputError without ground truth.
    """
    if scene.truth is None:
        raise InputError("scene: expected ground truth for a constant guess, found none")
    return _constant(scene, scene.truth.materials.albedo[scene.valid].mean(axis=0), 0.0)


def _constant(scene: Scene, albedo: Array, metallic: float) -> Materials:
    shape = scene.valid.shape
    maps = np.broadcast_to(albedo, (*shape, 3)), np.full(shape, 0.5), np.full(shape, metallic)
    return Materials(*maps).within(scene.valid)


_BARE: Mapping[str, Any] = {
    "priors": None,
    "refine_normals": "off",
    "light": "sh",
    "uncertainty": False,
}
_LBFGSB: Mapping[str, Any] = {**_BARE, "solver": "lbfgsb"}

DEFAULT = Way("our default")
PAPER = Way("paper's recipe", _LBFGSB, paper_start)
PAPER_REGULARIZED = Way(
    "paper's recipe, its priors", {**_LBFGSB, "priors": PAPER_PRIORS}, paper_start
)
GUESS = Way("constant guess", {**_BARE, "iterations": 0}, constant_guess, guess=True)
