"""From Scene to Result: scipy's bounded L-BFGS on materials and lights together."""

from __future__ import annotations

import importlib
import logging
import math
import operator
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pbrfit import exposure, metrics
from pbrfit._core import InputError
from pbrfit.history import History, HistoryRow
from pbrfit.materials import Materials
from pbrfit.model import render, whole_number
from pbrfit.needs import Needs
from pbrfit.objective import START_ROUGHNESS, Objective
from pbrfit.priors import Priors, penalties
from pbrfit.result import Options, Result, Status
from pbrfit.robust import check_loss
from pbrfit.scene import Scene
from pbrfit.uncertainty import estimate

log = logging.getLogger("pbrfit")

Solver = Literal["lbfgsb"]
Loss = Literal["none", "huber", "cauchy"]

CORRECTIONS = 10
"""Pairs of steps and gradients that L-BFGS-B remembers."""

TRAP_ROUGHNESS = 0.1
"""The first stages keep roughness above this. Band weights and G1 depend on r⁴, so their slope is
r³ and roughness 0 is a stationary point of every pixel: one that overshoots to the bound stays
there, far from its minimum, and pulls at the lights. Between 0 and 0.1 pictures under SH light
hardly change, so little is lost by waiting."""

STAGES = ((TRAP_ROUGHNESS, 0.3), (TRAP_ROUGHNESS, 0.6), (0.0, 1.0))
"""(Lowest roughness, share of the iterations after which the stage ends). Between stages, pixels
that ended at the bound start again from the middle."""

STAGES_GIVEN_START = ((0.0, 1.0),)
ROBUST_STAGES_GIVEN_START = ((0.0, 0.3), (0.0, 1.0))
"""A robust loss needs a fit by squares first, which tells its scale."""


FIRST_SHARE = 0.5
"""Of the iterations: the fit of the data that the material prior is learnt around. The rest is
spent with the prior."""

DEFAULT_PRIORS = Priors()


@dataclass(frozen=True)
class Progress:
    """Where a running fit stands; passed to `progress` at the start and after each iteration.

    Attributes
    ----------
    iteration, iterations
        Done, and at most to be done.
    evaluations
        Of loss and gradient so far.
    recon_rmse
        In picture units.
    elapsed_s
        Without the time that `progress` itself and comparing with ground truth have taken.
    state
        Called inside `progress`, it gives maps and lights as they are now, as `Objective.unpack`.
    """

    iteration: int
    iterations: int
    evaluations: int
    recon_rmse: float
    elapsed_s: float
    state: Callable[[], tuple[Materials, NDArray[np.float64]]] = field(repr=False, compare=False)


