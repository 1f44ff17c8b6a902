"""Surroundings that may block the light of a scene with depth, or also bring some.

What no picture shows (`pbrfit.transport.extents`), whether surroundings also bring light and with
which gain, is searched. Two sets of pixels, of some hundred each, judge: lights are fitted to the
first together with its materials; then pixels of the second, with these lights, find their best
materials, and what is left of them is the score: the mean over pixels of
ln(Σ residual²/Σ radiance²). A pixel has five unknowns whatever surroundings are, and the lights
know nothing of it, so more freedom gains nothing by itself. One alternative is better where the
mean of the paired differences is more than `TRANSPORT_ERRORS_MIN` of its standard errors below 0.

Whether the pictures are explained better with the surroundings that are found than without is
decided by left-out pictures (`pbrfit.fit.compare`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import misfit, settings
from pbrfit.fit.coarse import dielectric_prior, fit_level
from pbrfit.fit.joint import SharedFit, Stop, minimize
from pbrfit.fit.light_prior import LightPrior
from pbrfit.fit.objective import Objective
from pbrfit.fit.sampling import evenly_spaced
from pbrfit.scene.scene import Scene
from pbrfit.threads import one_blas_thread
from pbrfit.transport.decision import Kind, Transport
from pbrfit.transport.extents import Extents, candidates
from pbrfit.transport.scenery import PixelTransfer, Scenery, filled

Array = NDArray[np.float64]


class Surrounded:
    """A scene among its surroundings: tables for an objective of any of its parts."""

    def __init__(self, scene: Scene, transport: Transport, scenery: Scenery) -> None:
        self.scene, self.transport, self.scenery = scene, transport, scenery
        self._images: NDArray[np.float32] | None = None

    @property
    def images(self) -> NDArray[np.float32]:
        """(H, W, N, C): the pictures, filled where the mask has nothing."""
        if self._images is None:
            scene = self.scene
            channels = 1 if scene.grey else 3
            pictures = [
                filled(scene.picture(i, slice(None))[..., :channels], scene.valid)
                for i in range(len(scene.images))
            ]
            self._images = np.stack(pictures, axis=2)
        return self._images

    def tables(
        self,
        objective: Objective,
        pixels: NDArray[np.uint64] | None = None,
        *,
        kind: Kind | None = None,
        scenery: Scenery | None = None,
        rays: int = settings.TRANSPORT_RAYS,
    ) -> PixelTransfer | None:
        """Of pixels of an objective, of the scene or a window of it; None if nothing blocks."""
        kind = self.transport.kind if kind is None else kind
        scenery = self.scenery if scenery is None else scenery
        if kind == "none":
            return None
        found = scenery.transfer(
            objective.places_in(self.scene, pixels),
            objective.model,
            rays=rays,
            threads=objective.threads,
            images=self.images if kind == "bounce" else None,
        )
        return replace(found, gain=self.transport.gain)


def search(
    part: Scene, objective: Objective, asked: str, out_of_time: Callable[[], bool]
) -> Surrounded:
    """The surroundings that explain left-out pixels best.

    `part` is a scene with depth, or a window of one, with its objective; `asked` is an option of
    `FitOptions.transport` other than "none".

    Raises
    ------
    InputError
        If the depth cannot be used.
    """
    scene: Scene = getattr(part, "whole", part)
    assert scene.depth is not None
    scenery = Scenery(scene.depth, scene.normals, scene.valid, scene.segments, scene.fov)
    surrounded = Surrounded(scene, Transport(), scenery)
    with one_blas_thread():
        return _Search(objective, surrounded, asked, out_of_time).best()


class Trial:
    """An alternative, and what it left."""

    def __init__(self, kind: Kind, scenery: Scenery, gain: float) -> None:
        self.kind, self.scenery, self.gain = kind, scenery, gain
        self.left = np.empty(0)
        self.x = np.empty(0)

    @property
    def score(self) -> float:
        """Mean over left-out pixels."""
        return float(self.left.mean())

    def better_than(self, other: Trial) -> bool:
        """Whether what it left is surely less."""
        difference = self.left - other.left
        error = float(difference.std(ddof=1)) / np.sqrt(len(difference))
        return bool(difference.mean() < -settings.TRANSPORT_ERRORS_MIN * error)


class _Search:
    """Looks for the alternative that leaves least."""

    def __init__(
        self,
        objective: Objective,
        surrounded: Surrounded,
        asked: str,
        out_of_time: Callable[[], bool],
    ) -> None:
        self._objective, self._x = objective, objective.start()
        self._surrounded, self._asked, self._out_of_time = surrounded, asked, out_of_time
        chosen = evenly_spaced(objective.pixels, 2 * settings.TRANSPORT_PIXELS)
        self._fitted, self._left_out = chosen[::2], chosen[1::2]
        self._size = np.square(objective.pictures(self._left_out)).sum(axis=(0, 2))
        self._shown = self._size > 0

    def best(self) -> Surrounded:
        """The scene with what explains it best."""
        scenery, asked = self._surrounded.scenery, self._asked
        kinds: tuple[Kind, ...] = ("occlusion", "bounce") if asked == "auto" else (asked,)  # type: ignore[assignment]
        tried = {kind: self._tried(Trial(kind, scenery, 1.0)) for kind in kinds}
        best = min(tried.values(), key=lambda trial: trial.score)
        best = self._with_extents(best)
        if asked == "auto":
            other: Kind = "bounce" if best.kind == "occlusion" else "occlusion"
            tried[other] = self._tried(Trial(other, best.scenery, 1.0), best)
            if tried[other].better_than(best):
                best = self._with_extents(tried[other])
        if best.kind == "bounce":
            best = self._with_gain(best)
        tried[best.kind] = best
        figures = {f"left_out_{kind}": one.score for kind, one in tried.items()}
        figures["left_out_pixels"] = float(len(best.left))
        transport = Transport(best.kind, "asked for", best.scenery.extents, best.gain, figures)
        found = Surrounded(self._surrounded.scene, transport, best.scenery)
        found._images = self._surrounded._images
        return found

    def _with_extents(self, best: Trial) -> Trial:
        """Change what no picture shows, one thing at a time, as long as that gains."""
        hopeful = list(candidates(best.scenery.extents))
        while hopeful and not self._out_of_time():
            trials = [
                self._tried(Trial(best.kind, best.scenery.with_extents(one), best.gain), best)
                for one in hopeful
            ]
            better = sorted(
                (trial for trial in trials if trial.better_than(best)),
                key=lambda trial: trial.score,
            )
            if not better:
                break
            before, best = best.scenery.extents, better[0]
            # What did not gain now is not tried again; what did, beside the best.
            hopeful = list(
                _changed_too(before, best.scenery.extents, [t.scenery.extents for t in better[1:]])
            )
        return best

    def _with_gain(self, best: Trial) -> Trial:
        for gain in settings.TRANSPORT_GAINS:
            trial = self._tried(Trial(best.kind, best.scenery, gain), best)
            if trial.score < best.score:
                best = trial
        return best

    def _tried(self, trial: Trial, near: Trial | None = None) -> Trial:
        """An alternative with its scores; lights begin at those of one that is `near`."""
        objective, surrounded = self._objective, self._surrounded
        halves = []
        for pixels in (self._fitted, self._left_out):
            half = objective.restricted(pixels)
            tables = surrounded.tables(
                objective,
                pixels,
                kind=trial.kind,
                scenery=trial.scenery,
                rays=settings.TRANSPORT_SEARCH_RAYS,
            )
            if tables is not None:
                half = half.among(replace(tables, gain=trial.gain))
            halves.append(half)
        few, left_out = halves
        part = objective.part_of(self._x, self._fitted) if near is None else near.x.copy()
        if near is None:
            part = few.with_best_lights(part)
        if few.lighting is not None:
            near_rounds = None if near is None else settings.TRANSPORT_NEAR_ROUNDS
            find_lights(few, part, self._out_of_time, near_rounds)
        other = objective.part_of(self._x, self._left_out)
        if few.lighting is not None:
            other[left_out.layout.maps.stop :] = part[few.layout.maps.stop :]
        sum_sq = fit_level(left_out, other)[self._shown]
        trial.left = np.log(
            np.maximum(sum_sq / self._size[self._shown], settings.NOISE_VARIANCE_MIN)
        )
        trial.x = part
        return trial


def find_lights(few: Objective, part: Array, stop: Stop, near_rounds: int | None = None) -> None:
    """Rounds of joint steps on some pixels, whose x changes; fewer from lights that are near."""
    shared = SharedFit(LightPrior.around(few, part))
    everything = np.arange(few.pixels, dtype=np.uint64)
    for number in range(near_rounds or settings.TRANSPORT_ROUNDS):
        prior = None
        if near_rounds is None and number < settings.DIELECTRIC_ROUNDS:
            prior = dielectric_prior(few, few.put_best_albedo(part, everything))
        sum_sq = fit_level(few, part, prior)
        variance = misfit.variance(few, sum_sq)
        shared.lights = shared.lights.weighing(variance, variance, few.pixels)
        fit = shared.joint_fit(few, part, sum_sq, prior=prior, stop=stop)
        minimize(fit, settings.COARSE_STEPS, 1.0)


def _changed_too(before: Extents, best: Extents, others: list[Extents]) -> Iterator[Extents]:
    """What others changed of the extents before, beside what the best did."""
    of_best = {name for name in vars(before) if getattr(before, name) != getattr(best, name)}
    for other in others:
        changes = {
            name: getattr(other, name)
            for name in vars(before)
            if getattr(other, name) != getattr(before, name)
        }
        if "blocks" in changes and "blocks" in of_best:
            flips = zip(before.blocks, best.blocks, other.blocks, strict=True)
            changes["blocks"] = tuple(b if o == a else o for a, b, o in flips)
            yield replace(best, **changes)
        elif not of_best & set(changes):
            yield replace(best, **changes)
    # And further the same way.
    for one in candidates(best):
        changed = {name for name in vars(best) if getattr(one, name) != getattr(best, name)}
        if changed and changed <= of_best - {"blocks", "ceiling"}:
            yield one
