"""`pbrfit evaluate everyday`: disturbances are what they say, verdicts can fail, files are written.

How well disturbed scenes are fitted is not tested here: verdicts are on figures made by hand.
"""

from __future__ import annotations

import argparse
import csv
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from evaluation_tasks import recorded
from pbrfit.cli import main
from pbrfit.fit.decompose import decompose
from pbrfit.io.color import encode_srgb
from pbrfit.scene.correction import Correction
from pbrfit.scene.scene import Scene
from pbrfit_evaluation import everyday
from pbrfit_evaluation.everyday import SUITE, disturbances, figures, measure
from pbrfit_evaluation.everyday.disturbances import (
    BAD_PICTURE,
    DISTURBANCES,
    NOISE,
    PICTURES,
    TITLES,
    Disturbance,
    Disturbed,
    disturbed,
)
from pbrfit_evaluation.everyday.figures import MAPS, MOST, REFERENCE, SLOWEST, TWINS
from pbrfit_evaluation.everyday.measure import Case
from pbrfit_evaluation.panels import unpacked
from pbrfit_evaluation.suite import Results, Verdict
from scene_files import known, lights_of, truth_of

SIZE, SEED = 16, 7

Pair = tuple[Disturbance, Any]
"""What was found after a disturbance; a text is an error."""


def made(disturbance: Disturbance, size: int = SIZE) -> Disturbed:
    return disturbed(disturbance, "room", SEED, size)


@pytest.fixture(scope="module")
def noise() -> Disturbed:
    return made("noise")


def others() -> list[int]:
    return [i for i in range(PICTURES) if i != BAD_PICTURE]


def test_the_reference_has_noise_and_the_clean_scene_none_but_rounding(noise: Disturbed) -> None:
    error = noise.scene.images - noise.expected
    assert noise.scene.images.dtype == np.float32
    assert error.std() == pytest.approx(NOISE, rel=0.03)
    clean = made("clean")
    np.testing.assert_allclose(clean.scene.images, clean.expected, rtol=6e-8)
    np.testing.assert_array_equal(clean.expected, noise.expected)


@pytest.mark.parametrize("disturbance", ["hot", "clipped", "brightest", "shifted", "another"])
def test_what_is_not_disturbed_is_the_reference(disturbance: Any, noise: Disturbed) -> None:
    found, before = made(disturbance).scene.images, noise.scene.images
    changed = found != before
    if disturbance in ("shifted", "another"):
        assert not changed[others()].any()
        assert changed[BAD_PICTURE].mean() > 0.9
    elif disturbance == "hot":
        assert changed.mean() == pytest.approx(disturbances.HOT_SHARE, rel=0.5)
        most = disturbances.HOT_RANGE * noise.expected.mean()
        assert 0.5 * most < found[changed].max() <= most
    else:
        limit = found.max()
        np.testing.assert_array_equal(found, np.minimum(before, limit))
        if disturbance == "clipped":
            assert limit == np.float32(disturbances.CLIPPED_AT)
        else:
            assert changed.mean() == pytest.approx(0.002, rel=0.1)


def test_bad_pictures(noise: Disturbed) -> None:
    before = noise.scene.images[BAD_PICTURE]
    moved = made("shifted").scene.images[BAD_PICTURE]
    np.testing.assert_array_equal(moved[:, 2:], before[:, :-2])
    np.testing.assert_array_equal(moved[:, :2], before[:, [0, 0]])
    black = made("black")
    assert np.abs(black.scene.images[BAD_PICTURE].mean()) < NOISE
    assert black.scene.images[BAD_PICTURE].std() == pytest.approx(NOISE, rel=0.1)
    assert not black.expected[BAD_PICTURE].any()
    np.testing.assert_array_equal(black.expected[others()], noise.expected[others()])
    assert np.isnan(made("another").expected[BAD_PICTURE]).all()


def test_gamma_keeps_white_and_vignetting_takes_30_percent_of_the_corners(noise: Disturbed) -> None:
    white = np.quantile(noise.scene.images, disturbances.UNCLIPPED)
    bright = noise.expected > 0.01
    ratio = np.log(made("gamma").expected[bright] / white)
    np.testing.assert_allclose(ratio, 1.1 * np.log(noise.expected[bright] / white), rtol=1e-6)
    even = disturbances.vignetted(np.ones((1, 101, 201, 3)))
    assert even[0, 50, 100] == pytest.approx(1)
    assert even[0, 0, 0] == pytest.approx(0.7, abs=0.01)
    np.testing.assert_allclose(even, even[:, ::-1, ::-1])


