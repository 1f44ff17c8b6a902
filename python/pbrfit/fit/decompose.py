"""From Scene to Result."""

from __future__ import annotations

import importlib
import logging
import math
import operator
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.fit import memory
from pbrfit.fit.plan import FitPlan
from pbrfit.fit.priors.penalties import Priors
from pbrfit.fit.robust import check_loss
from pbrfit.fit.solvers import Limits, Progress, Solver, check_solver
from pbrfit.fit.solvers.run import material_errors
from pbrfit.fit.tiles import fit_tiles
from pbrfit.fit.whole_picture import Asked, Found, fit_whole
from pbrfit.model.geometry import angles_between
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import DEFAULT_MODEL, Model, chosen_model, render, whole_number
from pbrfit.result import metrics
from pbrfit.result.history import History
from pbrfit.result.refinement import RefineNormals, check_choice, hindrance
from pbrfit.result.result import Options, Result
from pbrfit.scene import exposure
from pbrfit.scene.scene import Scene

__all__ = ["Loss", "Progress", "decompose"]

log = logging.getLogger("pbrfit")

Loss = Literal["none", "huber", "cauchy"]

DEFAULT_PRIORS = Priors()


def decompose(
    scene: Scene,
    *,
    solver: Solver = "auto",
    iterations: int = 500,
    time_limit: float | None = None,
    start: Materials | tuple[Materials, NDArray[Any]] | Result | None = None,
    threads: int = 0,
    sh_order: int = 3,
    metallic: float | None = None,
    mono_light: bool = False,
    priors: Priors | None = DEFAULT_PRIORS,
    uncertainty: bool = True,
    robust: Loss = "none",
    equal_exposures: bool | None = None,
    refine_normals: RefineNormals = "auto",
    seed: int = 0,
    model: Model | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Result:
    """Recover materials and lights from the pictures of one view.

    Parameters
    ----------
    scene
        Pictures, normals and what else is known. With `scene.lighting` only materials are fitted.
    solver
        `"auto"`: Gauss-Newton, then L-BFGS on the whole objective where it has more than squares;
        where the model does not fit the pictures, L-BFGS from the start; above 2 MP, or where
        memory is short, lights from some pixels and then tiles. `"gauss-newton"`: squares
        and the learnt material prior alone. `"lbfgsb"`: scipy's L-BFGS-B on the joint problem
        (the paper's recipe), in stages that keep off roughness 0; in one stage when `start` is
        given. docs/solver.md has more.
    iterations
        At most so many iterations: steps of L-BFGS, or joint steps of Gauss-Newton. Before these at
        most as many steps on some pixels, which find the lights and are not counted.
    time_limit
        In seconds; the fit stops after the iteration that passes it.
    start
        Maps to start from, alone or with lights (N, 16, 3) in picture units; or a result of the
        same model, which has both. Default: albedo from the mean picture, constant roughness and
        metallic, lights by least squares.
    threads
        0 = one for each processor. The result does not depend on it, to the last bit.
    sh_order
        Highest band of the lights: 3, or 2 to fit lights without band 3.
    metallic
        A number in [0, 1] that all pixels have, then it is not fitted; None = fitted.
    mono_light
        Whether lights are the same in all channels.
    priors
        Weights of what is thought likely beforehand (docs/priors.md); None = none.
    uncertainty
        Whether to estimate standard deviations of the maps (docs/uncertainty.md).
    robust
        `"huber"` or `"cauchy"`: a loss that shadows and other outliers pull less at, its scale
        estimated from the residuals after the first stage and again before each later one;
        `"none"`: squares (docs/solver.md).
    equal_exposures
        Whether pictures are divided by their mean radiance, so that bright ones do not outweigh
        dark ones; None = where the brightest has more than 4 times that of the darkest.
    refine_normals
        Whether to refine the given normals together with materials and lights (docs/normals.md):
        `"off"`; `"on"`; `"auto"`, where the pictures say that the given ones are wrong. Fewer than
        three pictures cannot say it, then normals stay as they are; with `"auto"` also where there
        is not enough memory. `Result.refinement` tells what was decided and why.
    seed
        Of what is drawn at random: the pixels on which Gauss-Newton finds the lights.
    model
        How surfaces reflect light (docs/model.md): "paper", its eq. 12; "principled", the BRDF of
        Blender's Principled node. None = that which the scene says its pictures were rendered
        with, else the default, `pbrfit.model.reflection.DEFAULT_MODEL`.
    progress
        Called at the start, after each iteration, after each step on some pixels and after each
        tile.

    Returns
    -------
    Result
        Materials, lights in picture units, status, history.

    Raises
    ------
    InputError
        If an argument or the scene cannot be used, or `start` is a result of another model.
    """
    chosen = chosen_model(model, scene.model)
    start = _to_start_from(start, chosen)
    check_solver(solver)
    check_loss(robust)
    check_choice(refine_normals)
    seed, sh_order = whole_number("seed", seed), whole_number("sh_order", sh_order)
    iterations = whole_number("iterations", iterations)
    if time_limit is not None:
        time_limit = float(time_limit)
        if not 0 <= time_limit < np.inf:
            raise InputError(f"time_limit: expected seconds, 0 or more, found {time_limit}")

    # Here and not above: scipy.optimize would double the time of `import pbrfit`. Before the clock
    # starts: loading it is no part of the fit.
    importlib.import_module("scipy.optimize")
    hindered = None if refine_normals == "off" else hindrance(scene)
    if hindered and refine_normals == "on":
        log.warning("normals are not refined: %s", hindered)
    asked = Asked(
        solver=solver,
        limits=Limits(iterations, time_limit),
        threads=threads,
        sh_order=sh_order,
        metallic=metallic,
        mono_light=mono_light,
        priors=priors or Priors.none(),
        uncertainty=uncertainty,
        robust=robust,
        equal_exposures=equal_exposures,
        refine_normals=refine_normals,
        hindered=hindered,
        seed=seed,
        model=chosen,
        progress=progress,
        began=time.perf_counter(),
    )
    layout = asked.layout(scene)
    plan = memory.plan(
        layout,
        solver,
        held=memory.bytes_of(scene),
        exact=scene.images.dtype != np.float32,
        refine_normals=refine_normals != "off" and hindered is None,
        optional=refine_normals == "auto",
    )
    memory.check(solver, plan.needed)  # before anything large is made
    if plan.tiled and layout.pixels <= memory.WHOLE:
        log.warning("fitted in tiles: there is not enough memory for all pixels at once")
    asked = replace(asked, hindered=hindered or plan.hindered)
    found = (fit_tiles if plan.tiled else fit_whole)(scene, asked, start)
    needs = FitPlan.of(
        scene,
        layout,
        priors=asked.priors,
        robust=robust,
        uncertainty=uncertainty,
        lighting=found.measured_lighting,
    )
    given = np.asarray(scene.normals, dtype=np.float64)
    refinement = found.refinement
    if refinement.refined:
        refinement = refinement.with_change(angles_between(found.normals, given))
    result = Result(
        materials=found.materials,
        lighting=found.lighting,
        normals=found.normals,
        mask=scene.valid.copy(),
        fov=scene.fov,
        model=chosen,
        pictures=scene.names,
        status=found.status,
        stop_reason=found.reason,
        history=History(found.rows),
        evaluations=found.evaluations,
        seconds=found.seconds,
        metrics=_metrics(scene, found, chosen, threads),
        options=Options(
            solver=solver,
            iterations=iterations,
            time_limit=time_limit,
            sh_order=int(sh_order),
            metallic=None if metallic is None else float(metallic),
            mono_light=mono_light,
            priors=asdict(asked.priors),
            robust=robust,
            equal_exposures=equal_exposures,
            seed=seed,
            refine_normals=refine_normals,
            model=model,
        ),
        assumed=_assumed(scene, found, model),
        left_out=needs.left_out,
        inputs=dict(scene.inputs),
        source=scene.source,
        stages=found.stages,
        uncertainty=found.uncertainty,
        refinement=refinement,
        given_normals=given if refinement.refined else None,
    )
    log.info(
        "%s after %d iterations, %.1f s: %s",
        *(found.status, found.iterations, found.seconds, found.reason),
    )
    return result


def _to_start_from(
    start: Materials | tuple[Materials, NDArray[Any]] | Result | None, model: Model
) -> Materials | tuple[Materials, NDArray[Any]] | None:
    """Take maps and lights out of a result, if it is of the same model."""
    if not isinstance(start, Result):
        return start
    if start.model != model:
        raise InputError(
            f"start: expected a result of model {model}, found one of model {start.model}; its "
            "materials alone may be given"
        )
    return start.materials, start.lighting


def _metrics(scene: Scene, fit: Found, model: Model, threads: int) -> dict[str, float]:
    """Final errors, computed in float64."""
    normals, materials, lighting = fit.normals, fit.materials, fit.lighting
    weights = (
        [None] * len(scene.images) if scene.weights is None else list(scene.weights[..., None])
    )
    totals = [1.0 if w is None else float(w.sum(dtype=np.float64)) for w in weights]
    # One picture at a time: all at once would be held in float64.
    of_pictures = [
        metrics.rmse(render(materials, normals, light, scene.fov, threads, model=model), image, w)
        for image, light, w in zip(scene.images, lighting, weights, strict=True)
    ]
    if fit.exposures is not None:
        of_pictures = list(map(operator.truediv, of_pictures, fit.exposures.tolist()))
    shares = [math.sqrt(total / math.fsum(totals)) for total in totals]
    found = {"recon_rmse": math.hypot(*map(operator.mul, shares, of_pictures))}
    truth = scene.truth
    if truth is None:
        return found
    found |= material_errors(materials, truth.materials)
    scaled = metrics.scaled_per_channel(materials.albedo, truth.materials.albedo)
    found["albedo_scaled_rmse"] = metrics.rmse(scaled, truth.materials.albedo)
    if truth.relight_images is not None and truth.relight_lighting is not None:
        rendered = render(
            *(materials, normals, truth.relight_lighting, scene.fov, threads), model=model
        )
        found["relight_rmse"] = metrics.rmse(rendered, truth.relight_images)
    return found


def _assumed(scene: Scene, fit: Found, model: Model | None) -> dict[str, str]:
    assumed = dict(scene.assumed)
    if model is not None:
        assumed["model"] = f"{model}, asked for"
        if scene.model not in (None, model):
            assumed["model"] += f"; the pictures were rendered with {scene.model}"
    elif scene.model is None:
        assumed["model"] = f"{DEFAULT_MODEL}, the default"
    else:
        assumed.setdefault("model", f"{scene.model}, with which the pictures were rendered")
    if fit.exposures is not None:
        assumed["exposures"] = exposure.in_words(fit.exposures)
    return assumed
