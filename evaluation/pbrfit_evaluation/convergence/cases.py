"""The scenes that solvers run on: clean, noisy, stiff, of another model, and real ones."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pbrfit.model.materials import Materials
from pbrfit.model.reflection import Model
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import MEAN_RADIANCE, make_scene
from pbrfit_evaluation.convergence.measure import held_out_errors, measure
from pbrfit_evaluation.heldout.measure import split
from pbrfit_evaluation.heldout.sources import find_sources, opened
from pbrfit_evaluation.recipes import OTHER, known
from pbrfit_evaluation.suite import Options

Array = NDArray[np.float64]

Lights = Literal["typical", "alike"]
"""How the training lights differ."""

PICTURES = 16

ALIKE = 0.1
"""What is left of a light's difference from the mean light, where lights are alike."""


@dataclass(frozen=True)
class Case:
    """A kind of scene; seeds make scenes of it."""

    name: str
    """Fit for files and tables."""
    size: int
    """Width and height of the pictures, pixels."""
    noise: float = 0.0
    """Standard deviation of the Gaussian noise, as a share of the mean radiance."""
    lights: Lights = "typical"
    """Which training lights. The held-out lights are always typical ones."""
    model: Model = "paper"
    """That is fitted, and that pictures are rendered with."""
    misfit: bool = False
    """Whether they are rendered with the other model."""
    folder: Path | None = None
    """Of real pictures, whose truth nobody knows; `size` is then their longer side."""

    @property
    def judged(self) -> Literal["recon", "held_out"]:
        """Which error tells how far a fit has come."""
        return "held_out" if self.folder else "recon"

    @property
    def floor(self) -> float:
        """Reconstruction error of the truth, 0 where nothing but rounding is in it."""
        return 0.0 if self.misfit else self.noise * MEAN_RADIANCE

    @property
    def title(self) -> str:
        """For tables and plots."""
        if self.folder:
            return f"{self.folder.name}, {self.size} pixels"
        if self.misfit:
            return f"{self.size}², pictures of the other model"
        noise = f"noise {100 * self.noise:g} %" if self.noise else "no noise"
        return f"{self.size}², {noise}, lights {self.lights}"


def make(case: Case, seed: int) -> Scene:
    """Make a room of a synthetic case, 16 training and 16 held-out pictures.

    "typical" lights are those of `pbrfit.synthetic`: a key light and fills of several colours with
    an ambient term. With their mean L̄, those that are "alike" are L̄ + ε (L − L̄), ε = `ALIKE`: the
    condition number is about 1/ε times as large, and a mean of positive lights is positive.
    """
    model = OTHER[case.model] if case.misfit else case.model
    scene = make_scene(
        "room", size=case.size, lights=PICTURES, held_out=PICTURES, seed=seed, model=model
    )
    truth, images, lighting = scene.truth, scene.images, true_lighting(scene)
    assert truth is not None
    if case.lights == "alike":
        # Radiance is linear in the light, so the pictures blend as the lights do.
        lighting, images = (
            whole.mean(axis=0) + ALIKE * (whole - whole.mean(axis=0))
            for whole in (lighting, images)
        )
        truth = replace(truth, lighting=lighting)
    if case.noise:
        rng = np.random.default_rng([seed, round(1e6 * case.noise)])
        images = images + rng.normal(scale=case.noise * MEAN_RADIANCE, size=images.shape)
    return replace(scene, images=images, truth=truth)


def true_lighting(scene: Scene) -> Array:
    """Lights of the scene's pictures, (N, 16, 3), which it was made with."""
    return known(known(scene.truth).lighting)


Errors = Callable[[Materials, Array], Mapping[str, float]]
"""Measures maps and lights (N, 16, 3)."""


def trial(case: Case, seed: int, threads: int = 0) -> tuple[Scene, Errors]:
    """The scene to fit, and what measures a fit of it.

    Of real pictures a quarter is held out, another one for each seed.
    """
    if case.folder is None:
        scene = make(case, seed)
        fitted = replace(scene, model=case.model)
        return fitted, partial(measure, fitted, threads=threads)
    [source] = find_sources(case.folder)
    whole = opened(source, case.size).scene
    which = split(len(whole.images), len(whole.images) // 4, folds=2, fold=seed % 2)
    kept = whole.of_pictures(which.kept)
    errors = partial(held_out_errors, whole, which, model=case.model)
    return kept, errors


CASES = {
    case.name: case
    for case in (
        Case("clean-128", 128),
        Case("noisy-128", 128, 0.01),
        Case("stiff-128", 128, 0.01, "alike"),
        Case("misfit-128", 128, 0.01, misfit=True),
        Case("clean-512", 512),
        Case("noisy-512", 512, 0.01),
        Case("stiff-512", 512, 0.01, "alike"),
        Case("misfit-512", 512, 0.01, misfit=True),
        Case("noisy-1024", 1024, 0.01),
        Case("clean-24", 24),
        Case("stiff-24", 24, 0.01, "alike"),
    )
}
"""By name; the last two are those of `--quick`."""


def chosen(options: Options) -> list[Case]:
    """The cases of a run, real ones last."""
    cases = [CASES[name] for name in options.cases]
    if options.real is not None:
        for size in sorted({case.size for case in cases}):
            cases.append(Case(f"real-{size}", size, folder=options.real))
    return [replace(case, model=options.model) for case in cases]
