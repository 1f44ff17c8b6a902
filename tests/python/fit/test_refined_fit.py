"""Refined normals from scene to result: what is found, what is kept, what scenes may lack."""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pbrfit import Result, Scene, Status, decompose
from pbrfit.model.geometry import angles_between
from pbrfit.result.refinement import RefineNormals
from pbrfit.synthetic import make_scene
from pbrfit_evaluation.normals.measure import disturbed
from scene_files import known, truth_of

SIZE, PICTURES = 12, 6


@functools.cache
def right(size: int = SIZE, pictures: int = PICTURES, noise: float = 0.0) -> Scene:
    return make_scene("room", size=size, lights=pictures, held_out=1, noise=noise)


def wrong(scene: Scene, degrees: float = 5.0) -> Scene:
    return dataclasses.replace(scene, normals=disturbed(scene, "correlated", degrees, 1))


@functools.cache
def arguments() -> dict[str, Any]:
    """A room with wrong normals, and nothing else that could be done without."""
    made = wrong(right(), 10.0)
    return {"images": made.images, "normals": made.normals, "fov": made.fov}


def small(**changes: Any) -> Scene:
    return Scene(**(arguments() | changes))


def off_by(result: Result, scene: Scene) -> float:
    """Mean angle between the result's normals and the true ones, degrees."""
    angles = angles_between(result.normals, np.asarray(scene.normals, dtype=np.float64))
    return float(angles[result.mask].mean())


def check(result: Result, scene: Scene) -> None:
    """All that a result says is finite, and goes together."""
    inside = result.mask
    for name in ("albedo", "roughness", "metallic"):
        values = getattr(result, name)[inside]
        assert np.isfinite(values).all(), name
        assert values.min() >= 0, name
        assert values.max() <= 1, name
    assert np.isfinite(result.lighting).all()
    assert all(math.isfinite(value) for value in result.metrics.values())
    lengths = np.linalg.norm(result.normals[inside], axis=-1)
    np.testing.assert_allclose(lengths, 1, rtol=0, atol=1e-6)
    given = np.asarray(scene.normals, dtype=np.float64)
    refinement = result.refinement
    if not refinement.refined:
        np.testing.assert_array_equal(result.normals[inside], given[inside])
        assert result.given_normals is None
        assert result.normal_change is None
        return
    np.testing.assert_array_equal(known(result.given_normals)[inside], given[inside])
    change = known(result.normal_change)[inside]
    assert np.isfinite(change).all()
    assert refinement.figures["mean_change_degrees"] == pytest.approx(change.mean())


