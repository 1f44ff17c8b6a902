"""Held-out pictures: splits, lights by least squares, public sets, report and command."""

from __future__ import annotations

import csv
import functools
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import pbrfit
from pbrfit.io import images
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import MODELS, Model
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import make_scene
from pbrfit_evaluation.real import held_out, lights, sources
from pbrfit_evaluation.real.held_out import (
    EXPLANATIONS,
    PictureScore,
    Split,
    explained_by,
    folds,
    relative_error,
    split,
)
from pbrfit_evaluation.real.public_sets import SETS, Source
from pbrfit_evaluation.real.spheres import sphere_normals
from scene_files import run, write_integers

Array = NDArray[np.floating[Any]]

PICTURES = 6
MODEL: Model = "paper"
OTHER: Model = "principled"
FEW = ("--quick", "--max-size", 16, "--iterations", 2, "--jobs", 1)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return make_scene("room", size=16, lights=PICTURES, held_out=1, model=MODEL)


@pytest.fixture
def folder(scene: Scene, tmp_path: Path) -> Path:
    """The same as a folder without ground truth."""
    plain = Scene(images=scene.images, normals=scene.normals, fov=scene.fov)
    plain.save(tmp_path / "room")
    return tmp_path / "room"


def materials_of(scene: Scene) -> Materials:
    assert scene.truth is not None
    return scene.truth.materials


# Lights


def design(scene: Scene, channel: int) -> Array:
    true = materials_of(scene)
    weights = pbrfit.shade(
        *(scene.normals, scene.views, true.albedo, true.roughness, true.metallic), model=MODEL
    )
    return weights.reshape(-1, 3, 16)[:, channel]


@pytest.mark.parametrize("weighted", [False, True])
def test_light_is_that_of_least_squares(scene: Scene, weighted: bool) -> None:
    rng = np.random.default_rng(0)
    noisy = scene.images + rng.normal(0, 0.1, scene.images.shape)
    weights = np.ones(scene.images.shape)
    if weighted:
        weights[1] = rng.random(weights.shape[1:])
        weights[2, :4] = weights[3, 4:, :, 0] = 0
        noisy[2, :4] = noisy[3, 4:, :, 0] = np.nan
    given = weights if weighted else None
    found = lights.fit_lights(noisy, given, materials_of(scene), scene.normals, scene.fov, MODEL)
    for i, of in enumerate(weights):
        for c in range(3):
            root = np.sqrt(of[..., c].ravel())
            used = root > 0
            rows, samples = root[:, None] * design(scene, c), root * noisy[i, ..., c].ravel()
            expected = np.linalg.lstsq(rows[used], samples[used], None)[0]
            np.testing.assert_allclose(found[i, :, c], expected, rtol=1e-8, atol=1e-9)


def test_light_that_no_pixel_shows_is_zero(scene: Scene) -> None:
    flat = np.zeros_like(scene.normals)
    flat[..., 2] = 1
    found = lights.fit_lights(scene.images, None, materials_of(scene), flat, 0.0, MODEL)
    # All pixels look along z and mirror it: of the 16 functions those odd in x or y stay unseen.
    assert np.abs(found[:, [1, 3, 4, 5, 7, 8]]).max() < 1e-9
    assert np.abs(found).max() < 1e3


def test_sum_of_pictures_is_found(scene: Scene) -> None:
    factors = np.array([0.2, -0.5, 1.5, 0.0, 2.0])
    image = np.einsum("n,nhwc->hwc", factors, scene.images[:5])
    valid = np.ones(image.shape[:2], dtype=bool)
    valid[0] = False
    found = lights.best_combination(scene.images[:5], image, None, valid)
    assert np.isnan(found[0]).all()
    np.testing.assert_allclose(found[1:], image[1:], rtol=1e-7, atol=1e-9)


# Splits and scores


