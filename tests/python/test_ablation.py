"""The ablation: its scenes."""

from __future__ import annotations

import numpy as np
import pytest

import pbrfit
from pbrfit.evaluation.ablation import cases
from pbrfit.evaluation.ablation.cases import CASES, case, constant, merged, shifted, varied
from pbrfit.scene import Scene, Truth
from pbrfit.synthetic import make_scene
from pbrfit.synthetic.exposure import MEAN_RADIANCE

SIZE, SEED = 24, 2000


def truth_of(scene: Scene) -> Truth:
    assert scene.truth is not None
    return scene.truth


def segments_of(scene: Scene) -> cases.Ids:
    assert scene.segments is not None
    return scene.segments


# Scenes


@pytest.mark.parametrize("kind", ["room", "textured"])
def test_materials_are_constant_in_each_segment(kind: str) -> None:
    scene = case("constant", SEED, size=SIZE, kind=kind)  # type: ignore[arg-type]
    found = truth_of(scene).materials
    for i in np.unique(segments_of(scene)):
        here = segments_of(scene) == i
        assert len(np.unique(found.roughness[here])) == 1
        assert len(np.unique(found.metallic[here])) == 1
    assert set(np.unique(found.metallic)) == {0.0, 1.0}


def test_the_constant_room_is_the_room() -> None:
    made, plain = (
        case("constant", SEED, size=SIZE),
        make_scene("room", size=SIZE, seed=SEED, noise=0.01),
    )
    np.testing.assert_allclose(made.images, plain.images, atol=1e-12)
    np.testing.assert_array_equal(segments_of(made), segments_of(plain))


@pytest.mark.parametrize("name", CASES)
def test_truth_explains_the_pictures_but_for_the_noise(name: cases.CaseName) -> None:
    scene = case(name, SEED, size=SIZE)
    truth = truth_of(scene)
    for images, lighting, noise in (
        (scene.images, truth.lighting, 0.01),
        (truth.relight_images, truth.relight_lighting, 0.0),
    ):
        assert images is not None
        assert lighting is not None
        rendered = pbrfit.render(truth.materials, scene.normals, lighting, scene.fov)
        assert np.std(images - rendered) == pytest.approx(noise, rel=0.03, abs=1e-12)
    assert scene.images.mean() == pytest.approx(MEAN_RADIANCE, abs=1e-3)


def test_wrong_segments_leave_the_pictures_as_they_are() -> None:
    right = case("constant", SEED, size=SIZE)
    for name in ("shifted", "merged", "none"):
        np.testing.assert_array_equal(case(name, SEED, size=SIZE).images, right.images)
    assert case("none", SEED, size=SIZE).segments is None


def test_roughness_varies_inside_segments_and_nothing_else_does() -> None:
    scene, plain = case("varying", SEED, size=64), case("constant", SEED, size=64)
    found, before = truth_of(scene).materials, truth_of(plain).materials
    np.testing.assert_array_equal(found.metallic, before.metallic)
    np.testing.assert_array_equal(found.albedo, before.albedo)
    deviations, means = [], []
    for i, count in zip(*np.unique(segments_of(scene), return_counts=True), strict=True):
        if count >= 64:
            here = segments_of(scene) == i
            deviations.append(found.roughness[here].std())
            means.append(abs(found.roughness[here].mean() - before.roughness[here].mean()))
    assert len(deviations) >= 10
    assert min(deviations) >= 0.06  # some of a pattern may be clipped
    assert max(deviations) <= cases.SPREAD[1] + 1e-12
    assert np.median(deviations) >= cases.SPREAD[0]
    assert max(means) < 0.05


def test_patterns_are_the_same_at_any_size() -> None:
    fine, coarse = np.ones((60, 60), np.uint16), np.ones((20, 20), np.uint16)
    found = [
        varied(np.full(ids.shape, 0.5), ids, np.random.default_rng(3)) for ids in (fine, coarse)
    ]
    # Pixel centres of the coarse picture are those of every third pixel, from the second.
    sampled = found[0][1::3, 1::3]
    assert np.corrcoef(sampled.ravel(), found[1].ravel())[0, 1] > 0.999999


def test_a_segment_of_one_pixel_stays_as_it_is() -> None:
    found = varied(np.full((1, 1), 0.7), np.ones((1, 1), np.uint16), np.random.default_rng(0))
    assert found == 0.7


def test_the_median_is_a_value_that_occurs() -> None:
    values = np.array([[0.0, 0.0, 1.0, 1.0]])
    materials = pbrfit.Materials(albedo=np.ones((1, 4, 3)), roughness=values, metallic=values)
    found = constant(materials, np.ones((1, 4), np.uint16))
    assert set(np.unique(found.metallic)) == {0.0}


def test_shifted_by_one_pixel_right_and_down() -> None:
    ids = np.arange(1, 13).reshape(3, 4)
    np.testing.assert_array_equal(shifted(ids), [[1, 1, 2, 3], [1, 1, 2, 3], [5, 5, 6, 7]])


def test_a_third_takes_the_ids_of_others() -> None:
    ids = np.repeat(np.repeat(np.arange(1, 13).reshape(3, 4), 2, axis=0), 2, axis=1)
    near = 0
    for seed in range(20):
        found = merged(ids, np.random.default_rng(seed))
        pairs = np.unique(np.stack([ids.ravel(), found.ravel()]), axis=1).T
        assert len(pairs) == 12  # segments stay whole
        changed = [(int(old), int(new)) for old, new in pairs if old != new]
        assert len(changed) == 4
        assert len(np.unique(found)) == 8
        assert not {old for old, _ in changed} & {new for _, new in changed}
        near += sum(
            abs(a - b) == 4 or (abs(a - b) == 1 and (a - 1) // 4 == (b - 1) // 4)
            for a, b in changed
        )
    # Of 80, at least every second one, but for those that have none but takers around them. Of
    # ids drawn from all alike, 34 / 132 would be near: some 21.
    assert 36 <= near <= 60


def test_a_single_segment_stays() -> None:
    ids = np.full((2, 2), 7)
    np.testing.assert_array_equal(merged(ids, np.random.default_rng(0)), ids)


@pytest.mark.parametrize(
    ("name", "noise", "message"),
    [
        ("wrong", 0.01, "case: expected one of constant, varying, shifted, merged, none"),
        ("constant", -1.0, "noise: expected a finite standard deviation >= 0, found -1.0"),
        ("constant", np.nan, "noise: expected"),
    ],
)
def test_what_makes_no_scene_is_refused(name: str, noise: float, message: str) -> None:
    with pytest.raises(pbrfit.InputError, match=message):
        case(name, SEED, noise=noise)  # type: ignore[arg-type]
