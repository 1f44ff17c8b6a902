"""PyTorch's own optimisers on the same problem: float32, gradients by automatic differentiation.

PyTorch is optional (`pip install pbrfit-evaluation[peers]`) and imported by `fit` alone.

**Bounds.** torch.optim knows none, so optimisers run on unknowns without bounds: a map is the
sigmoid of its unknown.

**Scale of the loss.** torch.optim.LBFGS drops a pair of step and gradient change whose product is
at most 1e-10, a fixed number, so on a mean over many samples it would forget all curvature: it gets
the sum. The same factor makes no difference to Adam but for its epsilon.

**Units of the lights.** Both optimisers start with a step that has no idea of curvature. Lights are
unknowns in units of `LIGHT_UNIT`, so that a step moves them as far as it should beside the maps.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pbrfit.fit.objective import Objective
from pbrfit.model.materials import Materials
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.arrays import Array
from pbrfit_evaluation.convergence.measure import Budget, Tracker
from pbrfit_evaluation.float32_model import View

if TYPE_CHECKING:
    import torch


Optimiser = Literal["lbfgs", "adam"]

SIGMOID_RANGE = (0.01, 0.99)
"""Start values are brought in here: at 0 and 1 a sigmoid's unknown is infinite."""

HISTORY = 10
"""Pairs that L-BFGS remembers."""

VISIT_EVERY = 5
"""L-BFGS iterations between two looks at the state; a look after each of the first few."""

COMPILED_FROM = 256**2
"""Pixels from which the loss goes through torch.compile: that takes longer than a smaller fit."""

GPU_EVALUATIONS = 10
"""Times as many as on processors."""

TRIED = 5
"""Evaluations by which a number of threads is judged."""


LIGHT_UNIT = {"lbfgs": 0.3, "adam": 1.0}
"""Lights are this times their unknowns, in the scaled pictures' units (mean radiance 0.4)."""

ADAM_RATE, ADAM_BETA2 = 0.1, 0.99
"""Learning rate, the first of a cosine that ends at 0 with the last step; and second decay."""


def fit(
    scene: Scene,
    budget: Budget,
    tracker: Tracker,
    threads: int,
    *,
    optimiser: Optimiser,
    gpu: bool = False,
) -> str:
    """Fit from the default start; returns why it ended.

    By `torch.optim.LBFGS` with the strong Wolfe line search, or `torch.optim.Adam`. On a GPU with
    `GPU_EVALUATIONS` times the evaluations, which cost so much less there.

    The clock starts with the pictures as arrays. Importing PyTorch, compiling, trying numbers of
    threads, and making the start with the lights that fit it, which this package does, are not on
    it.
    """
    objective = Objective(scene, threads=threads, model="paper")  # which is what they have
    x, light_unit = objective.start(), LIGHT_UNIT[optimiser]
    kind = OnGpu if gpu else Problem
    problem = kind(scene, objective, x, light_unit)
    if gpu:
        budget = replace(budget, evaluations=GPU_EVALUATIONS * budget.evaluations)
        problem.evaluate()  # compiles it
    else:
        _choose_threads(problem, threads)
    tracker.start()
    if not problem.compiled:  # else it would be compiled again
        problem = kind(scene, objective, x, light_unit)
    run = _lbfgs if optimiser == "lbfgs" else _adam
    iterations, evaluations, reason = run(problem, budget, tracker)
    tracker.end(tracker.seconds, iterations, evaluations, problem.state)
    return reason


class Problem:
    """The objective as a function of float32 tensors without bounds."""

    device, compiled_from = "cpu", COMPILED_FROM

    def __init__(self, scene: Scene, objective: Objective, start: Array, light_unit: float) -> None:
        import torch

        valid = scene.valid
        images = np.stack([scene.samples(i) for i in range(len(scene.images))]) / objective.scale
        normals = scene.normals[valid].astype(np.float64)
        view = View(images.astype(np.float32), normals, scene.views[valid])
        self.compiled = view.pixels >= self.compiled_from
        self._loss = self._compiled(view)
        self.samples = view.images.size
        """Terms in the mean that the loss is."""
        self._objective = objective
        self._light_unit = light_unit
        p = view.pixels
        materials = np.clip(start[: 5 * p], *SIGMOID_RANGE)
        materials = np.log(materials / (1 - materials))
        of_float32 = {"dtype": torch.float32, "requires_grad": True, "device": self.device}
        self.maps = torch.tensor(materials.reshape(5, p), **of_float32)
        lights = start[5 * p :].reshape(-1, 16, 3) / light_unit
        self.lights = torch.tensor(lights, **of_float32)
        self.unknowns = [self.maps, self.lights]

    def _compiled(self, view: View) -> Any:
        import torch

        from pbrfit_evaluation.torch_loss import matrix_form

        loss = matrix_form(view)
        # A shape of its own for each scene: nothing is gained by code for any shape.
        return torch.compile(loss, dynamic=False) if self.compiled else loss

    def evaluate(self, factor: float = 1.0) -> torch.Tensor:
        """Loss times a factor; the gradient is kept in the unknowns."""
        for unknown in self.unknowns:
            unknown.grad = None
        maps = self.maps.sigmoid()
        loss = factor * self._loss(maps[:3], maps[3], maps[4], self._light_unit * self.lights)
        loss.backward()  # type: ignore[no-untyped-call, unused-ignore]
        return loss

    def state(self) -> tuple[Materials, Array]:
        """Maps and lights in the scene's units."""
        maps = self.maps.sigmoid().detach().cpu()
        lights = self._light_unit * self.lights.detach().cpu()
        x = np.concatenate([maps.numpy().ravel(), lights.numpy().ravel()]).astype(np.float64)
        return self._objective.unpack(x)


