"""What to do next: each sentence follows from what is in a result, and none comes without."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from left_out_pictures import EXPLAINED, UNEXPLAINED
from pbrfit.fit.decompose import decompose
from pbrfit.model.materials import Materials
from pbrfit.result import advice
from pbrfit.result.advice import next_steps
from pbrfit.result.camera import FOV_DOUBTED, Camera
from pbrfit.result.data import Status
from pbrfit.result.light_sides import ASIDE, ONE_SIDE, one_side, unlit_sides
from pbrfit.result.result import Result
from pbrfit.result.verdict import PARAMETERS, Verdict, capped, level_of
from pbrfit.synthetic import make_scene
from result_files import CONTRADICTED
from scene_files import known

AROUND = np.array([(1.0, 0, 0), (-1, 0, 0), (0, 1, 0), (0, 0, 1)])


def lights(directions: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    """(N, 16, 3): most light from these directions (N, 3)."""
    found = np.zeros((len(directions), 16, 3))
    found[:, 0] = 1
    found[:, [3, 1, 2]] = 0.8 * np.asarray(directions)[..., None]
    return found


@pytest.fixture(scope="module")
def good() -> Result:
    """A result with which nothing is wrong."""
    scene = make_scene("room", size=8, lights=4, held_out=1)
    result = decompose(scene, iterations=0)
    return replace(
        result,
        status=Status.CONVERGED,
        lighting=lights(AROUND),
        lamps=None,
        camera=Camera(60.0, "given"),
        held_out=EXPLAINED,
        uncertainty=uncertainty(result, dict.fromkeys(PARAMETERS, 0.01)),
        materials=Materials(np.full((8, 8, 3), 0.5), np.full((8, 8), 0.5), np.zeros((8, 8))),
        mask=np.ones((8, 8), bool),
    )


def uncertainty(result: Result, errors: dict[str, float], cause: str = "", remedy: str = "") -> Any:
    verdicts = {
        name: Verdict(
            level := level_of(name, of), of, *(("", "") if level == "usable" else (cause, remedy))
        )
        for name, of in errors.items()
    }
    return replace(known(result.uncertainty), verdicts=verdicts)


def test_a_good_result_needs_nothing(good: Result) -> None:
    assert next_steps(good) == ()


def test_maps_share_a_cause(good: Result) -> None:
    errors = {"albedo": 0.01, "roughness": 0.3, "metallic": 0.3}
    wrong = replace(
        good, uncertainty=uncertainty(good, errors, "noise", "more pictures would help")
    )
    assert next_steps(wrong)[0] == "noise: more pictures would help roughness and metallic"


def test_no_more_than_a_few_are_named(good: Result) -> None:
    wrong = replace(
        good,
        status=Status.TIME_LIMIT,
        uncertainty=uncertainty(
            good, dict.fromkeys(PARAMETERS, 0.3), "noise", "pictures would help"
        ),
        camera=Camera(60.0, "assumed"),
    )
    steps = next_steps(wrong)
    assert len(steps) == advice.AT_MOST
    assert "option time_limit" in steps[0]
    assert steps[1] == "noise: pictures would help albedo, roughness and metallic"


@pytest.mark.parametrize(
    ("camera", "said"),
    [
        (Camera(60.0, "given"), None),
        (Camera(60.0, "assumed"), "is a guess, 60 degrees: the true one (option fov) would help"),
        (Camera(52.0, "fitted", FOV_DOUBTED), None),
        (Camera(52.0, "fitted", 1.01 * FOV_DOUBTED), "52 ± 5 degrees, fitted: the true one"),
        (CONTRADICTED, "but the pictures fit far better with about 88 ± 2: see"),
    ],
)
def test_a_doubtful_field_of_view(good: Result, camera: Camera, said: str | None) -> None:
    steps = next_steps(replace(good, camera=camera))
    assert steps == () if said is None else said in steps[0]


def test_a_fit_that_was_stopped(good: Result) -> None:
    [step] = next_steps(replace(good, status=Status.ITERATION_LIMIT))
    assert "option iterations" in step


def test_left_out_pictures_that_are_not_explained(good: Result) -> None:
    cause = "the fit explains pictures that were left out worse than the nearest picture does"
    remedy = "a mask, better normals or more pictures would help"
    [step] = next_steps(replace(good, held_out=UNEXPLAINED, uncertainty=None))
    assert step == f"{cause}: {remedy}"
    uncertainty = known(good.uncertainty)
    of_maps = replace(uncertainty, verdicts=capped(uncertainty.verdicts, UNEXPLAINED))
    [step] = next_steps(replace(good, held_out=UNEXPLAINED, uncertainty=of_maps))
    assert step == f"{cause}: {remedy} albedo, roughness and metallic"
    assert next_steps(replace(good, held_out=None)) == ()


def test_normals_that_face_the_camera(good: Result) -> None:
    flat = np.zeros((8, 8, 3))
    flat[..., 2] = 1
    [step] = next_steps(replace(good, normals=flat))
    assert "pbrfit normals" in step


def test_sides_without_light(good: Result) -> None:
    bad = uncertainty(good, {"albedo": 0.3, "roughness": 0.01, "metallic": 0.3})
    right = lights([(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.7, 0.7, 0)])
    [step] = next_steps(replace(good, uncertainty=bad, lighting=right))
    assert step == "no picture is lit from the left: such pictures would help metallic"
    one = lights([(1, 0, 0)] * 4)
    [step] = next_steps(replace(good, uncertainty=bad, lighting=one))
    assert step == (
        "light from one side, the right, in all pictures: pictures lit from the left would help "
        "metallic"
    )
    assert next_steps(replace(good, lighting=one)) == ()  # all is usable: it was enough


@pytest.mark.parametrize(("black", "told"), [(6, False), (7, True)])
def test_black_pixels_ask_for_a_mask(good: Result, black: int, told: bool) -> None:
    assert 6 / 64 < advice.BLACK_SHARE < 7 / 64
    albedo = np.full((8, 8, 3), 1.01 * advice.BLACK_ALBEDO)
    albedo.reshape(-1, 3)[:black] = advice.BLACK_ALBEDO
    dark = replace(good, materials=replace(good.materials, albedo=albedo))
    assert [step for step in next_steps(dark) if "mask" in step] == (
        ["11 % of the pixels are black, as a background is: a mask (mask.png) would leave them out"]
        if told
        else []
    )
    mask = np.ones((8, 8), bool)
    mask[-1, -1] = False
    assert next_steps(replace(dark, mask=mask)) == ()


def test_one_side_and_unlit_ones_at_their_thresholds() -> None:
    for length, one in ((0.999 * ONE_SIDE, False), (1.001 * ONE_SIDE, True)):
        aside = np.sqrt(1 - length**2)
        assert (one_side(np.array([(aside, 0, length), (-aside, 0, length)])) is not None) == one
    for component, unlit in ((0.999 * ASIDE, ["the right"]), (1.001 * ASIDE, [])):
        around = np.array([(-1, 0, 0), (0, 1, 0), (component, 0, np.sqrt(1 - component**2))])
        assert unlit_sides(around) == unlit