def test_a_grey_scene_is_grey_and_its_truth_explains_it(noise: Disturbed) -> None:
    grey = made("grey")
    assert grey.scene.grey
    assert grey.expected.mean() == pytest.approx(noise.expected.mean())
    error = grey.scene.images - grey.expected
    assert error.std() == pytest.approx(NOISE / np.sqrt(3), rel=0.05)
    assert np.ptp(truth_of(grey.scene).materials.albedo, axis=-1).max() == 0
    assert np.abs(scale_errors(grey)).max() < 1e-9


def test_files_of_8_bits_clip_the_brightest_half_percent(noise: Disturbed) -> None:
    png = made("png")
    assert png.scene.source is not None
    sound = (known(png.scene.limits) == 0).all(axis=-1)
    assert 0 < np.mean(~sound) < 3 * 0.005 + 0.02  # of pixels with a clipped or without a code
    scale = png.expected.max() / noise.expected.max()
    written = 255 * encode_srgb(scale * noise.scene.images[sound])
    codes = 255 * encode_srgb(png.scene.images[sound])
    np.testing.assert_allclose(codes, np.round(codes), atol=1e-3)
    assert np.abs(codes - written.clip(0, 255)).max() <= 0.51


@pytest.mark.parametrize("said", ["90-444", "75-420"])
def test_a_jpeg_has_a_twin_with_noise_of_its_rms(said: Any) -> None:
    jpeg, white = made(f"jpeg-{said}", 32), made(f"white-{said}", 32)
    scale = white.expected.max() / jpeg.expected.max()
    held = jpeg.expected < 1
    of_jpeg = scale * (jpeg.scene.images - jpeg.expected)[held]
    of_white = (white.scene.images - white.expected)[held]
    assert of_white.std() == pytest.approx(np.sqrt(np.mean(of_jpeg**2)), rel=0.02)
    assert white.scene.images.dtype == np.float32
    assert white.scene.limits is None


def test_jpeg_files_have_the_quality_and_the_chroma_that_are_said(tmp_path: Path) -> None:
    codes = np.random.default_rng(1).integers(0, 256, (16, 16, 3)).astype(np.uint8)
    for said, factors in (("90-444", (1, 1)), ("75-420", (2, 2))):
        disturbances.jpeg(said)(tmp_path / said, codes)
        with Image.open(tmp_path / f"{said}.jpg") as picture:
            assert picture.layer[0][1:3] == factors  # type: ignore[attr-defined]
            # Of quality 50 the first entry is 16; 90 and 75 have a fifth and a half of it.
            assert picture.quantization[0][0] == {90: 3, 75: 8}[int(said[:2])]  # type: ignore[attr-defined]


def test_views_are_90_degrees_wide_whatever_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    true, wrong = made("fov-true"), made("fov-wrong")
    assert (true.fov, true.scene.fov, wrong.fov, wrong.scene.fov) == (90, 90, 90, 60)
    np.testing.assert_array_equal(true.scene.images, wrong.scene.images)
    assert not made("fov-unknown").scene.fov_known
    monkeypatch.setattr(Scene, "load", lambda _: true.scene)
    with pytest.raises(disturbances.NotRunError, match=r"took 90 degrees for known"):
        made("fov-unknown")


def scale_errors(of: Disturbed, factor: Any = 1.0, camera: Any = None) -> Any:
    """With true lights, some times as strong."""
    result: Any = SimpleNamespace(
        lighting=factor * lights_of(of.scene), pictures=of.scene.names, camera=camera
    )
    return measure.scale_errors(result, of)


@pytest.mark.parametrize("disturbance", ["noise", "png", "another", "shifted", "clipped"])
def test_the_scale_is_that_of_the_lights(disturbance: Any) -> None:
    of = made(disturbance)
    np.testing.assert_allclose(scale_errors(of), 0, atol=1e-6)
    np.testing.assert_allclose(scale_errors(of, [1.1, 1.0, 0.8]), [0.1, 0, -0.2], atol=1e-6)


