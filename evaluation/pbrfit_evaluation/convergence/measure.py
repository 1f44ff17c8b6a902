"""Errors while a solver runs, and the time it needs to reach given ones."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pbrfit.model.materials import Materials
from pbrfit.model.reflection import Model, chosen_model, render
from pbrfit.result import metrics
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.heldout.light import harmonics, target
from pbrfit_evaluation.heldout.measure import Split
from pbrfit_evaluation.recipes import known, within

Array = NDArray[np.float64]

Quantity = Literal[
    "recon", "albedo", "albedo_scaled", "roughness", "metallic", "relight", "held_out"
]
QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)

CHECKPOINT_RATIO = 1.12
"""Evaluations, or seconds, from one checkpoint to the next: twenty a decade. Times to reach an
error can be late by as much, never early."""

State = Callable[[], tuple[Materials, Array]]
"""Gives the maps and lights (N, 16, 3) as they are now."""

Point = Mapping[str, float]
"""A checkpoint: what it had cost by then, as seconds of wall time and of processors without
measuring, iteration and evaluations; and each of `QUANTITIES`, NaN where it cannot be known."""


@dataclass(frozen=True)
class Budget:
    """How long a run may go on.

    `iterations` are of `pbrfit.decompose`, `evaluations` of a peer, which does not stop by itself.
    """

    iterations: int
    evaluations: int
    seconds: float


def measure(
    scene: Scene, materials: Materials, lighting: Array, threads: int = 0
) -> dict[str, float]:
    """RMSE of maps and lights against a scene's ground truth in float64, by name of `QUANTITIES`.

    `recon` is against the pictures that were fitted, noise included; `albedo_scaled` after the best
    factor a channel; `relight` of the maps under the true held-out lights. Maps of float32 solvers
    may leave [0, 1] by a rounding: they are clipped first.
    """
    truth = known(scene.truth)
    true = truth.materials
    found = within(materials, scene.valid)

    def rendered(lights: Array) -> Array:
        model = chosen_model(None, scene.model)
        return render(found, scene.normals, lights, scene.fov, threads, model=model)

    scaled = metrics.scaled_per_channel(found.albedo, true.albedo)
    relit = rendered(known(truth.relight_lighting))
    return {
        "recon": metrics.rmse(rendered(lighting), scene.images),
        "albedo": metrics.rmse(found.albedo, true.albedo),
        "albedo_scaled": metrics.rmse(scaled, true.albedo),
        "roughness": metrics.rmse(found.roughness, true.roughness),
        "metallic": metrics.rmse(found.metallic, true.metallic),
        "relight": metrics.rmse(relit, known(truth.relight_images)),
        "held_out": math.nan,
    }


def held_out_errors(
    scene: Scene, which: Split, materials: Materials, _: Array, *, model: Model
) -> dict[str, float]:
    """Relative RMSE of real pictures that were fitted, and of those that were held out.

    In radiance. The light of each is fitted to the materials, so that both mean the same.
    """
    found = within(materials, scene.valid)
    valid = scene.valid
    lit = harmonics(found, np.asarray(scene.normals, np.float64), scene.fov, valid, model)

    def error(pictures: tuple[int, ...]) -> float:
        signal = left = 0.0
        for i in pictures:
            of = target(scene, i, valid, None)
            signal += float((of.weights * of.radiance**2).sum())
            residual = lit(of.radiance, of.weights) - of.radiance
            left += float((of.weights * residual**2).sum())
        return math.sqrt(left / signal) if signal > 0 else math.nan

    unknown: dict[str, float] = dict.fromkeys(map(str, QUANTITIES), math.nan)
    return {**unknown, "recon": error(which.kept), "held_out": error(which.held_out)}


class Tracker:
    """Measures a run whenever evaluations or seconds have grown by 12 %, and at both ends.

    Joint steps of Gauss-Newton count as no evaluation, so seconds tell them apart.

    A solver calls `start` when its clock starts, and `visit` whenever it has a state. `seconds` and
    processor seconds leave out what is done `off_the_clock`, such as measuring.
    """

    def __init__(self, errors: Callable[[Materials, Array], Mapping[str, float]]) -> None:
        self._errors = errors
        self._next_evaluations = self._next_seconds = 0.0
        self.points: list[Point] = []
        self.start()

    def start(self) -> None:
        """From here on seconds count."""
        self._began, self._processor_began = time.perf_counter(), time.process_time()

    @property
    def seconds(self) -> float:
        """Wall time since the start."""
        return time.perf_counter() - self._began

    @contextmanager
    def off_the_clock(self) -> Iterator[None]:
        """What is done inside takes no seconds."""
        before, processor = time.perf_counter(), time.process_time()
        try:
            yield
        finally:
            self._began += time.perf_counter() - before
            self._processor_began += time.process_time() - processor

    def visit(self, seconds: float, iteration: int, evaluations: int, state: State) -> None:
        """Measure, if it is time to."""
        if evaluations >= self._next_evaluations or seconds >= self._next_seconds:
            self._measure(seconds, iteration, evaluations, state)

    def end(self, seconds: float, iteration: int, evaluations: int, state: State) -> None:
        """Measure what the solver hands back; it takes the place of a checkpoint just before."""
        last = self.points[-1] if self.points else {}
        if last.get("evaluations") == evaluations and last["iteration"] == iteration:
            self.points.pop()
        self._measure(seconds, iteration, evaluations, state)

    def _measure(self, seconds: float, iteration: int, evaluations: int, state: State) -> None:
        processor = time.process_time() - self._processor_began
        cost = {"seconds": seconds, "processor": processor}
        cost |= {"iteration": iteration, "evaluations": evaluations}
        with self.off_the_clock():
            self.points.append({**cost, **self._errors(*state())})
        self._next_evaluations = max(evaluations + 1, CHECKPOINT_RATIO * evaluations)
        self._next_seconds = CHECKPOINT_RATIO * seconds


def first_reached(points: Sequence[Point], quantity: Quantity, target: float) -> Point | None:
    """First checkpoint with an error of at most `target`; one that is not a number reaches none."""
    return next((point for point in points if point[quantity] <= target), None)


def median_reached(times: Sequence[float | None]) -> float | None:
    """Median of times to reach an error, None = never, later than all others.

    None if the median is. Of an even number the later of the middle two, so that no time is made
    up between one that was and one that was not.
    """
    if not times:
        return None
    ordered = sorted(math.inf if time is None else time for time in times)
    middle = ordered[len(ordered) // 2]
    return None if math.isinf(middle) else middle
