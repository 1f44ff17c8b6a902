"""Photographs under lamps: photometric stereo, what is known of sets, report and command."""

from __future__ import annotations

import json
from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import pbrfit
from evaluation_tasks import recorded
from pbrfit.io import images
from pbrfit.model.geometry import angles_between
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import render_directional
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.normal_errors import unit
from pbrfit_evaluation.panels import unpacked
from pbrfit_evaluation.photographs import (
    SUITE,
    explanations,
    figures,
    lambertian,
    measure,
    ours,
    pictures,
)
from pbrfit_evaluation.photographs.explanations import IN_WORDS, KNOWING, OURS, WAYS, Way
from pbrfit_evaluation.photographs.panels import as_colors, height
from pbrfit_evaluation.photographs.pictures import Known, Photographs
from pbrfit_evaluation.real.held_out import picture_scores, relative_error, split
from pbrfit_evaluation.real.lights import nearest
from pbrfit_evaluation.real.public_sets import Source
from pbrfit_evaluation.real.sources import find_sources
from scene_files import run

Array = NDArray[np.float64]

SIZE = 24
LAMPS = 8
FEW = ("--quick", "--jobs", 1)
WITHOUT_FIT = tuple(way for way in WAYS if way not in OURS)


def lamps(slant: float = 30.0) -> Array:
    """Unit vectors about the view direction, all of one slant in degrees."""
    angle = 2 * np.pi * np.arange(LAMPS) / LAMPS
    out, along = np.sin(np.radians(slant)), np.cos(np.radians(slant))
    turned = [out * np.cos(angle), out * np.sin(angle), np.full(LAMPS, along)]
    return np.stack(turned, axis=-1)


def cap(steepness: float = 0.6) -> Array:
    """Normals (H, W, 3) of a bump that all lamps of 30 degrees reach."""
    y, x = np.indices((SIZE, SIZE)) / (SIZE - 1) * 2 - 1
    return unit(np.stack([steepness * x, -steepness * y, np.ones_like(x)], axis=-1))


def matt(strengths: Array | None = None, shadow: bool = False) -> Photographs:
    """Photographs that the matt law holds for; with `shadow`, some samples are black."""
    normals, vectors = cap(), lamps()
    rng = np.random.default_rng(0)
    albedo = rng.uniform(0.2, 0.8, (SIZE, SIZE, 3))
    shading = np.maximum(np.einsum("hwi,ni->nhw", normals, vectors), 0.0)
    if strengths is not None:
        shading = strengths[:, None, None] * shading
    radiance = shading[..., None] * albedo
    if shadow:
        radiance[0, :4] = 0.0
    scene = Scene(images=radiance, fov=0.0)
    return Photographs(
        scene, Known(vectors, None if strengths is not None else np.ones(8)), normals
    )


def error(way: Way, photographs: Photographs, fold: int = 0) -> float:
    which = split(len(photographs.scene.images), None, fold)
    found = explanations.explain(way, photographs, which, iterations=1, threads=1)
    scores = picture_scores(photographs.scene, which.held_out, found.held_out, looks=False)
    return relative_error(scores)


# Photometric stereo


@pytest.mark.parametrize("way", ["lambert", "lambert-known", "combination"])
def test_matt_photographs_are_explained(way: Way) -> None:
    assert error(way, matt()) < 1e-5


@pytest.mark.parametrize("fold", [0, 3])
def test_matt_normals_are_found(fold: int) -> None:
    photographs = matt()
    which = split(LAMPS, None, fold)
    found = explanations.explain("lambert-known", photographs, which, iterations=1, threads=1)
    assert found.normals is not None
    assert photographs.normals is not None
    assert angles_between(found.normals, photographs.normals).max() < 1e-3


def test_strengths_of_lamps_that_nobody_told_are_found() -> None:
    strengths = np.array([1.0, 0.6, 1.4, 0.9, 1.2, 0.7, 1.0, 1.1])
    photographs = matt(strengths)
    found = explanations.explain(
        "lambert-known", photographs, split(LAMPS), iterations=1, threads=1
    )
    assert found.normals is not None
    assert photographs.normals is not None
    assert np.median(angles_between(found.normals, photographs.normals)) < 0.01


