"""What the parts share: cases, solvers by name, and the objective of a result in float64."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.decompose import decompose
from pbrfit.fit.objective import Objective
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import DEFAULT_MODEL, Model, chosen_model, render
from pbrfit.result import metrics
from pbrfit.result.options import Priors
from pbrfit.result.result import Result
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import make_scene

Array = NDArray[np.float64]

Name = Literal["gauss-newton", "auto", "lbfgsb"]
AUTO: Name = "auto"
GAUSS_NEWTON: Name = "gauss-newton"
LBFGSB: Name = "lbfgsb"

FIRST_SEED = 1000
"""Rooms from here on are those of `pbrfit evaluate table1`, on which nothing was tuned."""

PICTURES = 16


@dataclass(frozen=True)
class Case:
    """A scene of a part.

    Attributes
    ----------
    part
        Its name.
    seed, size, iterations
        Of the scene, of a picture's side, and of each fit by L-BFGS-B; "auto" and "gauss-newton"
        get the same limit.
    variant
        Kind of the scene, its row of table1 or its case of the ablation; empty for a room.
    noise
        Standard deviation in radiance; None where the part has one level alone.
    """

    part: str
    seed: int
    size: int
    iterations: int
    variant: str = ""
    noise: float | None = None
    cycles_cache: Path | None = field(default=None, repr=False)

    @property
    def key(self) -> str:
        """Name of the record."""
        level = "" if self.noise is None else f"{1e3 * self.noise:g}"
        return "_".join(filter(None, (self.part, self.variant, level, str(self.seed))))


def fit(scene: Scene, solver: Name, **options: Any) -> Result:
    """Run `pbrfit.decompose` by one of the solvers, with the normals held."""
    chosen: Any = solver
    return decompose(scene, solver=chosen, refine_normals="off", **options)


def room(
    seed: int,
    size: int,
    *,
    noise: float = 0.0,
    held_out: int = PICTURES,
    model: Model = DEFAULT_MODEL,
) -> Scene:
    """Make a furnished room as in table1's base row: 16 pictures of mean radiance 0.4."""
    return make_scene(
        "furnished",
        size=size,
        lights=PICTURES,
        held_out=held_out,
        seed=seed,
        noise=noise,
        model=model,
    )


def in_float32(scene: Scene) -> Scene:
    """The scene with each sample rounded once to float32."""
    return replace(scene, images=scene.images.astype(np.float32))


def rms(scene: Scene) -> float:
    """Root mean square radiance of the pictures over the valid pixels."""
    pictures = range(len(scene.images))
    squares = [np.mean(np.square(scene.samples(i), dtype=np.float64)) for i in pictures]
    return float(np.sqrt(np.mean(squares)))


def residual(scene: Scene, result: Result, threads: int = 0) -> float:
    """RMS difference of pictures and reconstruction, rendered and compared in float64."""
    return residual_of(scene, result.materials, result.lighting, result.model, threads)


def residual_of(
    scene: Scene, materials: Materials, lighting: Array, model: Model, threads: int
) -> float:
    """Compare picture by picture: all at once would be held in float64."""
    found = [
        metrics.rmse(
            render(*(materials, scene.normals, light, scene.fov, threads), model=model), image
        )
        for light, image in zip(lighting, scene.images, strict=True)
    ]
    return float(np.sqrt(np.mean(np.square(found))))


def clean_residual(scene: Scene, result: Result, threads: int = 0) -> float:
    """RMS difference of the reconstruction and the true pictures without their noise."""
    truth = scene.truth
    assert truth is not None
    assert truth.lighting is not None

    view = scene.normals, truth.lighting, scene.fov, threads
    clean = render(truth.materials, *view, model=chosen_model(None, scene.model))
    return residual(replace(scene, images=clean), result, threads)


def objective_value(
    scene: Scene,
    result: Result,
    *,
    priors: Priors | None = None,
    robust: tuple[str, float] | None = None,
    threads: int = 0,
) -> float:
    """What the solvers minimise, at a result: data term and penalties of fixed weight.

    The scene has pictures of about the same exposure, no weights, and all unknowns are fitted. The
    material prior is 0, because it is learnt as a fit runs. A robust loss with its scale, in units
    of the scaled pictures, comes from the fast objective in float32; all else is float64.
    """
    objective = Objective(scene, threads=threads, priors=priors, model=result.model)
    materials = result.materials
    x = objective.pack(
        materials.albedo, materials.roughness, materials.metallic, result.lighting
    ).clip(*objective.bounds.T)
    penalties = objective.add_penalties(x, np.zeros_like(x))
    if robust is None:
        return (residual(scene, result, threads) / objective.scale) ** 2 + penalties
    objective.robust = robust
    return objective.data_value_and_grad(x)[0] + penalties