def test_segments_are_kept(scene: Scene, tmp_path: Path) -> None:
    assert scene.segments is not None
    kept = held_out.part(scene, (0, 2))
    np.testing.assert_array_equal(kept.segments, scene.segments)
    Scene(scene.images, scene.normals, fov=scene.fov, segments=scene.segments).save(tmp_path / "s")
    [source] = sources.find_sources(tmp_path / "s")
    np.testing.assert_array_equal(sources.load(source).segments, scene.segments)


def test_every_fourth_picture_is_held_out() -> None:
    assert split(12) == Split((1, 2, 3, 5, 6, 7, 9, 10, 11), (0, 4, 8))
    assert split(12, fold=3).held_out == (3, 7, 11)
    assert split(25, fold=2).held_out == (2, 6, 10, 14, 18, 22)
    assert split(3).held_out == (0,)
    assert split(10, held_out=2, fold=4).held_out == (4, 9)


@pytest.mark.parametrize(("pictures", "count"), [(3, None), (8, None), (25, None), (10, 4)])
def test_no_picture_is_held_out_twice(pictures: int, count: int | None) -> None:
    splits = [split(pictures, count, fold) for fold in range(folds(pictures, count))]
    out = [i for one in splits for i in one.held_out]
    assert len(out) == len(set(out))
    for one in splits:
        assert sorted(one.kept + one.held_out) == list(range(pictures))


@pytest.mark.parametrize(("pictures", "count"), [(2, None), (5, 4), (5, 0)])
def test_too_few_pictures_are_refused(pictures: int, count: int | None) -> None:
    with pytest.raises(pbrfit.InputError, match="expected 1 or more and 2 to keep"):
        split(pictures, count)


def test_error_is_that_of_all_pictures_together() -> None:
    scores = (PictureScore("a", 3.0, 0.3, 0, 0), PictureScore("b", 4.0, 0.4, 0, 0))
    assert relative_error(scores) == pytest.approx(0.5 / 5)
    assert math.isnan(relative_error((PictureScore("black", 0.0, 0.0, 0, 0),)))


def test_true_materials_explain_held_out_pictures(scene: Scene) -> None:
    rendered = explained_by(materials_of(scene), scene, (1, 4), model=MODEL)
    np.testing.assert_allclose(rendered, scene.images[[1, 4]], atol=1e-6)
    wrong = replace(materials_of(scene), roughness=np.full((16, 16), 0.9))
    for materials, model in ((wrong, MODEL), (materials_of(scene), OTHER)):
        off = explained_by(materials, scene, (1, 4), model=model) - scene.images[[1, 4]]
        assert np.abs(off).max() > 1e-3


def test_held_out_pictures_are_not_seen_by_the_fit(scene: Scene) -> None:
    which = split(PICTURES)
    changed = scene.images.copy()
    changed[list(which.held_out)] *= np.float32(3)
    first, second = (
        held_out.explain_held_out(
            Scene(images=pictures, normals=scene.normals, fov=scene.fov), which, iterations=3
        )
        for pictures in (scene.images, changed)
    )
    assert [one.explanation for one in first] == list(EXPLANATIONS)
    errors = {one.explanation: relative_error(one.scores) for one in first}
    # A sum of all kept pictures holds each of them.
    assert 0 < errors["combination"] < errors["nearest"]
    assert errors["rank-three"] < errors["nearest"]
    for one, other in zip(first, second, strict=True):
        if one.materials is not None and other.materials is not None:
            np.testing.assert_array_equal(one.materials.albedo, other.materials.albedo)
        # Three times the light explains three times the picture.
        np.testing.assert_allclose(3 * one.rendered, other.rendered, rtol=1e-4, atol=1e-4)
        assert relative_error(one.scores) == pytest.approx(relative_error(other.scores), rel=1e-3)


# Sources