class OnGpu(Problem):
    """The same by one kernel on a GPU, where the unknowns stay."""

    device, compiled_from = "cuda", 0

    def _compiled(self, view: View) -> Any:
        from pbrfit_evaluation.gpu_loss import Kernel

        return Kernel(view)

    def evaluate(self, factor: float = 1.0) -> torch.Tensor:
        """Loss times a factor; the gradient is kept in the unknowns."""
        maps = self.maps.detach().sigmoid()
        lights = (self._light_unit * self.lights.detach()).permute(2, 0, 1).contiguous()
        loss, by_maps, by_lights = self._loss(maps, lights)
        self.maps.grad = factor * by_maps * maps * (1 - maps)
        self.lights.grad = (factor * self._light_unit * by_lights.permute(1, 2, 0)).contiguous()
        return factor * loss


def _choose_threads(problem: Problem, threads: int) -> None:
    """Take one thread or all, whichever evaluates faster: pictures may be too small to share.

    On a busy machine, too, threads that wait for each other can take a hundred times as long.
    """
    import torch

    times = {}
    for count in sorted({1, threads}):
        torch.set_num_threads(count)
        problem.evaluate()
        began = time.perf_counter()
        for _ in range(TRIED):
            problem.evaluate()
        times[count] = time.perf_counter() - began
    torch.set_num_threads(min(times, key=lambda count: times[count]))


def _adam(problem: Problem, budget: Budget, tracker: Tracker) -> tuple[int, int, str]:
    """Iterations, evaluations, and why it ended."""
    import torch

    optimiser = torch.optim.Adam(problem.unknowns, lr=ADAM_RATE, betas=(0.9, ADAM_BETA2), eps=1e-12)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, budget.evaluations)
    for step in range(budget.evaluations):
        if tracker.seconds >= budget.seconds:
            return step, step, f"time limit of {budget.seconds:g} s reached"
        loss = problem.evaluate(problem.samples)
        if step == 0:
            tracker.visit(tracker.seconds, 0, 1, problem.state)
        elif not math.isfinite(float(loss.detach())):
            return step, step, "the loss is not finite"
        optimiser.step()
        schedule.step()
        tracker.visit(tracker.seconds, step + 1, step + 1, problem.state)
    return budget.evaluations, budget.evaluations, f"{budget.evaluations} steps done"


def _lbfgs(problem: Problem, budget: Budget, tracker: Tracker) -> tuple[int, int, str]:
    """Iterations, evaluations, and why it ended."""
    import torch

    optimiser = torch.optim.LBFGS(
        problem.unknowns,
        lr=1.0,
        max_iter=VISIT_EVERY,
        max_eval=10**9,
        tolerance_grad=0.0,
        tolerance_change=0.0,
        history_size=HISTORY,
        line_search_fn="strong_wolfe",
    )
    evaluations = 0
    repeated = False

    def closure() -> torch.Tensor:
        nonlocal evaluations, repeated
        if repeated:
            # Each call of `step` begins by evaluating again where the last one ended. That is a
            # price of looking in on it, not of the method: off the clock and not counted.
            with tracker.off_the_clock():
                loss = problem.evaluate(problem.samples)
            repeated = False
            return loss
        evaluations += 1
        loss = problem.evaluate(problem.samples)
        if evaluations == 1:
            tracker.visit(tracker.seconds, 0, 1, problem.state)
        return loss

    iterations = 0
    while evaluations < budget.evaluations:
        if tracker.seconds >= budget.seconds:
            return iterations, evaluations, f"time limit of {budget.seconds:g} s reached"
        before = evaluations
        for group in optimiser.param_groups:
            group["max_iter"] = 1 if iterations < 2 * VISIT_EVERY else VISIT_EVERY
        optimiser.step(closure)
        repeated = True
        iterations = int(next(iter(optimiser.state.values()))["n_iter"])
        if evaluations == before:
            return iterations, evaluations, "no step lowers the loss further"
        if not bool(torch.isfinite(problem.maps).all()):
            return iterations, evaluations, "the unknowns are not finite"
        tracker.visit(tracker.seconds, iterations, evaluations, problem.state)
    return iterations, evaluations, f"{evaluations} evaluations done"
