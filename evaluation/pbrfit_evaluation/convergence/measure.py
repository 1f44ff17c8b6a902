"""Errors while a solver runs, and the time it needs to reach given ones.

Scenes are clean, noisy, stiff, of another model, or real.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from pbrfit.model.materials import Materials
from pbrfit.model.reflection import Model, chosen_model, render
from pbrfit.result import metrics
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import MEAN_RADIANCE, make_scene
from pbrfit_evaluation.arrays import Array, known
from pbrfit_evaluation.heldout.light import harmonics, target
from pbrfit_evaluation.heldout.measure import Split, split
from pbrfit_evaluation.heldout.sources import find_sources, opened
from pbrfit_evaluation.recipes import OTHER
from pbrfit_evaluation.scores import MAPS
from pbrfit_evaluation.suite import Options

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
    alike: bool = False
    """Whether training lights hardly differ. The held-out lights always do."""
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
        return f"{self.size}², {noise}, lights {'alike' if self.alike else 'typical'}"


def make(case: Case, seed: int) -> Scene:
    """Make a room of a synthetic case, 16 training and 16 held-out pictures.

    Lights are those of `pbrfit.synthetic`: a key light and fills of several colours with an
    ambient term. With their mean L̄, those that are alike are L̄ + ε (L − L̄), ε = `ALIKE`: the
    condition number is about 1/ε times as large, and a mean of positive lights is positive.
    """
    model = OTHER[case.model] if case.misfit else case.model
    scene = make_scene(
        "room", size=case.size, lights=PICTURES, held_out=PICTURES, seed=seed, model=model
    )
    truth, images = known(scene.truth), scene.images
    lighting = known(truth.lighting)
    if case.alike:
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
        Case("stiff-128", 128, 0.01, alike=True),
        Case("misfit-128", 128, 0.01, misfit=True),
        Case("clean-512", 512),
        Case("noisy-512", 512, 0.01),
        Case("stiff-512", 512, 0.01, alike=True),
        Case("misfit-512", 512, 0.01, misfit=True),
        Case("noisy-1024", 1024, 0.01),
        Case("clean-24", 24),
        Case("stiff-24", 24, 0.01, alike=True),
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
    found = materials.within(scene.valid)

    def rendered(lights: Array) -> Array:
        model = chosen_model(None, scene.model)
        return render(found, scene.normals, lights, scene.fov, threads, model=model)

    relit = rendered(known(truth.relight_lighting))
    return {
        "recon": metrics.rmse(rendered(lighting), scene.images),
        **{name: metrics.rmse(getattr(found, name), getattr(true, name)) for name in MAPS},
        "albedo_scaled": metrics.scaled_rmse(found.albedo, true.albedo),
        "relight": metrics.rmse(relit, known(truth.relight_images)),
        "held_out": math.nan,
    }


def held_out_errors(
    scene: Scene, which: Split, materials: Materials, _: Array, *, model: Model
) -> dict[str, float]:
    """Relative RMSE of real pictures that were fitted, and of those that were held out.

    In radiance. The light of each is fitted to the materials, so that both mean the same.
    """
    found = materials.within(scene.valid)
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