def test_the_scale_is_that_of_pictures_as_they_were_corrected() -> None:
    of = made("gamma")
    white = float(np.quantile(made("noise").scene.images, disturbances.UNCLIPPED))
    camera = SimpleNamespace(correction=Correction(white, (-0.1, 0.0, 0.0)))
    assert np.abs(scale_errors(of)).min() > 0.05
    np.testing.assert_allclose(scale_errors(of, camera=camera), 0, atol=2e-3)


def test_the_window_is_where_most_has_changed() -> None:
    of = made("noise", 17)
    pictures = of.expected.copy()
    pictures[3, 12:15, 2:5] += 5
    number, rows, columns = measure.window(
        replace(of, scene=replace(of.scene, images=pictures.astype(np.float32)))
    )
    assert number == 3
    assert len(rows) == len(columns) == 17
    assert rows.min() <= 12 < 14 <= rows.max() < 17
    assert 0 <= columns.min() <= 2 < 4 <= columns.max()
    assert set(np.diff(rows)) == {0, 1}


def found(error: float, seconds: float = 1.0, **more: Any) -> dict[str, Any]:
    """What a fit found with the same error in all maps."""
    scale = {name: {"error": 0.01, "deviation": 0.01} for name in measure.CHANNELS}
    fov = {"degrees": 60.0, "error": 0.0, "said": None, "contradicted": False}
    return {
        "scores": dict.fromkeys(figures.ERRORS, error),
        "seconds": seconds,
        "refined": False,
        "scale": more.get("scale", scale),
        "fov": fov | more.get("fov", {}),
    }


def results(*of: Pair) -> Results[Case]:
    """One room a disturbance."""
    return recorded(*((Case(name, "room", 1, 16), values) for name, values in of))


def judged(*of: Pair) -> list[Verdict]:
    all_of = results(*of)
    return list(figures.verdicts(all_of, figures.rows(all_of)))


def about(verdicts: list[Verdict], words: str) -> Verdict:
    [one] = [verdict for verdict in verdicts if words in verdict.what]
    return one


@pytest.mark.parametrize("disturbance", MOST)
def test_errors_are_judged_by_those_of_the_reference_or_the_twin(disturbance: Disturbance) -> None:
    twin = TWINS.get(disturbance, REFERENCE)
    for times, holds in ((0.999, True), (1.001, False)):
        of = found(0.1)
        of["scores"]["roughness"] = 0.1 * times * MOST[disturbance]
        of["scores"]["albedo"] = 0.02
        verdict = about(judged((disturbance, of), (twin, found(0.1))), "error of the worst map")
        assert verdict.holds == (holds and times * MOST[disturbance] >= 1)
        assert verdict.value == pytest.approx(times * MOST[disturbance])
        assert verdict.where == f"roughness, over {TITLES[twin]}"


@pytest.mark.parametrize("disturbance", SLOWEST)
def test_seconds_are_judged_where_they_have_a_bar(disturbance: Disturbance) -> None:
    twin = TWINS.get(disturbance, REFERENCE)
    for seconds, holds in ((2.99, True), (3.01, False)):
        of = (disturbance, found(0.1, seconds)), (twin, found(0.1, 2.0))
        assert about(judged(*of), "processor seconds").holds == holds


def test_means_are_over_scenes_that_both_have() -> None:
    def case(disturbance: Disturbance, seed: int) -> Case:
        return Case(disturbance, "room", seed, 16)

    of = recorded(
        (case("noise", 1), found(0.1)),
        (case("noise", 2), found(0.3)),
        (case("hot", 1), found(0.2)),
        (case("hot", 2), found(0.4)),
        (case("hot", 3), found(9.9)),
        (case("noise", 3), "MemoryError: too large"),
    )
    reference, hot = figures.rows(of)
    assert hot.metrics["albedo_multiple"] == pytest.approx(0.3 / 0.2)
    assert (hot.scenes, hot.status) == (3, "ok")
    assert reference.status == "1 of 3 scenes failed"


