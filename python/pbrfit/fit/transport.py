"""Surroundings that may block the light of a scene with depth, or also bring some.

What no picture shows (`Extents`), and whether surroundings also bring light, is searched. Two sets
of pixels, of some hundred each, judge: lights are fitted to the first together with its materials;
then pixels of the second, with these lights, find their best materials, and what is left of them is
the score: the mean over pixels of ln(Σ residual²/Σ radiance²). A pixel has five unknowns whatever
surroundings are, and the lights know nothing of it, so more freedom gains nothing by itself. One
alternative is better where the mean of the paired differences is more than `COMPARE_ERRORS_MIN`
of its standard errors below 0, with Bonferroni's correction for the number that are tried.

Whether the pictures are explained better with the surroundings that are found than without is
decided by left-out pictures (`pbrfit.fit.compare`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import misfit, settings
from pbrfit.fit.joint import JointFit, SharedFit, minimize
from pbrfit.fit.light_prior import LightPrior
from pbrfit.fit.objective import Objective
from pbrfit.fit.pixels import fit_level
from pbrfit.fit.sampling import Pixels, evenly_spaced
from pbrfit.lazy import lazy
from pbrfit.scene.scene import Scene
from pbrfit.transport.decision import Kind, Transport, candidates
from pbrfit.transport.scenery import PixelTransfer, Scenery, filled
from pbrfit.values.arrays import Array


class Surrounded:
    """A scene among its surroundings: tables for an objective of any of its parts."""

    def __init__(self, scene: Scene, transport: Transport, scenery: Scenery) -> None:
        self.scene, self.transport, self.scenery = scene, transport, scenery

    @lazy
    def images(self) -> NDArray[np.float32]:
        """(H, W, N, C): the pictures, filled where the mask has nothing."""
        scene = self.scene
        channels = 1 if scene.grey else 3
        pictures = [
            filled(scene.picture(i, slice(None))[..., :channels], scene.valid)
            for i in range(len(scene.images))
        ]
        return np.stack(pictures, axis=2)

    def tables(
        self,
        objective: Objective,
        pixels: Pixels | None = None,
        *,
        rays: int = settings.TRANSPORT_RAYS,
    ) -> PixelTransfer | None:
        """Of pixels of an objective, of the scene or a window of it; None if nothing blocks."""
        if not self.transport.blocks:
            return None
        return self.scenery.transfer(
            objective.places_in(self.scene, pixels),
            objective.model,
            rays=rays,
            threads=objective.threads,
            images=self.images if self.transport.kind == "bounce" else None,
        )


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
    found = Surrounded(scene, Transport(), scenery)
    kinds: tuple[Kind, ...] = ("occlusion", "bounce") if asked == "auto" else (asked,)  # type: ignore[assignment]
    of = _Search(objective, found, out_of_time)
    tried = {kind: of.tried(kind, scenery) for kind in kinds}
    best = of.with_extents(min(tried.values(), key=_score))
    for other in set(kinds) - {best.kind}:
        tried[other] = of.tried(other, best.scenery, best)
        if _score(tried[other]) < _score(best):
            best = of.with_extents(tried[other])
    tried[best.kind] = best
    figures = {f"left_out_{kind}": _score(one) for kind, one in tried.items()}
    figures["left_out_pixels"] = float(len(best.left))
    found.scenery = best.scenery
    found.transport = Transport(best.kind, "asked for", best.scenery.extents, figures=figures)
    return found


@dataclass(frozen=True, eq=False)
class _Trial:
    """An alternative, the x of fitted pixels, and what was left of left-out pixels (Q,)."""

    kind: Kind
    scenery: Scenery
    x: Array
    left: Array

    def better_than(self, other: _Trial, tried: int) -> bool:
        """Whether what it left is surely less, as one of so many that were tried (Bonferroni)."""
        from scipy.special import ndtr, ndtri

        difference = self.left - other.left
        error = float(difference.std(ddof=1)) / np.sqrt(len(difference))
        errors = ndtri(ndtr(-settings.COMPARE_ERRORS_MIN) / tried)
        return bool(difference.mean() < errors * error)


def _score(trial: _Trial) -> float:
    return float(trial.left.mean())


class _Search:
    """Fits alternatives to the same pixels, and judges them by the same others."""

    def __init__(
        self, objective: Objective, surrounded: Surrounded, out_of_time: Callable[[], bool]
    ) -> None:
        self._objective, self._x = objective, objective.start()
        self._surrounded, self._out_of_time = surrounded, out_of_time
        chosen = evenly_spaced(objective.pixels, 2 * settings.TRANSPORT_PIXELS)
        self._fitted, self._left_out = chosen[::2], chosen[1::2]
        self._size = np.square(objective.pictures(self._left_out)).sum(axis=(0, 2))

    def with_extents(self, best: _Trial) -> _Trial:
        """Change what no picture shows, one thing at a time, as long as that gains."""
        # With as many rounds as those that begin at its lights.
        best = self.tried(best.kind, best.scenery, best)
        hopeful = list(range(len(list(candidates(best.scenery.extents)))))
        while hopeful and not self._out_of_time():
            changed = list(candidates(best.scenery.extents))
            trials = {
                i: self.tried(best.kind, best.scenery.with_extents(changed[i]), best)
                for i in hopeful
            }
            # What does not gain now is not tried again.
            hopeful = [i for i, trial in trials.items() if trial.better_than(best, len(changed))]
            best = min((trials[i] for i in hopeful), key=_score, default=best)
        return best

    def tried(self, kind: Kind, scenery: Scenery, near: _Trial | None = None) -> _Trial:
        """An alternative; its lights begin at those of one that is `near`."""
        objective = self._objective
        self._surrounded.transport, self._surrounded.scenery = Transport(kind), scenery
        few, left_out = (
            objective.restricted(pixels).among(
                self._surrounded.tables(objective, pixels, rays=settings.TRANSPORT_RAYS // 4)
            )
            for pixels in (self._fitted, self._left_out)
        )
        x = objective.part_of(self._x, self._fitted) if near is None else near.x.copy()
        if near is None:
            x = few.with_best_lights(x)
        other = objective.part_of(self._x, self._left_out)
        if few.lighting is not None:
            rounds = settings.GLOBAL_ROUNDS_MAX if near is None else 1
            shared = SharedFit(LightPrior.around(few, x))
            for _ in range(rounds):
                sum_sq = fit_level(few, x)
                variance = misfit.variance(few, sum_sq)
                shared.lights = shared.lights.weighing(variance, variance, few.pixels)
                fit = JointFit(few, x, sum_sq, shared, stop=self._out_of_time)
                minimize(fit, settings.COARSE_STEPS, 1.0)
            other[left_out.layout.maps.stop :] = x[few.layout.maps.stop :]
        shown = self._size > 0
        left = fit_level(left_out, other)[shown] / self._size[shown]
        return _Trial(kind, scenery, x, np.log(np.maximum(left, settings.NOISE_VARIANCE_MIN)))
