"""`pbrfit evaluate everyday`: disturbances are what they say, verdicts can fail, files are written.

How well disturbed scenes are fitted is not tested here: verdicts are on figures made by hand.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from evaluation_tasks import recorded
from pbrfit.fit.decompose import decompose
from pbrfit.io.color import encode_srgb
from pbrfit.model.reflection import render
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.everyday import disturbances, figures, measure
from pbrfit_evaluation.everyday.disturbances import (
    BAD_PICTURE,
    NOISE,
    PICTURES,
    TITLES,
    Disturbance,
    disturbed,
    twin_of,
)
from pbrfit_evaluation.everyday.figures import COVERED, MOST
from pbrfit_evaluation.grid import Case
from pbrfit_evaluation.suite import Results, Verdict
from scene_files import known, truth_of

SIZE, SEED = 16, 7

Pair = tuple[Disturbance, Any]
"""What was found after a disturbance; a text is an error."""


def made(disturbance: Disturbance, size: int = SIZE) -> Scene:
    return disturbed(disturbance, "room", SEED, size)


@pytest.fixture(scope="module")
def noise() -> Scene:
    return made("noise")


@pytest.fixture(scope="module")
def clean() -> Scene:
    return made("clean")


def others() -> list[int]:
    return [i for i in range(PICTURES) if i != BAD_PICTURE]


def test_the_reference_has_noise_and_the_clean_scene_none_but_rounding(
    noise: Scene, clean: Scene
) -> None:
    truth = truth_of(clean)
    lit = render(truth.materials, clean.normals, known(truth.lighting), 60, model="paper")
    np.testing.assert_allclose(clean.images, lit, rtol=6e-8)
    assert noise.images.dtype == np.float32
    assert (noise.images - lit).std() == pytest.approx(NOISE, rel=0.03)


@pytest.mark.parametrize("disturbance", ["hot", "clipped", "brightest", "shifted", "another"])
def test_what_is_not_disturbed_is_the_reference(disturbance: Any, noise: Scene) -> None:
    found, before = made(disturbance).images, noise.images
    changed = found != before
    if disturbance in ("shifted", "another"):
        assert not changed[others()].any()
        assert changed[BAD_PICTURE].mean() > 0.9
    elif disturbance == "hot":
        assert changed.mean() == pytest.approx(disturbances.HOT_SHARE, rel=0.5)
        most = disturbances.HOT_RANGE * noise.images.mean()
        assert 0.5 * most < found[changed].max() <= most
    else:
        limit = found.max()
        np.testing.assert_array_equal(found, np.minimum(before, limit))
        if disturbance == "clipped":
            assert limit == np.float32(disturbances.CLIPPED_AT)
        else:
            assert changed.mean() == pytest.approx(0.002, rel=0.1)


def test_bad_pictures(noise: Scene) -> None:
    before = noise.images[BAD_PICTURE]
    moved = made("shifted").images[BAD_PICTURE]
    np.testing.assert_array_equal(moved[:, 2:], before[:, :-2])
    np.testing.assert_array_equal(moved[:, :2], before[:, [0, 0]])
    black = made("black").images
    assert np.abs(black[BAD_PICTURE].mean()) < NOISE
    assert black[BAD_PICTURE].std() == pytest.approx(NOISE, rel=0.1)
    np.testing.assert_array_equal(black[others()], noise.images[others()])


def test_gamma_keeps_white_and_vignetting_takes_30_percent_of_the_corners(noise: Scene) -> None:
    white = np.quantile(noise.images, disturbances.UNCLIPPED)
    bright = noise.images > 0.01
    ratio = np.log(made("gamma").images[bright] / white)
    np.testing.assert_allclose(ratio, 1.1 * np.log(noise.images[bright] / white), atol=1e-5)
    even = disturbances.vignetted(np.ones((1, 101, 201, 3)))
    assert even[0, 50, 100] == pytest.approx(1)
    assert even[0, 0, 0] == pytest.approx(0.7, abs=0.01)
    np.testing.assert_allclose(even, even[:, ::-1, ::-1])


def test_a_grey_scene_is_grey_and_its_truth_explains_it(clean: Scene) -> None:
    grey, truth = made("grey"), truth_of(made("grey"))
    lit = render(truth.materials, grey.normals, known(truth.lighting), 60, model="paper")
    assert grey.grey
    assert lit.mean() == pytest.approx(clean.images.mean(), rel=1e-6)
    assert (grey.images - lit).std() == pytest.approx(NOISE / np.sqrt(3), rel=0.05)
    assert np.ptp(truth.materials.albedo, axis=-1).max() == 0


def test_files_of_8_bits_clip_the_brightest_half_percent(noise: Scene) -> None:
    png = made("png")
    assert png.source is not None
    sound = (known(png.limits) == 0).all(axis=-1)
    assert 0 < np.mean(~sound) < 3 * 0.005 + 0.02  # of pixels with a clipped or without a code
    white = np.quantile(noise.images, disturbances.UNCLIPPED)
    written = 255 * encode_srgb(noise.images[sound] / white)
    codes = 255 * encode_srgb(png.images[sound])
    np.testing.assert_allclose(codes, np.round(codes), atol=1e-3)
    assert np.abs(codes - written.clip(0, 255)).max() <= 0.51


@pytest.mark.parametrize("said", ["90-444", "75-420"])
def test_a_jpeg_has_a_twin_with_noise_of_its_rms(said: Any) -> None:
    clean, jpeg, white = (made(name, 32) for name in ("clean", f"jpeg-{said}", f"white-{said}"))
    at_white = np.quantile(clean.images, disturbances.UNCLIPPED)
    held = clean.images < at_white
    of_jpeg = (at_white * jpeg.images - clean.images)[held]
    of_white = (white.images - clean.images)[held]
    assert of_white.std() == pytest.approx(np.sqrt(np.mean(of_jpeg**2)), rel=0.02)
    assert white.images.dtype == np.float32
    assert white.limits is None


def test_views_are_90_degrees_wide_whatever_is_said() -> None:
    true, wrong = made("fov-true"), made("fov-wrong")
    assert (true.fov, wrong.fov) == (90, 60)
    np.testing.assert_array_equal(true.images, wrong.images)
    assert not made("fov-unknown").fov_known


def test_the_scale_is_that_of_albedo(clean: Scene) -> None:
    true = truth_of(clean).materials.albedo[clean.valid]
    found = measure.scale_errors(true * [1.1, 1.0, 0.8], true, [0.05, 0.0, 0.1])
    errors, deviations = zip(*(one.values() for one in found.values()), strict=True)
    np.testing.assert_allclose(errors, np.abs(np.log([1.1, 1, 0.8])), atol=1e-9)
    assert deviations == (0.05, 0.0, 0.1)
    assert measure.covered(found) == [True, True, False]


def found(error: float, seconds: float = 1.0, **more: Any) -> dict[str, Any]:
    """What a fit found with the same error in all maps."""
    scale = {name: {"error": 0.01, "deviation": 0.01} for name in measure.CHANNELS}
    fov = {"degrees": 60.0, "error": 0.0, "said": None, "contradicted": False}
    return {
        "scores": dict.fromkeys(figures.ERRORS, error) | {"processor": seconds},
        "refined": False,
        "scale": more.get("scale", scale),
        "fov": fov | more.get("fov", {}),
    }


def case(disturbance: Disturbance, seed: int = 1) -> Case:
    return Case(disturbance, "default", seed, 16, "room")


def results(*of: Pair) -> Results[Case]:
    """One room a disturbance."""
    return recorded(*((case(name), values) for name, values in of), conditions=dict(of))


def judged(*of: Pair) -> list[Verdict]:
    all_of = results(*of)
    return list(figures.verdicts(all_of, figures.rows(all_of)))


def about(verdicts: list[Verdict], words: str) -> Verdict:
    [one] = [verdict for verdict in verdicts if words in verdict.what]
    return one


@pytest.mark.parametrize("disturbance", MOST)
def test_errors_are_judged_by_those_of_the_reference_or_the_twin(disturbance: Disturbance) -> None:
    twin = twin_of(disturbance)
    for times, holds in ((0.999, True), (1.001, False)):
        of = found(0.1)
        of["scores"]["roughness"] = 0.1 * times * MOST[disturbance]
        of["scores"]["albedo"] = 0.02
        verdict = about(judged((disturbance, of), (twin, found(0.1))), "error of the worst map")
        assert verdict.holds == (holds and times * MOST[disturbance] >= 1)
        assert verdict.value == pytest.approx(times * MOST[disturbance])
        assert verdict.where == "roughness"
        assert verdict.what.endswith(f"over {TITLES[twin]}")


def test_seconds_are_judged_where_files_are_read() -> None:
    for disturbance in ("png", "jpeg-75-420"):
        for seconds, holds in ((2.99, True), (3.01, False)):
            of = (disturbance, found(0.1, seconds)), (twin_of(disturbance), found(0.1, 2.0))
            assert about(judged(*of), "processor seconds").holds == holds
    assert not [v for v in judged(("hot", found(1)), ("noise", found(1))) if "seconds" in v.what]


@pytest.mark.parametrize(("error", "holds"), [(1.99, True), (2.01, False)])
def test_an_unknown_field_of_view_is_found_within_2_degrees(error: float, holds: bool) -> None:
    unknown = found(0.1, fov={"error": error})
    of: list[Pair] = [("fov-unknown", unknown), ("fov-true", found(0.1))]
    assert about(judged(*of), "largest error in degrees").holds == holds


@pytest.mark.parametrize("contradicted", [True, False])
def test_a_wrong_field_of_view_is_contradicted_and_the_true_one_is_not(contradicted: bool) -> None:
    of = found(0.1, fov={"contradicted": contradicted, "said": "as it is"})
    assert about(judged(("fov-wrong", of)), "contradicts").holds == contradicted
    assert about(judged(("fov-true", of)), "contradicts").holds != contradicted
    assert about(judged(("fov-true", of)), "contradicts").where == "such as “as it is”"


def test_scales_are_within_two_deviations_in_nine_of_ten() -> None:
    def with_errors(*errors: float) -> dict[str, Any]:
        pairs = zip(measure.CHANNELS, errors, strict=True)
        return found(0.1, scale={n: {"error": e, "deviation": 0.01} for n, e in pairs})

    within, beyond = with_errors(0.019, 0.019, 0.0), with_errors(0.019, 0.021, 0.0)
    assert about(judged(("noise", within)), "undisturbed").value == 1
    assert figures.rows(results(("noise", beyond)))[0].metrics["scale_covered"] == pytest.approx(
        2 / 3
    )
    three: list[Pair] = [("hot", within), ("black", within), ("png", within)]
    assert about(judged(*three, ("grey", beyond)), "disturbed").holds  # 11 of 12
    verdict = about(judged(*three[:1], ("grey", beyond)), "disturbed")  # 5 of 6
    assert not verdict.holds
    assert verdict.bar == COVERED
    assert TITLES["grey"] in verdict.where


@pytest.mark.parametrize(("error", "covered"), [(0.99e-6, True), (1.01e-6, False)])
def test_rounding_is_no_error_of_the_scale(error: float, covered: bool) -> None:
    assert measure.covered({"red": {"error": error, "deviation": 1e-8}}) == [covered]


@pytest.mark.parametrize("seed", [7300, 7303, 7311])
def test_what_jpeg_lost_refutes_no_curve(seed: int) -> None:
    """Both curves leave no more than files did, of which linear values leave less."""
    scene = disturbed("jpeg-90-444", "furnished", seed, 32)
    found = decompose(scene, refine_normals="off", uncertainty=False, align="off")
    assert found.held_out is not None
    assert "sRGB values" in found.held_out.chosen