def test_shadows_bend_plain_least_squares() -> None:
    photographs = matt(shadow=True)
    found = explanations.explain(
        "lambert-known", photographs, split(LAMPS, None, 1), iterations=1, threads=1
    )
    assert found.normals is not None
    assert photographs.normals is not None
    off = angles_between(found.normals, photographs.normals)
    assert off[:4].min() > 3
    assert off[4:].max() < 1e-3


def test_samples_without_weight_do_not_count() -> None:
    rng = np.random.default_rng(1)
    samples = np.einsum("pi,ni->np", unit(rng.normal((0, 0, 3), size=(5, 3))), lamps())
    samples = np.repeat(np.maximum(samples, 0.0)[..., None], 3, axis=-1)
    spoilt, weights = samples.copy(), np.ones(samples.shape)
    spoilt[2, 1], weights[2, 1] = 50.0, 0.0
    spoilt[:4, 3, 0], weights[:4, 3, 0] = 50.0, 0.0  # the other channels tell all of it
    known = Known(lamps(), np.ones(LAMPS))
    true, found = (
        lambertian.known_lamps(of, by, known)
        for of, by in ((samples, np.ones_like(weights)), (spoilt, weights))
    )
    np.testing.assert_allclose(found.normals, true.normals, atol=1e-6)
    np.testing.assert_allclose(found.albedo, true.albedo, atol=1e-6)


def test_black_pixel_faces_the_viewer() -> None:
    found = lambertian.known_lamps(
        np.zeros((LAMPS, 1, 3)), np.ones((LAMPS, 1, 3)), Known.of(lamps())
    )
    np.testing.assert_array_equal(found.normals, [[0, 0, 1]])
    np.testing.assert_array_equal(found.albedo, 0)


def test_nearest_photograph_is_the_one_of_the_nearest_lamp() -> None:
    photographs = matt()
    images = photographs.scene.images
    found = nearest(images[1:], images[0], None, photographs.scene.valid)
    left = [np.ptp(found / images[k], axis=(0, 1)).max() for k in (1, 4, 7)]
    assert int(np.argmin(left)) in (0, 2)
    assert min(left) < 1e-9


def test_errors_are_in_the_order_of_what_is_known() -> None:
    photographs = matt()
    assert error("combination", photographs) < error("nearest", photographs)
    assert error("nearest", photographs) < error("constant", photographs) < 1


@pytest.mark.parametrize("way", KNOWING)
def test_lamps_that_nobody_knows_cannot_be_told(way: Way) -> None:
    with pytest.raises(ValueError, match="expected known lamps"):
        error(way, replace(matt(), known=None))


# Ours