def decompose(
    scene: Scene,
    *,
    solver: Solver = "lbfgsb",
    iterations: int = 500,
    time_limit: float | None = None,
    start: Materials | tuple[Materials, NDArray[Any]] | None = None,
    threads: int = 0,
    sh_order: int = 3,
    metallic: float | None = None,
    mono_light: bool = False,
    priors: Priors | None = DEFAULT_PRIORS,
    uncertainty: bool = True,
    robust: Loss = "none",
    equal_exposures: bool | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Result:
    """Recover materials and lights from the pictures of one view.

    Parameters
    ----------
    scene
        Pictures, normals and what else is known. With `scene.lighting` only materials are fitted.
    solver
        `"lbfgsb"`: scipy's L-BFGS-B on the joint problem (the paper's recipe), in stages that keep
        off roughness 0; in one stage when `start` is given.
    iterations
        At most so many iterations.
    time_limit
        In seconds; the fit stops after the iteration that passes it.
    start
        Maps to start from, alone or with lights (N, 16, 3) in picture units. Default: albedo from
        the mean picture, constant roughness and metallic, lights by least squares.
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
    progress
        Called at the start and after each iteration.

    Returns
    -------
    Result
        Materials, lights in picture units, status, history.

    Raises
    ------
    InputError
        If an argument or the scene cannot be used.
    """
    if solver != "lbfgsb":
        raise InputError(f"solver: expected lbfgsb, found {solver!r}")
    check_loss(robust)
    iterations = whole_number("iterations", iterations)
    if time_limit is not None:
        time_limit = float(time_limit)
        if not 0 <= time_limit < np.inf:
            raise InputError(f"time_limit: expected seconds, 0 or more, found {time_limit}")

    # Here and not above: scipy.optimize would double the time of `import pbrfit`. Before the clock
    # starts: loading it is no part of the fit.
    importlib.import_module("scipy.optimize")
    began = time.perf_counter()
    priors = priors or Priors.none()
    objective = Objective(
        scene,
        threads=threads,
        sh_order=sh_order,
        metallic=metallic,
        mono_light=mono_light,
        priors=priors,
        equal_exposures=equal_exposures,
    )
    x = _start(objective, start)
    run = _Run(scene, objective, priors, robust, iterations, time_limit, progress, began)
    x, status, stop_reason = run.lbfgsb(x, start_given=start is not None)

    materials, lighting = objective.unpack(x)
    needs = Needs.of(
        scene,
        objective.layout,
        priors=priors,
        robust=robust,
        uncertainty=uncertainty,
        lighting=run.measured_lighting,
    )
    seconds = time.perf_counter() - began - run.unmeasured
    result = Result(
        materials=materials,
        lighting=lighting,
        normals=np.asarray(scene.normals, dtype=np.float64),
        mask=scene.valid.copy(),
        fov=scene.fov,
        pictures=scene.names,
        status=status,
        stop_reason=stop_reason,
        history=History(tuple(run.rows)),
        evaluations=run.evaluations,
        seconds=seconds,
        metrics=_metrics(scene, materials, lighting, threads, objective.exposures),
        options=Options(
            solver=solver,
            iterations=iterations,
            time_limit=time_limit,
            sh_order=int(sh_order),
            metallic=None if metallic is None else float(metallic),
            mono_light=mono_light,
            priors=asdict(priors),
            robust=robust,
            equal_exposures=equal_exposures,
        ),
        assumed=_assumed(scene, objective),
        left_out=needs.left_out,
        inputs=dict(scene.inputs),
        source=scene.source,
        uncertainty=estimate(objective, x, priors=priors != Priors.none()) if uncertainty else None,
    )
    log.info("%s after %d iterations, %.1f s: %s", status, run.iteration, seconds, stop_reason)
    return result


def _start(
    objective: Objective, start: Materials | tuple[Materials, NDArray[Any]] | None
) -> NDArray[np.float64]:
    if start is None:
        return objective.start()
    materials, lighting = (start, None) if isinstance(start, Materials) else start
    x = objective.pack(materials.albedo, materials.roughness, materials.metallic, lighting)
    return np.clip(x, *objective.bounds.T)


class _Run:
    """One fit: counts evaluations, keeps the history, watches the clock."""

    def __init__(
        self,
        scene: Scene,
        objective: Objective,
        priors: Priors,
        robust: Loss,
        iterations: int,
        time_limit: float | None,
        progress: Callable[[Progress], None] | None,
        began: float,
    ) -> None:
        self.scene = scene
        # When the material prior was learnt; by these the monochrome weight is chosen.
        self.measured_lighting: NDArray[np.float64] | None = None
        self.truth = None if scene.truth is None else scene.truth.materials
        self.objective = objective
        self.priors = priors
        self.robust = robust
        self.iterations = iterations
        self.time_limit = time_limit
        self.progress = progress
        self.began = began
        self.unmeasured = 0.0  # seconds spent on comparing with the truth
        self.evaluations = 0
        self._last = math.nan, math.nan  # loss and its data term, of the last evaluation
        self.iteration = 0
        self.rows: list[HistoryRow] = []

    def lbfgsb(
        self, x: NDArray[np.float64], *, start_given: bool
    ) -> tuple[NDArray[np.float64], Status, str]:
        loss, _ = self._evaluate(x)
        self._record(x, loss)
        if self.iterations == 0:
            return x, Status.ITERATION_LIMIT, "0 iterations asked for"
        learns = self.priors.material > 0
        last = FIRST_SHARE if learns else 1.0
        kept = ""
        best = loss, x
        trapped = False
        for lowest_roughness, share in self._stages(start_given):
            iterations = round(last * share * self.iterations) - self.iteration
            if iterations <= 0 or self._out_of_time():
                continue
            if self.iteration > 0:
                best = self._robust_around(best)
            if trapped:
                x = self._restarted(x)
            loss, x = self._minimize(x, lowest_roughness, iterations)
            trapped = lowest_roughness > 0
            # A restart raises the loss at first, and time may run out before it pays.
            best = min(best, (loss, x), key=lambda pair: pair[0])
        if best[0] < loss:
            kept = "; kept the better state before the last restart"
        _, x = best
        if learns and not self._out_of_time():
            kept = ""
            x = self._learnt(x)
            if self.iteration < self.iterations:  # scipy takes a step even where none is left
                loss, x = self._minimize(x, 0.0, self.iterations - self.iteration)
        if self._out_of_time():
            return x, Status.TIME_LIMIT, f"time limit of {self.time_limit:g} s reached{kept}"
        if self.iteration >= self.iterations:
            return x, Status.ITERATION_LIMIT, f"{self.iterations} iterations done{kept}"
        # With zero tolerances scipy stops early only where rounding hides any further descent.
        return x, Status.CONVERGED, "no step lowers the loss further"

    def _stages(self, start_given: bool) -> tuple[tuple[float, float], ...]:
        if not start_given:
            return STAGES
        return STAGES_GIVEN_START if self.robust == "none" else ROBUST_STAGES_GIVEN_START

    def _robust_around(
        self, best: tuple[float, NDArray[np.float64]]
    ) -> tuple[float, NDArray[np.float64]]:
        """Make the loss robust, if it is to be, with the scale at this state; returns it anew."""
        if self.robust == "none":
            return best
        _, x = best
        self.objective.robust = self.objective.robust_around(x, self.robust)
        return self._evaluate(x)[0], x

    def _learnt(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """X with the material prior learnt, which is a penalty from here on; one iteration."""
        from pbrfit import material_prior

        x, pull = material_prior.learn(
            self.objective.reweighted(x), x, self.priors.material, out_of_time=self._out_of_time
        )
        _, self.measured_lighting = self.objective.unpack(x)
        needs = Needs.of(
            self.scene,
            self.objective.layout,
            priors=self.priors,
            lighting=self.measured_lighting,
        )
        self.objective.penalties = [*penalties(self.objective.layout, needs.priors), pull]
        self.objective.robust = self.objective.robust_around(x, self.robust)
        loss, _ = self._evaluate(x)
        self.iteration += 1
        self._record(x, loss)
        return x

    def _restarted(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """X with the pixels that are trapped at the roughness bound put back to the middle."""
        x = x.copy()
        roughness = x[self.objective.roughness]
        roughness[roughness <= TRAP_ROUGHNESS + 0.005] = START_ROUGHNESS
        return x

    def _minimize(
        self, x: NDArray[np.float64], lowest_roughness: float, iterations: int
    ) -> tuple[float, NDArray[np.float64]]:
        from scipy.optimize import Bounds, minimize
        from threadpoolctl import threadpool_limits

        lower, upper = self.objective.bounds.T.copy()
        lower[self.objective.roughness] = lowest_roughness
        # One BLAS thread: dot products split over threads would round differently on a machine
        # with another number of processors.
        with threadpool_limits(1, user_api="blas"):
            found = minimize(
                self._evaluate,
                x,
                jac=True,
                method="L-BFGS-B",
                bounds=Bounds(lower, upper),
                callback=self._after_iteration,
                options={
                    "maxiter": iterations,
                    "maxfun": 10**9,  # iterations and time are the limits
                    "maxcor": CORRECTIONS,
                    # The loss is a mean, so its gradient entries are tiny: scipy's absolute
                    # tolerances would stop at once. Run on until no step lowers the loss.
                    "ftol": 0.0,
                    "gtol": 0.0,
                },
            )
        return float(found.fun), found.x

    def _evaluate(self, x: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        self.evaluations += 1
        data, gradient = self.objective.data_value_and_grad(x)
        loss = data + self.objective.add_penalties(x, gradient)
        self._last = loss, data
        return loss, gradient

    def _data_loss(self, x: NDArray[np.float64], loss: float) -> float:
        """Of an x whose loss is known; in all but rare cases x was the last to be evaluated."""
        last, data = self._last
        return data if last == loss else self.objective.data_value_and_grad(x)[0]

    def _out_of_time(self) -> bool:
        return self.time_limit is not None and self._elapsed() >= self.time_limit

    def _elapsed(self) -> float:
        return time.perf_counter() - self.began - self.unmeasured

    def _after_iteration(self, intermediate_result: Any) -> None:
        self.iteration += 1
        self._record(intermediate_result.x, float(intermediate_result.fun))
        if self._out_of_time():
            raise StopIteration

    def _record(self, x: NDArray[np.float64], loss: float) -> None:
        elapsed = self._elapsed()
        recon = self.objective.residual_rmse(self._data_loss(x, loss))
        errors = {}
        if self.truth is not None:
            found, _ = self.objective.unpack(x)
            errors = _material_errors(found, self.truth)
        self.rows.append(
            HistoryRow(elapsed, self.iteration, self.evaluations, loss, recon, **errors)
        )
        if self.progress is not None:
            self.progress(
                Progress(
                    self.iteration,
                    self.iterations,
                    self.evaluations,
                    recon,
                    elapsed,
                    lambda: self.objective.unpack(x),
                )
            )
        self.unmeasured += self._elapsed() - elapsed


def _material_errors(found: Materials, true: Materials) -> dict[str, float]:
    return {
        "albedo_rmse": metrics.rmse(found.albedo, true.albedo),
        "roughness_rmse": metrics.rmse(found.roughness, true.roughness),
        "metallic_rmse": metrics.rmse(found.metallic, true.metallic),
    }


def _metrics(
    scene: Scene,
    materials: Materials,
    lighting: NDArray[np.float64],
    threads: int,
    exposures: NDArray[np.float64] | None = None,
) -> dict[str, float]:
    """Final errors, computed in float64."""
    weights = (
        [None] * len(scene.images) if scene.weights is None else list(scene.weights[..., None])
    )
    totals = [1.0 if w is None else float(w.sum(dtype=np.float64)) for w in weights]
    # One picture at a time: all at once would be held in float64.
    of_pictures = [
        metrics.rmse(render(materials, scene.normals, light, scene.fov, threads), image, w)
        for image, light, w in zip(scene.images, lighting, weights, strict=True)
    ]
    if exposures is not None:
        of_pictures = list(map(operator.truediv, of_pictures, exposures.tolist()))
    shares = [math.sqrt(total / math.fsum(totals)) for total in totals]
    found = {"recon_rmse": math.hypot(*map(operator.mul, shares, of_pictures))}
    truth = scene.truth
    if truth is None:
        return found
    found |= _material_errors(materials, truth.materials)
    scaled = metrics.scaled_per_channel(materials.albedo, truth.materials.albedo)
    found["albedo_scaled_rmse"] = metrics.rmse(scaled, truth.materials.albedo)
    if truth.relight_images is not None and truth.relight_lighting is not None:
        rendered = render(materials, scene.normals, truth.relight_lighting, scene.fov, threads)
        found["relight_rmse"] = metrics.rmse(rendered, truth.relight_images)
    return found


def _assumed(scene: Scene, objective: Objective) -> dict[str, str]:
    assumed = dict(scene.assumed)
    if objective.exposures is not None:
        assumed["exposures"] = exposure.in_words(objective.exposures)
    return assumed
