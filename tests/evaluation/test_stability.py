"""The stability suite: its references, its verdicts, its report and its command."""

from __future__ import annotations

import math
from argparse import Namespace
from collections.abc import Callable
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from numpy.typing import NDArray

import pbrfit
import reference
from pbrfit_evaluation.jobs import Record, Values
from pbrfit_evaluation.stability import edges, figures, stiff_fits
from pbrfit_evaluation.stability.double_precision import Case, evaluate, random_case
from pbrfit_evaluation.stability.sections import SECTIONS, Task
from pbrfit_evaluation.stability.sections import run as run_section
from pbrfit_evaluation.suite import Results
from scene_files import known

Array = NDArray[np.floating[Any]]


def case_of(pixels: int, pictures: int, seed: int = 0) -> Case:
    return random_case(np.random.default_rng(seed), pixels, pictures)


def test_double_precision_path_against_independent_objective() -> None:
    case = case_of(37, 3)
    found = evaluate(case)
    p = case.pixels
    loss, gradient = reference.value_and_grad(
        case.images.astype(np.float64), p.normals, p.views, case.x
    )
    assert found.loss == pytest.approx(loss, rel=1e-13)
    assert np.abs(found.gradient - gradient).max() <= 1e-12 * np.abs(gradient).max()


TINY: dict[str, tuple[int, ...]] = {
    "fast objective": (256,),
    "cancellation": (16,),
    "accumulated error": (3, 8, 1),
    "tiny numbers": (600,),
    "stiff fits": (5, 4, 2),
    "edges": (1,),
}


def judged(section: str, values: Values | None = None) -> dict[str, bool]:
    """Whether the figures of a section hold, by their keys; measured if not given."""
    task = Task(section, TINY[section], 0)
    record = Record(task.key, run_section(task, 1) if values is None else values, None, 0.0)
    results = Results(Namespace(), [(task, record)])
    keys = figures.worst_of(task, known(record.values))
    return dict(zip(keys, (v.holds for v in figures.verdicts(results)), strict=True))


def failures(section: str) -> set[str]:
    return {key for key, holds in judged(section).items() if not holds}


Distort = Callable[[float, Array, Case], tuple[float, Array]]


class Distorted:
    """A problem whose loss and gradient go through a function first."""

    def __init__(self, case: Case, threads: int, distort: Distort) -> None:
        pixels = case.pixels
        self._problem = pbrfit._core.Problem(case.images, pixels.normals, pixels.views, threads)
        self._case, self._distort = case, distort

    def value_and_grad(self, x: NDArray[np.float64]) -> tuple[float, Array]:
        return self._distort(*self._problem.value_and_grad(x), self._case)


def scaled_block(name: str, factor: float) -> Distort:
    def how(loss: float, gradient: Array, case: Case) -> tuple[float, Array]:
        gradient[case.blocks()[name]] *= factor
        return loss, gradient

    return how


def one_wrong_pixel(loss: float, gradient: Array, case: Case) -> tuple[float, Array]:
    """One entry of hundreds, off by 2e-5 of itself, shows beside its natural scale only."""
    albedo = gradient[case.blocks()["albedo"]]
    albedo[np.argsort(np.abs(albedo))[len(albedo) // 2]] *= 1 + 2e-5
    return loss, gradient


def nonsense(loss: float, gradient: Array, _: Case) -> tuple[float, Array]:
    return loss * math.nan, gradient * math.nan


@pytest.mark.parametrize(
    ("section", "how", "key"),
    [
        ("fast objective", lambda loss, gradient, _: (loss * (1 + 5e-6), gradient), "loss_error"),
        ("fast objective", nonsense, "loss_error"),
        ("fast objective", scaled_block("roughness", 1 + 5e-6), "roughness_block_error"),
        ("fast objective", scaled_block("lights", math.nan), "lights_entry_error"),
        ("fast objective", one_wrong_pixel, "albedo_entry_error"),
        ("accumulated error", scaled_block("lights", 1 + 1e-4), "lights_error_one_sign"),
        ("edges", scaled_block("lights", 1 + 1e-4), "float32_error"),
        ("tiny numbers", lambda loss, gradient, _: (loss, gradient + 1e-30), "nonzero"),
        ("tiny numbers", lambda loss, gradient, _: (loss, gradient * math.inf), "not_finite"),
        ("tiny numbers", lambda loss, gradient, _: (loss + 1e-35, gradient), "exposure_error"),
    ],
)
@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
def test_wrong_objective_fails(
    monkeypatch: pytest.MonkeyPatch, section: str, how: Distort, key: str
) -> None:
    monkeypatch.setattr(Case, "problem", lambda case, threads=0: Distorted(case, threads, how))
    assert key in failures(section)


def test_a_fit_that_is_worse_or_unflagged_or_broken_fails_its_check() -> None:
    def failed(**facts: float) -> list[str]:
        values = {"rows": {"a; gauss-newton": facts, "b; gauss-newton": {}}}
        return [key for key, holds in judged("stiff fits", values).items() if not holds]

    above = stiff_fits.above
    assert failed(fits_above_lbfgsb=above(1e-3, 1e-3)) == []
    assert failed(fits_above_lbfgsb=above(2e-7, 1e-9)) == []  # both below what float32 shows
    for residual in (1.1e-3, math.nan):
        assert failed(fits_above_lbfgsb=above(residual, 1e-3)) == ["fits_above_lbfgsb"]
    for key in ("fits_not_finite", "fits_beyond", "fits_iterations_over", "fits_overlooked"):
        assert failed(**{key: 1}) == [key]


def test_what_goes_wrong_at_an_edge_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    scenes = (edges.drawn(np.random.default_rng(seed)) for seed in range(100))
    one = next(scene for scene in scenes if scene.lamps is not None)
    of_unit, most = pbrfit._core.lamp_radiance, known(SECTIONS["edges"].bounds["lamps_error"][1])
    assert edges.errors(one, 1)["lamps_error"] <= most
    monkeypatch.setattr(pbrfit._core, "lamp_radiance", lambda *of: of_unit(*of) * (1 + 1e-9))
    assert edges.errors(one, 1)["lamps_error"] > most
    for error, failed in ((pbrfit.InputError("no light"), 0), (ValueError("no light"), 1)):
        monkeypatch.setattr(edges, "decompose", Mock(side_effect=error))
        assert edges.fitted(one, 1)["fits_failed"] == failed
        assert "no light" in edges.fitted(one, 1)["ended by"]