def same(one: Result, other: Result) -> None:
    """To the last bit."""
    for name in ("albedo", "roughness", "metallic", "normals", "lighting"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    assert (one.status, one.stop_reason) == (other.status, other.stop_reason)
    assert one.metrics == other.metrics


@pytest.fixture(scope="module")
def room() -> Scene:
    return right(20, 8)


@pytest.mark.slow
@pytest.mark.parametrize("asked", ["on", "auto"])
def test_wrong_normals_are_put_right_and_materials_with_them(
    room: Scene, asked: RefineNormals
) -> None:
    given = wrong(room)
    before = decompose(given, refine_normals="off", iterations=60, uncertainty=False)
    after = decompose(given, refine_normals=asked, iterations=60, uncertainty=False)
    check(after, given)
    assert after.refinement.refined
    assert off_by(before, room) > 5
    assert off_by(after, room) < 1
    assert after.metrics["recon_rmse"] < 0.1 * before.metrics["recon_rmse"]
    for name in ("albedo_rmse", "roughness_rmse", "metallic_rmse", "relight_rmse"):
        assert after.metrics[name] < 0.5 * before.metrics[name], name
    assert 3 < after.refinement.figures["mean_change_degrees"] < 10


@pytest.mark.usefixtures("uncompared")
def test_normals_are_put_right_in_known_lights(room: Scene) -> None:
    given = dataclasses.replace(wrong(room), lighting=truth_of(room).lighting)
    before, after = (
        decompose(given, refine_normals=asked, iterations=60, uncertainty=False)
        for asked in ("off", "on")
    )
    check(after, given)
    np.testing.assert_array_equal(after.lighting, truth_of(room).lighting)
    assert off_by(after, room) < 0.3 * off_by(before, room)
    assert after.metrics["recon_rmse"] < 0.3 * before.metrics["recon_rmse"]


def test_true_normals_are_kept_and_change_nothing() -> None:
    scene = right(noise=0.01)
    options: dict[str, Any] = {"iterations": 60, "light": "sh"}
    auto, off = (decompose(scene, refine_normals=asked, **options) for asked in ("auto", "off"))
    assert not auto.refinement.refined
    check(auto, scene)
    same(auto, off)
    np.testing.assert_array_equal(
        known(auto.uncertainty).deviation.roughness, known(off.uncertainty).deviation.roughness
    )


@pytest.mark.usefixtures("uncompared")
@pytest.mark.parametrize(
    "options",
    [
        {"fov": 90.0},
        *(pytest.param(of, marks=pytest.mark.slow) for of in ({"sh_order": 2}, {"metallic": 0.5})),
    ],
    ids=str,
)
def test_asked_for_or_not_no_more_is_left_than_by_the_given_ones(options: dict[str, Any]) -> None:
    """Where the model is wrong, other normals may explain more, and must not explain less."""
    scene = make_scene("room", size=SIZE, lights=8, seed=1, held_out=1, noise=0.01)
    scene = dataclasses.replace(scene, fov=options.get("fov", scene.fov))
    options = {name: value for name, value in options.items() if name != "fov"}
    off, on = (
        decompose(scene, refine_normals=asked, light="sh", uncertainty=False, **options)
        for asked in ("off", "on")
    )
    check(on, scene)
    if on.refinement.refined:
        assert on.metrics["recon_rmse"] <= off.metrics["recon_rmse"]
    else:
        np.testing.assert_array_equal(on.normals, scene.normals)


@pytest.mark.parametrize("limit", [0.0, 1e-3, 0.05, 0.3])
def test_a_short_time_leaves_a_finite_answer_that_says_so(limit: float) -> None:
    scene = small()
    result = decompose(scene, refine_normals="on", time_limit=limit, uncertainty=False)
    check(result, scene)
    if limit < 0.01:
        assert result.status == Status.TIME_LIMIT
        assert not result.refinement.refined
        assert result.refinement.why == "the time limit came first"


@pytest.mark.parametrize("asked", ["on", "auto"])
def test_no_iterations_leave_the_normals_alone(asked: RefineNormals) -> None:
    scene = wrong(small())
    result = decompose(scene, refine_normals=asked, iterations=0)
    check(result, scene)
    assert not result.refinement.refined
    assert result.refinement.why == "0 iterations asked for"


def test_auto_refines_nothing_where_nothing_is_compared() -> None:
    result = decompose(wrong(small()), solver="lbfgsb", iterations=3, uncertainty=False)
    assert result.status == Status.ITERATION_LIMIT
    assert not result.refinement.refined
    assert result.refinement.why == "explanations were not compared"


@pytest.mark.slow
@pytest.mark.parametrize("asked", ["on", "auto"])
@pytest.mark.parametrize(
    "options",
    [
        {"robust": "none"},
        {"priors": None},
        {"metallic": 0.0},
        {"mono_light": True},
        {"sh_order": 2},
        {"solver": "lbfgsb"},
        {"solver": "gauss-newton"},
        {"equal_exposures": True},
        {"metallic": 0.5, "mono_light": True, "sh_order": 2, "priors": None},
    ],
    ids=str,
)
def test_normals_are_refined_with_all_options(
    asked: RefineNormals, options: dict[str, Any]
) -> None:
    scene = small()
    result = decompose(scene, refine_normals=asked, iterations=5, **options)
    check(result, scene)
    if "metallic" in options:
        np.testing.assert_array_equal(result.metallic, options["metallic"])


def mask_of(*pixels: tuple[Any, Any]) -> NDArray[np.bool_]:
    mask = np.zeros((SIZE, SIZE), bool)
    for pixel in pixels:
        mask[pixel] = True
    return mask


def scenes() -> dict[str, Scene]:
    made = small()
    images, normals = np.array(made.images), np.array(made.normals)
    rng = np.random.default_rng(0)
    grey = images.mean(axis=-1, keepdims=True).repeat(3, axis=-1)
    known = truth_of(right()).lighting
    assert known is not None
    weights = rng.uniform(0.2, 1, size=images.shape[:3])
    weights[0, :3] = 0
    unseen = np.ones(images.shape[:3])
    unseen[1:, 4, 4] = 0
    black, patch = images.copy(), images.copy()
    black[2] = 0
    patch[:, 3:6, 3:6] = 0
    facing_away = normals.copy()
    facing_away[4:8, 4:8] *= -1
    odd = np.full((SIZE, SIZE), -5)  # ids that are large and negative, one beside the mask
    odd[3, 4], odd[6:], odd[:2] = 10**9, 0, 77
    sigma = np.linspace(0, 20, SIZE**2).reshape(SIZE, SIZE)
    segments = np.where(np.arange(SIZE) < 5, 3, 0) + np.zeros((SIZE, 1), int)
    return {
        "grey": small(images=grey),
        "known lights": small(lighting=known),
        "known grey lights": small(images=grey, lighting=known[..., :1].repeat(3, axis=-1)),
        "three pictures": small(images=images[:3]),
        "two pictures": small(images=images[:2]),
        "one picture in known light": small(images=images[:1], lighting=known[:1]),
        "flat": small(normals=np.broadcast_to([0.0, 0, 1], normals.shape)),
        "a patch faces away": small(normals=facing_away),
        "all face away": small(normals=np.broadcast_to([0.0, 0, -1], normals.shape)),
        "sideways": small(normals=np.broadcast_to([1.0, 0, 0], normals.shape)),
        "the same picture again and again": small(images=images[:1].repeat(5, axis=0)),
        "weights": small(weights=weights),
        "a pixel that one picture shows": small(weights=unseen),
        "segments": small(segments=segments),
        "odd segments": small(segments=odd, mask=mask_of((slice(2, None), slice(None)))),
        "every pixel a segment": small(segments=1 + np.arange(SIZE**2).reshape(SIZE, SIZE)),
        "islands": small(
            mask=mask_of((slice(4), slice(4)), (slice(6, None), slice(7, 10)), (2, 9), (11, 0))
        ),
        "no two neighbours": small(mask=np.indices((SIZE, SIZE)).sum(axis=0) % 2 == 0),
        "one valid pixel": small(mask=mask_of((5, 7))),
        "a black picture": small(images=black),
        "a black patch": small(images=patch),
        "constant pictures": small(images=np.full_like(images, 0.3)),
        "bright": small(images=images * 1e6),
        "dim": small(images=images * 1e-6),
        "noise alone": small(images=rng.uniform(0, 1, images.shape)),
        "1 × 1": Scene(images=images[:, :1, :1], normals=normals[:1, :1]),
        "1 × 12": Scene(images=images[:, 4:5], normals=normals[4:5]),
        "12 × 1": Scene(images=images[:, :, 4:5], normals=normals[:, 4:5]),
        "2 × 1": Scene(images=images[:, 2:4, 4:5], normals=normals[2:4, 4:5]),
        "how sure normals are": small(normal_sigma=sigma),
    }


SCENES = scenes()

HOW: dict[str, dict[str, Any]] = {
    "on": {"refine_normals": "on"},
    "auto": {},
    "gauss-newton": {"refine_normals": "off", "solver": "gauss-newton"},
    "lbfgsb": {"refine_normals": "off", "solver": "lbfgsb"},
}


@pytest.mark.slow
@pytest.mark.parametrize("how", HOW)
@pytest.mark.parametrize("name", SCENES)
def test_scenes_of_all_kinds_have_a_finite_answer(name: str, how: str) -> None:
    result = decompose(SCENES[name], iterations=5, **HOW[how])
    check(result, SCENES[name])
    assert np.isnan(result.roughness[~result.mask]).all()