def test_what_is_not_run_holds_nothing_and_says_why() -> None:
    of: list[Pair] = [("fov-unknown", {"not_run": "no way to ask"}), ("fov-true", found(0.1))]
    row = figures.rows(results(*of))[-1]
    assert (row.status, row.scenes, row.metrics) == ("not run: no way to ask", 0, {})
    verdict = about(judged(*of), "90° wide, unknown")
    assert not verdict.holds
    assert verdict.where == "not run: no way to ask"


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

    within, beyond = with_errors(0.019, -0.019, 0.0), with_errors(0.019, -0.021, 0.0)
    assert about(judged(("noise", within)), "undisturbed").value == 1
    [row] = figures.rows(results(("noise", beyond)))
    assert row.metrics["scale_covered"] == pytest.approx(2 / 3)
    three: list[Pair] = [("hot", within), ("black", within), ("png", within)]
    assert about(judged(*three, ("grey", beyond)), "disturbed").holds  # 11 of 12
    verdict = about(judged(*three[:1], ("grey", beyond)), "disturbed")  # 5 of 6
    assert not verdict.holds
    assert TITLES["grey"] in verdict.where


def test_rounding_is_no_error_of_the_scale() -> None:
    for error, covered in ((0.99e-6, 1), (1.01e-6, 0)):
        scale = {name: {"error": error, "deviation": 1e-8} for name in measure.CHANNELS}
        [row] = figures.rows(results(("clean", found(1e-7, scale=scale))))
        assert row.metrics["scale_covered"] == covered


def test_cases_bring_what_they_are_compared_with() -> None:
    options = argparse.Namespace(disturbances=["jpeg-90-444"], first_seed=3, scenes=4, size=8)
    made_of = everyday.cases(options)
    assert {case.disturbance for case in made_of} == {"noise", "jpeg-90-444", "white-90-444"}
    assert [(case.kind, case.seed) for case in made_of[::3]] == [
        *(("room", 3), ("furnished", 4), ("detailed", 5), ("room", 6))
    ]
    assert len({case.key for case in made_of}) == len(made_of) == 12
    assert [(case.disturbance, case.seed) for case in made_of if case.picture] == [("noise", 4)]
    assert set(TITLES) == set(DISTURBANCES)


@pytest.mark.slow
def test_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    out = tmp_path / "out"
    arguments = ["evaluate", "everyday", "--out", str(out), "--jobs", "1", "--scenes", "1",
                 "--first-seed", str(SEED), "--size", "12",
                 "--disturbances", "shifted", "fov-wrong"]  # fmt: skip
    code = main(arguments)
    assert "one picture shifted: error of the worst map" in capsys.readouterr().out
    rows = json.loads((out / "summary.json").read_text(encoding="utf-8"))["rows"]
    assert code == (1 if "not held" in [row["status"] for row in rows] else 0)
    by_name = {row["name"]: row["metrics"] for row in rows}
    assert by_name["90° wide, 60° given"]["fov_error"] > 0
    assert by_name["float32, 1 % noise"]["worst_multiple"] == 1
    files = {"report.html", "everyday.md", "everyday.png", "everyday-maps.png", "scenes.csv"}
    assert {path.name for path in out.iterdir()} == {*files, "records", "summary.json"}
    with (out / "scenes.csv").open(newline="", encoding="utf-8") as file:
        tasks = {line["task"] for line in csv.DictReader(file)}
    assert tasks == {
        f"{name}_room_{SEED}" for name in ("noise", "shifted", "fov-true", "fov-wrong")
    }
    record = json.loads((out / "records" / f"noise_room_{SEED}.json").read_text(encoding="utf-8"))
    panels = unpacked(record["values"]["truth"])
    assert {of.shape for of in panels.values()} == {(12, 12, 3)}
    assert list(panels) == ["undisturbed", "given", *MAPS]
    monkeypatch.setattr(measure, "decompose", None)  # once more, from the records
    again = [*arguments, "--resume", "--quiet"]
    assert main(again) == code
    assert MAPS == ("albedo", "roughness", "metallic")
    assert SUITE.timed


@pytest.mark.parametrize("seed", [7300, 7303, 7311])
def test_what_jpeg_lost_refutes_no_curve(seed: int) -> None:
    """Both curves leave no more than files did, of which linear values leave less."""
    scene = disturbed("jpeg-90-444", "furnished", seed, 32).scene
    found = decompose(scene, refine_normals="off", uncertainty=False, align="off")
    assert found.held_out is not None
    assert "sRGB values" in found.held_out.chosen
