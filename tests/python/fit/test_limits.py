"""Limits of a fit: whenever time is up, little is done from there on, and the result is whole."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import pbrfit
from pbrfit import Priors, Result, Scene, Status, _core
from pbrfit.fit import pixels, settings
from pbrfit.fit.run import Run
from pbrfit.result.options import SOLVERS, Solver
from pbrfit.synthetic import make_scene

SIZE, LIGHTS = 12, 3

CONFIGURATIONS: dict[str, dict[str, Any]] = {
    "gauss-newton": {},
    "lbfgsb": {"solver": "lbfgsb", "iterations": 60},
    "no priors": {"priors": Priors.none()},
    "normals on": {"refine_normals": "on", "iterations": 4},
    "normals on, lbfgsb": {"refine_normals": "on", "solver": "lbfgsb", "iterations": 3},
}

PASSES = 8
PASSES_WITH_NORMALS = 10
"""Over all pixels, after time is up: what is found is compared with what was there before, and what
looks at a thousand pixels at most looks at all of this picture."""


@functools.cache
def room() -> Scene:
    return make_scene("furnished", size=SIZE, lights=LIGHTS, held_out=1, noise=0.02, seed=3)


class Counting:
    """A `_core.Problem` that counts for how many pixels something is done."""

    def __init__(self, problem: Any, count: Callable[[int], None]) -> None:
        self._problem, self._count = problem, count

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._problem, name)
        if not callable(found):
            return found

        def counted(x: Any, *others: Any, **options: Any) -> Any:
            some = others and getattr(others[0], "dtype", None) == np.uint64
            self._count(len(others[0]) if some else self._problem.pixels)
            return found(x, *others, **options)

        return counted


class Clock:
    """A time limit that is reached at the n-th look at the clock."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, at: float) -> None:
        self.looks, self.done, self.done_after = 0, 0, 0
        self._at = at
        problem = _core.Problem
        monkeypatch.setattr(
            _core, "Problem", lambda *a, **k: Counting(problem(*a, **k), self.count)
        )
        monkeypatch.setattr(Run, "out_of_time", lambda _run: self.look())

    def look(self) -> bool:
        self.looks += 1
        return self.looks > self._at

    def count(self, done: int) -> None:
        self.done += done
        if self.looks > self._at:
            self.done_after += done


def fit(**options: Any) -> Result:
    given: dict[str, Any] = {
        "refine_normals": "off",
        "time_limit": 1e6,
        "uncertainty": False,
        "priors": Priors(),
    }
    return pbrfit.decompose(room(), **(given | options))


def assert_whole(result: Result) -> None:
    shape = (SIZE, SIZE)
    assert result.mask.all()
    assert result.materials.albedo.shape == (*shape, 3)
    for values in (result.materials.albedo, result.materials.roughness, result.materials.metallic):
        assert ((values >= 0) & (values <= 1)).all()
    assert result.lighting.shape == (LIGHTS, 16, 3)
    assert np.isfinite(result.lighting).all()
    assert np.isfinite(result.normals).all()
    assert np.isfinite(list(result.metrics.values())).all()
    assert len(result.history.rows) >= 1


@pytest.mark.slow
@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_whenever_time_is_up_little_is_done_from_there_on(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = CONFIGURATIONS[name]
    # Pieces and levels as small beside this picture as the real ones beside large pictures.
    monkeypatch.setattr(settings, "COARSE_PIXELS", 36)
    monkeypatch.setattr(pixels, "PIXELS_PER_CALL", 32)
    monkeypatch.setattr(settings, "PIXELS_AT_ONCE", 32)
    with monkeypatch.context() as patch:
        undisturbed = Clock(patch, np.inf)
        assert fit(**options).status is not Status.TIME_LIMIT
    last = undisturbed.looks
    done = {}
    for at in {0, 1, *np.linspace(2, last - 1, 5, dtype=int).tolist()}:
        with monkeypatch.context() as patch:
            clock = Clock(patch, at)
            result = fit(**options)
        assert result.status is Status.TIME_LIMIT, at
        assert_whole(result)
        done[at] = clock.done_after / SIZE**2
    passes = PASSES_WITH_NORMALS if "normals" in name else PASSES
    assert max(done.values()) <= passes < undisturbed.done / SIZE**2 / 3, done


@pytest.mark.parametrize("looks", range(3, 6))
def test_lbfgsb_ends_before_an_evaluation_or_after_an_iteration(
    looks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    Clock(monkeypatch, looks)
    result = fit(**CONFIGURATIONS["lbfgsb"])
    assert result.status is Status.TIME_LIMIT
    assert_whole(result)


@pytest.mark.parametrize("looks", [0, 1, 6])
def test_a_limit_while_lights_are_sought_leaves_all_pixels_fitted_under_them(
    looks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        Clock(patch, looks)
        result = fit()
    assert result.status is Status.TIME_LIMIT
    assert result.stop_reason == (
        "time limit of 1e+06 s reached in stage lights; all pixels were fitted once, under the "
        "lights so far"
    )
    names = [stage.name for stage in result.stages]
    assert names[names.index("lights") :][:2] == ["lights", "all pixels, once"]
    assert result.history.iterations == 1
    start, end = result.history["recon_rmse"][[0, -1]]
    assert end < 0.8 * start


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("refine_normals", ["off", "on"])
@pytest.mark.parametrize("time_limit", [0.0, 1e-6])
@pytest.mark.parametrize("robust", ["none", "auto"])
def test_no_time_at_all_is_enough_for_a_whole_result(
    solver: Solver, refine_normals: Any, time_limit: float, robust: Any
) -> None:
    result = fit(solver=solver, refine_normals=refine_normals, time_limit=time_limit, robust=robust)
    assert result.status is Status.TIME_LIMIT
    assert_whole(result)
