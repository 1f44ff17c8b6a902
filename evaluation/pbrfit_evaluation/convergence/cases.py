"""The scenes that solvers run on: sizes, noise, and how well the lights determine the fit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pbrfit.model.reflection import Model, chosen_model, render, sh_basis
from pbrfit.scene.arrays import Truth
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import make_scene
from pbrfit.synthetic.exposure import MEAN_RADIANCE
from pbrfit.synthetic.lights import SHARP, even_directions, zonal
from pbrfit_evaluation.suite import Options

Array = NDArray[np.float64]

Lights = Literal["spread", "typical", "alike", "nearly one"]
"""How the training lights differ: from evenly spread lobes to almost the same light 16 times."""

LIGHTS: tuple[Lights, ...] = get_args(Lights)
PICTURES = 16

BLEND: dict[Lights, float] = {"typical": 1.0, "alike": 0.1, "nearly one": 0.01}
"""What is left of a light's difference from the mean light."""


@dataclass(frozen=True)
class Case:
    """A kind of scene; seeds make scenes of it.

    Attributes
    ----------
    name
        Fit for files and tables.
    size
        Width and height of the pictures, pixels.
    noise
        Standard deviation of the Gaussian noise, as a share of the mean radiance.
    lights
        Which training lights. The held-out lights are always typical ones.
    model
        That pictures are rendered with and that is fitted.
    """

    name: str
    size: int
    noise: float
    lights: Lights
    model: Model = "paper"

    @property
    def title(self) -> str:
        """For tables and plots."""
        noise = f"noise {100 * self.noise:g} %" if self.noise else "no noise"
        return f"{self.size}², {noise}, lights {self.lights}"


def make(case: Case, seed: int) -> Scene:
    """Make a room of the case, 16 training and 16 held-out pictures.

    "typical" lights are those of `pbrfit.synthetic`: a key light and fills of several colours with
    an ambient term. With their mean L̄, L̄ + ε (L − L̄) has a condition number about 1/ε times as
    large, and stays positive as a mean of positive lights: "alike" has ε = 0.1, "nearly one" 0.01.
    "spread" lights are one white lobe a picture, evenly over the sphere: close to the best that
    positive light of l ≤ 3 allows, because the sharpest such lobe has a sixteenth of its band 0 in
    band 3.
    """
    scene = make_scene(
        "room", size=case.size, lights=PICTURES, held_out=PICTURES, seed=seed, model=case.model
    )
    truth, images, lighting = scene.truth, scene.images, true_lighting(scene)
    assert truth is not None
    if case.lights == "spread":
        truth, images = _lit_evenly(scene, truth)
    elif case.lights != "typical":
        share = BLEND[case.lights]
        # Radiance is linear in the light, so the pictures blend as the lights do.
        lighting, images = (
            whole.mean(axis=0) + share * (whole - whole.mean(axis=0))
            for whole in (lighting, images)
        )
        truth = replace(truth, lighting=lighting)
    if case.noise:
        rng = np.random.default_rng([seed, round(1e6 * case.noise)])
        images = images + rng.normal(scale=case.noise * MEAN_RADIANCE, size=images.shape)
    return replace(scene, images=images, truth=truth)


def true_lighting(scene: Scene) -> Array:
    """Lights of the scene's pictures, (N, 16, 3), which it was made with."""
    assert scene.truth is not None
    assert scene.truth.lighting is not None
    return scene.truth.lighting


def _lit_evenly(scene: Scene, truth: Truth) -> tuple[Truth, Array]:
    """The scene under spread lights, in the same mean radiance."""
    lobes = zonal(SHARP[3]) * sh_basis(even_directions(PICTURES))
    lighting = np.repeat(lobes[..., None], 3, axis=-1)
    images = render(
        *(truth.materials, scene.normals, lighting, scene.fov),
        model=chosen_model(None, scene.model),
    )
    exposure = MEAN_RADIANCE / images.mean()
    return replace(truth, lighting=exposure * lighting), exposure * images


CASES = {
    case.name: case
    for case in (
        Case("typical-32", 32, 0.0, "typical"),
        Case("typical-64", 64, 0.0, "typical"),
        Case("typical-128", 128, 0.0, "typical"),
        Case("typical-512", 512, 0.0, "typical"),
        Case("noise-64", 64, 0.01, "typical"),
        Case("spread-64", 64, 0.0, "spread"),
        Case("nearly-one-64", 64, 0.0, "nearly one"),
        Case("alike-noise-64", 64, 0.01, "alike"),
        Case("typical-24", 24, 0.0, "typical"),
        Case("alike-noise-24", 24, 0.01, "alike"),
    )
}
"""By name; the last two are those of `--quick`."""


def chosen(options: Options) -> list[Case]:
    """The cases of a run."""
    return [replace(CASES[name], model=options.model) for name in options.cases]