def test_clipped_samples_are_limits(scene: Scene, tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    pictures = np.full((3, 16, 16, 3), 0.25)
    pictures[1, 5, 7, 2] = 1.0
    for i, picture in enumerate(pictures):
        write_integers(tmp_path / "images" / f"{i}.png", picture)
    images.write_exr(
        tmp_path / "normals.exr",
        {name: scene.normals[..., c].astype(np.float32) for c, name in enumerate("XYZ")},
    )
    (tmp_path / "scene.toml").write_text("fov = 60\n", encoding="utf-8")
    [source] = sources.find_sources(tmp_path)
    loaded = sources.load(source)
    assert loaded.limits is not None
    assert np.argwhere(loaded.limits).tolist() == [[1, 5, 7, 2]]
    small = sources.load(source, max_size=6)
    assert small.limits is not None
    # 16 pixels become 6: row 5 falls on 1.9 to 2.2, column 7 on 2.6 to 3.
    assert np.argwhere(small.limits).tolist() == [[1, 1, 2, 2], [1, 2, 2, 2]]


def test_sphere_normals() -> None:
    y, x = np.indices((60, 80))
    disc = (x - 40) ** 2 + (y - 30) ** 2 <= 25.5**2
    normals, valid = sphere_normals(disc, "mask.png")
    np.testing.assert_allclose(np.linalg.norm(normals[valid], axis=-1), 1)
    np.testing.assert_allclose(normals[30, 40], [0, 0, 1], atol=1e-9)
    assert normals[20, 55] == pytest.approx([15 / 25.5, 10 / 25.5, 0.707], abs=2e-3)
    assert not valid[30, 65]
    assert valid[30, 64]


@pytest.mark.parametrize("shape", ["half", "square", "empty"])
def test_other_shapes_are_no_sphere(shape: str) -> None:
    y, x = np.indices((60, 80))
    mask = (x - 40) ** 2 + (y - 30) ** 2 <= 25**2
    mask = {"half": mask & (x < 40), "square": np.abs(x - 40) < 20, "empty": mask & False}[shape]
    with pytest.raises(pbrfit.InputError, match=r"mask\.png: expected the disc of a sphere, found"):
        sphere_normals(mask & (np.abs(y - 30) < 25), "mask.png")


def test_folders_that_cannot_be_used_are_named(tmp_path: Path, folder: Path) -> None:
    with pytest.raises(FileNotFoundError, match="nowhere: expected a folder of pictures"):
        sources.find_sources(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(pbrfit.InputError, match="empty: expected a scene folder or one of bunny"):
        sources.find_sources(tmp_path / "empty")
    twice = sources.find_sources(folder) * 2
    with pytest.raises(pbrfit.InputError, match="expected different names, found room twice"):
        sources.check_names(twice)
    with pytest.raises(pbrfit.InputError, match=r"FOLDER: expected .* PBRFIT_DATA is not set"):
        sources.find_data([], {})
    assert sources.find_data([], {"PBRFIT_DATA": "data"}) == [Path("data")]
    assert sources.find_data([folder], {"PBRFIT_DATA": "data"}) == [folder]


def test_rooms_without_normals_get_flat_ones(scene: Scene, tmp_path: Path) -> None:
    room = tmp_path / "kitchen"
    room.mkdir()
    for i, picture in enumerate(scene.images):
        channels = {name: picture[..., c].astype(np.float32) for c, name in enumerate("RGB")}
        images.write_exr(room / f"dir_{i}_mip5.exr", channels)
    [source] = sources.find_sources(tmp_path)
    assert "every surface is taken to face the camera" in source.about
    assert (source.name, source.pictures) == ("kitchen", PICTURES)
    loaded = sources.load(source)
    np.testing.assert_array_equal(loaded.normals[..., 2], 1)
    assert not (room / "normals.exr").exists()


def public(shared_data: Path, kind: str) -> list[Source]:
    if not (shared_data / kind).is_dir():
        pytest.skip(f"no {kind} in the shared data")
    return SETS[kind].find(shared_data / kind)


@functools.cache
def small(source: Source) -> Scene:
    return sources.load(source, max_size=40)


@pytest.mark.parametrize(
    ("kind", "pictures"),
    [
        ("bunny_ps", (12, 25)),
        ("visiont3lab_shrek", (8,)),
        ("visiont3lab_ball3", (8,)),
        ("maxcrous_sphere_color", (25,)),
        ("mit_multi_illumination", (25,)),
    ],
)
def test_public_sets_are_read(shared_data: Path, kind: str, pictures: tuple[int, ...]) -> None:
    found = public(shared_data, kind)
    assert tuple(source.pictures for source in found) == pictures
    loaded = small(found[0])
    assert loaded.images.shape[0] == found[0].pictures
    assert max(loaded.width, loaded.height) == 40
    assert (loaded.normals[loaded.valid][:, 2] > 0).all()
    assert np.count_nonzero(loaded.valid) > 150


def test_bricks_are_bright_where_their_lamp_is(shared_data: Path) -> None:
    [source] = public(shared_data, "maxcrous_sphere_color")
    loaded = small(source)
    valid = loaded.valid
    for name, picture in zip(loaded.names, loaded.images, strict=True):
        lamp = np.array([float(part) for part in name.split("_")[1:]])
        # Radiance as a linear function of the normal; the mean of n nᵀ is not the same all around.
        towards = np.linalg.lstsq(loaded.normals[valid], picture[valid].mean(axis=-1), None)[0]
        towards /= np.linalg.norm(towards)
        # The lamps are near (x, y, 2).
        expected = np.array([*lamp, 2.0]) / np.hypot(2.0, np.hypot(*lamp))
        assert towards[:2] == pytest.approx(expected[:2], abs=0.12), name


# Report and command


def rows_of(out: Path) -> list[dict[str, Any]]:
    content = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert content["protocol"].endswith("16 pixels, 2 iterations")
    rows: list[dict[str, Any]] = content["rows"]
    return rows


def test_command_reports_and_resumes(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    arguments = ("evaluate", "real", folder, "--out", out, *FEW)
    assert run(*arguments) == 0
    assert "room" in capsys.readouterr().out
    summary = rows_of(out)
    assert [row["name"] for row in summary] == [
        f"room, {model}, {name}" for model in MODELS for name in EXPLANATIONS
    ]
    with (out / "pictures.csv").open(encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == len(MODELS) * len(EXPLANATIONS)  # one picture of six is held out
    assert {line["model"] for line in lines} == set(MODELS)
    assert lines[0]["picture"] == "picture_00"
    for row, line in zip(summary, lines, strict=True):
        expected = float(line["rmse"]) / float(line["rms"])
        assert row["metrics"]["relative_rmse"] == pytest.approx(expected)
    assert (out / "report.html").read_text(encoding="utf-8").count("<img") == 3
    assert all((out / f"sheet-room-{model}.png").exists() for model in MODELS)
    record = out / "records" / "room-paper-0.json"
    written = record.stat().st_mtime_ns
    assert run(*arguments, "--resume") == 0
    assert record.stat().st_mtime_ns == written


def test_a_failed_scene_does_not_stop_the_others(
    scene: Scene, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "broken"
    (broken / "images").mkdir(parents=True)
    for name in "abcdef":
        (broken / "images" / f"{name}.png").write_bytes(b"nothing")
    few = Scene(images=scene.images[:5], normals=scene.normals, fov=scene.fov)
    few.save(tmp_path / "few")
    out = tmp_path / "out"
    options = (*FEW, "--model", MODEL, "--held-out", 4)
    assert run("evaluate", "real", folder, broken, tmp_path / "few", "--out", out, *options) == 1
    assert f"broken-{MODEL}-0: InputError" in capsys.readouterr().err
    status = {row["name"]: row["status"] for row in rows_of(out)}
    assert status[f"room, {MODEL}, default"] == "ok"
    assert "broken" in status[f"broken, {MODEL}"]
    assert "expected at least 6 pictures" in status[f"few, {MODEL}"]
    assert "InputError" in (out / "report.html").read_text(encoding="utf-8")


def test_numbers_below_one_are_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for flag in ("--held-out", "--folds", "--max-size", "--iterations"):
        assert run("evaluate", "real", folder, "--out", tmp_path / "out", flag, 0) == 2
        assert f"argument {flag}: expected 1 or more, found 0" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