def test_ours_is_told_lamps_of_kept_pictures_and_directions_of_held_out_ones(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    photographs = matt()
    told: list[Scene] = []
    directions: list[Array | None] = []

    class Found:
        normals = photographs.normals
        albedo = np.full((SIZE, SIZE, 3), 0.5)
        roughness = metallic = np.full((SIZE, SIZE), 0.5)

    def fit(scene: Scene, **_: object) -> Found:
        told.append(scene)
        return Found()

    def relit(_: Found, picture: Array, __: object, direction: Array | None, ___: int) -> Array:
        directions.append(direction)
        return picture

    monkeypatch.setattr(ours, "fit", fit)
    monkeypatch.setattr(ours, "relit", relit)
    which = split(LAMPS, 2, 1)
    known = photographs.known
    assert known is not None
    for way in OURS:
        explanations.explain(way, photographs, which, iterations=1, threads=1)
    unknown, given = told
    assert not unknown.normals_known
    assert unknown.lamps is None
    assert given.lamps is not None
    assert not given.lamps.colored
    np.testing.assert_array_equal(given.lamps.places, known.directions[list(which.kept)])
    assert directions[:LAMPS] == [None] * LAMPS
    np.testing.assert_array_equal(
        np.stack([one for one in directions[LAMPS:] if one is not None]),
        known.directions[[*which.held_out, *which.kept]],
    )


@pytest.mark.parametrize("known", [False, True])
def test_light_of_a_picture_is_found_on_true_surfaces(known: bool) -> None:
    """A stand-in for a result: what it says of surfaces is true."""
    rng = np.random.default_rng(2)
    shape = (SIZE, SIZE)
    materials = Materials(rng.uniform(0.2, 0.8, (*shape, 3)), np.full(shape, 0.4), np.zeros(shape))
    lamp, color = unit(np.array([0.4, -0.3, 0.8])), np.array([1.0, 0.8, 0.6])
    picture = render_directional(materials, cap(1.5), lamp, color, 0.0, model="principled")
    result: Any = SimpleNamespace(
        materials=materials,
        albedo=materials.albedo,
        roughness=materials.roughness,
        metallic=materials.metallic,
        normals=cap(1.5),
        mask=np.ones(shape, bool),
        fov=0.0,
        model="principled",
    )
    found = ours.relit(result, picture, None, lamp if known else None, 1)
    assert np.abs(found - picture).max() < 5e-3 * picture.max()


# What is known


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A scene folder with lamps and normals for this suite alone."""
    photographs = matt()
    known = photographs.known
    assert known is not None
    path = tmp_path / "bump"
    (path / "images").mkdir(parents=True)
    for i, picture in enumerate(photographs.scene.images):
        channels = {name: picture[..., c].astype(np.float32) for c, name in enumerate("RGB")}
        images.write_exr(path / "images" / f"{i}.exr", channels)
    (path / "scene.toml").write_text("fov = 0\n", encoding="utf-8")
    np.save(path / pictures.LIGHTS, known.directions)
    np.save(path / pictures.NORMALS, cap())
    return path


def test_fit_is_not_told_what_the_suite_knows(folder: Path) -> None:
    [source] = find_sources(folder)
    assert pictures.has_lamps(source)
    found = pictures.read(source)
    assert not found.scene.normals_known
    assert found.scene.lamps is None
    assert found.known is not None
    assert found.normals is not None
    np.testing.assert_allclose(found.known.directions, lamps(), atol=1e-12)
    np.testing.assert_allclose(found.normals, cap(), atol=1e-6)
    small = pictures.read(source, SIZE // 2)
    assert small.normals is not None
    assert small.normals.shape == (SIZE // 2, SIZE // 2, 3)
    np.testing.assert_allclose(np.linalg.norm(small.normals, axis=-1), 1)


def test_lamps_of_a_scene_folder_are_known(folder: Path) -> None:
    (folder / pictures.LIGHTS).unlink()
    [source] = find_sources(folder)
    assert not pictures.has_lamps(source)
    assert pictures.read(source).known is None
    rows = "".join(f"{i}.exr {x} {y} {z}\n" for i, (x, y, z) in enumerate(lamps().tolist()))
    (folder / "dome.lp").write_text(f"{LAMPS}\n{rows}", encoding="utf-8")
    assert pictures.has_lamps(source)
    found = pictures.read(source)
    assert found.scene.lamps is None
    assert found.known is not None
    assert found.known.strengths is None
    np.testing.assert_allclose(found.known.directions, lamps(), atol=1e-6)


@pytest.mark.parametrize("shape", [(LAMPS - 1, 3), (LAMPS, 2)])
def test_lamps_of_another_shape_are_refused(folder: Path, shape: tuple[int, int]) -> None:
    np.save(folder / pictures.LIGHTS, np.ones(shape))
    [source] = find_sources(folder)
    with pytest.raises(pbrfit.InputError, match="expected"):
        pictures.read(source)


@pytest.mark.parametrize(
    ("kind", "degrees"),
    [("bunny_ps", 0.5), ("visiont3lab_ball3", 6.0), ("maxcrous_sphere_color", 2.0)],
)
def test_lamps_of_public_sets_agree_with_their_normals(
    shared_data: Path, kind: str, degrees: float
) -> None:
    if not (shared_data / kind).is_dir():
        pytest.skip(f"no {kind} in the shared data")
    source = find_sources(shared_data / kind)[0]
    found = pictures.read(source, 64)
    count = len(found.scene.images)
    which = split(count, 1, 0)
    matt_found = explanations.explain("lambert-known", found, which, iterations=1, threads=1)
    assert matt_found.normals is not None
    assert found.normals is not None
    off = angles_between(matt_found.normals, found.normals)
    assert np.nanmedian(off) < degrees


# Panels


def test_normals_are_drawn_as_colours() -> None:
    shown = as_colors(np.array([[[0, 0, 1.0], [1, 0, 0]], [[0, -1, 0], [np.nan] * 3]]))
    np.testing.assert_allclose(shown[0], [[0.5, 0.5, 1], [1, 0.5, 0.5]])
    np.testing.assert_allclose(shown[1, 0], [0.5, 0, 0.5])
    assert np.ptp(shown[1, 1]) == 0


def test_height_is_brighter_towards_the_viewer_and_the_lamp() -> None:
    scene = matt().scene
    drawn = height(cap(), scene)[..., 0]
    middle = SIZE // 2
    assert drawn[middle, middle] > drawn[-3, -3]  # the bump's foot, away from the lamp
    assert drawn[3, 3] > drawn[-3, -3]
    assert np.isfinite(drawn).all()


def test_panels_are_kept_whole(folder: Path) -> None:
    [source] = find_sources(folder)
    task = measure.Task(source, "lambert-known", 0, "", SIZE, 1, None, picture=True)
    values = json.loads(json.dumps(measure.run(task, 1)))
    panels = unpacked(values["panels"])
    assert {of.shape for of in panels.values()} == {(SIZE, SIZE, 3)}
    assert list(panels)[:3] == ["photograph", "relit", "error"]
    assert np.abs(panels["normals"] - panels["true normals"]).max() < 0.02
    assert panels["error"].max() < 0.01
    assert values["normals"]["median"] < 0.01


# The command


def test_command(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert run("evaluate", "photographs", folder, "--out", out, *FEW, "--ways", *WITHOUT_FIT) == 0
    rows = {row["solver"]: row for row in json.loads((out / "summary.json").read_text())["rows"]}
    assert list(rows) == [IN_WORDS[way] for way in WITHOUT_FIT]
    assert rows[IN_WORDS["lambert-known"]]["metrics"]["normals_median"] < 0.01
    assert (out / "sheet-bump.png").is_file()
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "normals off by" in page


def found_by(way: Way, rmse: float, degrees: float) -> tuple[measure.Task, dict[str, Any]]:
    source = Source("bump", Path("bump"), "scene", LAMPS, "")
    task = measure.Task(source, way, 0, "", SIZE, 1, None)
    score = {"name": "0", "rms": 1.0, "rmse": rmse, "psnr": 30.0, "ssim": 0.9}
    normals = {"mean": degrees, "median": degrees}
    return task, {"scores": [score], "normals": normals, "kept_error": rmse, "seconds": 1.0}


@pytest.mark.parametrize(
    ("rmse", "degrees", "holds"),
    [(0.1, 4.0, [True, True]), (0.2, 4.0, [False, True]), (0.1, 6.0, [True, False])],
)
def test_ours_has_to_be_no_worse(rmse: float, degrees: float, holds: list[bool]) -> None:
    results = recorded(
        found_by("lambert-known", 0.15, 5.0),
        found_by("nearest", 0.3, 9.0),
        found_by("ours-known", rmse, degrees),
    )
    assert [one.holds for one in figures.verdicts(results, None)] == holds


def test_nothing_has_to_be_better_than_a_file_keeps() -> None:
    results = recorded(
        found_by("lambert-known", 1e-4, 1e-4),
        found_by("nearest", 0.3, 9.0),
        found_by("ours-known", 0.019, 0.9),
    )
    assert [one.holds for one in figures.verdicts(results, None)] == [True, True]
    assert all("as that is less" in one.where for one in figures.verdicts(results, None))


def test_ways_that_are_told_lamps_need_them(folder: Path) -> None:
    (folder / pictures.LIGHTS).unlink()
    options = Namespace(
        folders=[folder],
        ways=WAYS,
        held_out=None,
        folds=1,
        max_size=SIZE,
        iterations=1,
        fov=None,
    )
    assert {task.way for task in SUITE.parts[0].cases(options)} == set(WAYS) - set(KNOWING)
