"""Refined normals around the solver: options, what hinders, result folder, commands."""

from __future__ import annotations

import dataclasses
import json
import logging
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from command_runs import done
from page_reader import written
from pbrfit import InputError, Result, Scene, decompose, relight
from pbrfit.export import export_result
from pbrfit.model.geometry import angles_between
from pbrfit.model.reflection import render
from pbrfit.result.differences import PALETTE, WHITE, turned
from pbrfit.result.refinement import CHANGE_DEGREES_MIN, CHOICES, NOT_ASKED, Refinement, hindrance
from pbrfit.synthetic import make_scene
from refined import LARGEST, degrees_of, refined
from result_files import layers_of
from scene_files import known, run

SIZE = 12


def scene(pictures: int = 3, **changes: Any) -> Scene:
    made = make_scene("room", size=SIZE, lights=pictures, held_out=1)
    mask = np.ones((SIZE, SIZE), bool)
    mask[2:5, :3] = False
    arguments: dict[str, Any] = {"images": made.images, "normals": made.normals, "mask": mask}
    return Scene(**(arguments | changes))


@pytest.fixture(scope="module")
def result() -> Result:
    return refined(decompose(scene(), iterations=5))


@pytest.mark.parametrize("asked", CHOICES)
def test_two_pictures_leave_normals_as_given(asked: str, caplog: pytest.LogCaptureFixture) -> None:
    made = scene(2)
    with caplog.at_level(logging.WARNING, "pbrfit"):
        found = decompose(made, iterations=1, uncertainty=False, refine_normals=asked)
    assert found.options.refine_normals == found.refinement.asked == asked
    assert not found.refinement.refined
    assert found.given_normals is None
    assert found.normal_change is None
    np.testing.assert_array_equal(found.normals, made.normals)
    reason = "not asked for" if asked == "off" else hindrance(made)
    assert found.refinement.why == reason
    said = [record.getMessage() for record in caplog.records]
    # Who asks for it by name is told before the fit; by default it is in the summary.
    assert said == ([f"normals are not refined: {reason}"] if asked == "on" else [])


def test_the_change_is_the_angle_between_given_and_refined_normals(result: Result) -> None:
    change = known(result.normal_change)
    np.testing.assert_allclose(change[result.mask], degrees_of(result.mask)[result.mask], atol=1e-9)
    assert (change[result.mask] == 0).any()
    assert np.isnan(change[~result.mask]).all()
    figures = result.refinement.figures
    inside = degrees_of(result.mask)[result.mask]
    assert figures["mean_change_degrees"] == pytest.approx(inside.mean())
    assert figures["largest_change_degrees"] == pytest.approx(LARGEST)
    assert figures["changed_share"] == np.mean(inside > 0)


def test_what_rounding_turns_is_as_given(result: Result) -> None:
    change = np.array([[0.0, 0.9 * CHANGE_DEGREES_MIN, CHANGE_DEGREES_MIN, np.nan, 3.0]])
    assert result.refinement.with_change(change).figures["changed_share"] == 0.5
    assert (turned(change).indices() == WHITE).tolist() == [[True, True, False, False, False]]
    # A normal that was made anew from a tangent offset of 0, and stored.
    stored = result.normals[result.mask].astype(np.float32).astype(np.float64)
    again = stored / np.linalg.norm(stored, axis=-1, keepdims=True)
    assert angles_between(again.astype(np.float32), stored).max() < CHANGE_DEGREES_MIN


def test_refined_normals_without_given_ones_are_refused_and_the_reverse(result: Result) -> None:
    with pytest.raises(InputError, match="given_normals: expected the normals before their ref"):
        dataclasses.replace(result, given_normals=None)
    with pytest.raises(InputError, match="given_normals: expected none without their refinement"):
        dataclasses.replace(result, refinement=NOT_ASKED)


def test_layers_of_given_normals_as_another_reader_sees_them(
    result: Result, tmp_path: Path
) -> None:
    result.save(tmp_path / "out")
    layers = layers_of(tmp_path / "out" / "materials.exr")
    given, change = known(result.given_normals), known(result.normal_change)
    expected = {
        **{f"normal.{name}": result.normals[..., i] for i, name in enumerate("XYZ")},
        **{f"normal_given.{name}": given[..., i] for i, name in enumerate("XYZ")},
        "normal_change.Y": change,
    }
    for name, values in expected.items():
        found = layers[name]
        assert found.dtype == np.float32
        assert np.isfinite(found).all()
        # float32 normals are 1e-5 degrees off.
        atol = 1e-5 if name == "normal_change.Y" else 0
        stored = values[result.mask].astype(np.float32)
        np.testing.assert_allclose(found[result.mask], stored, rtol=0, atol=atol, err_msg=name)


def test_refined_normals_are_saved_and_read_back(result: Result, tmp_path: Path) -> None:
    result.save(tmp_path / "out")
    content = json.loads((tmp_path / "out" / "result.json").read_text("utf-8"))
    assert content["normals"] == {
        "asked": "auto",
        "refined": True,
        "why": result.refinement.why,
        "figures": result.refinement.figures,
    }
    loaded = Result.load(tmp_path / "out")
    assert loaded.refinement == result.refinement
    for found, saved in (
        (known(loaded.given_normals), known(result.given_normals)),
        (loaded.normals, result.normals),
    ):
        np.testing.assert_array_equal(found, saved.astype(np.float32))
    # What was not changed is still the same to the bit, and counts as such.
    unchanged = degrees_of(result.mask) == 0
    assert (known(loaded.normal_change)[result.mask & unchanged] == 0).all()
    loaded.save(tmp_path / "again")
    for name in ("materials.exr", "result.json"):
        again = (tmp_path / "again" / name).read_bytes()
        assert again == (tmp_path / "out" / name).read_bytes(), name


def test_figures_that_are_no_numbers_are_null_in_the_file(result: Result, tmp_path: Path) -> None:
    figures = {"noise": math.nan, "residual_before": math.inf, "spread_degrees": 3.0}
    refinement = dataclasses.replace(result.refinement, figures=figures)
    dataclasses.replace(result, refinement=refinement).save(tmp_path / "out")
    content = json.loads((tmp_path / "out" / "result.json").read_text("utf-8"))
    assert content["normals"]["figures"] == {
        "noise": None,
        "residual_before": None,
        "spread_degrees": 3.0,
    }
    found = Result.load(tmp_path / "out").refinement.figures
    assert math.isnan(found["noise"])
    assert found["spread_degrees"] == 3.0


def test_missing_layers_of_given_normals_are_named(result: Result, tmp_path: Path) -> None:
    result.save(tmp_path / "out")
    plain = dataclasses.replace(result, refinement=NOT_ASKED, given_normals=None)
    plain.save(tmp_path / "plain")
    (tmp_path / "out" / "materials.exr").write_bytes(
        (tmp_path / "plain" / "materials.exr").read_bytes()
    )
    with pytest.raises(
        InputError,
        match=r"materials\.exr: expected channel normal_given\.X, because result\.json tells of "
        "refined normals",
    ):
        Result.load(tmp_path / "out")


def test_relighting_and_export_take_the_refined_normals(result: Result, tmp_path: Path) -> None:
    light, given = result.lighting[0], known(result.given_normals)
    expected, wrong = (
        render(result.materials, normals, light, result.fov) for normals in (result.normals, given)
    )
    found = relight(result, light)
    np.testing.assert_array_equal(found, expected)
    assert np.nanmax(np.abs(found - wrong)) > 0.01
    export_result(result, tmp_path / "export", format="exr")
    layers = layers_of(tmp_path / "export" / "exr" / "materials.exr")
    np.testing.assert_array_equal(
        layers["normal.X"][result.mask], result.normals[result.mask, 0].astype(np.float32)
    )
    assert "normal_given.X" in layers


def folder_of(path: Path, pictures: int, **changes: Any) -> Path:
    scene(pictures, mask=None, **changes).save(path)
    return path


def test_the_command_refines_if_need_be_unless_it_is_told_otherwise(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = folder_of(tmp_path / "scene", 2), tmp_path / "out"
    reason = hindrance(scene(2))
    for asked in ("auto", "off", "on"):
        fit = ("decompose", folder, "--out", out, "--iterations", 1, "--overwrite", "--verbose")
        assert run(*fit, *(("--refine-normals", asked) if asked != "auto" else ())) == 0
        why, said = "not asked for" if asked == "off" else reason, capsys.readouterr()
        assert f"\nnormals: left as given: {why}\n" in said.out
        assert (f"normals are not refined: {reason}\n" in said.err) == (asked == "on")  # early
        content = json.loads((out / "result.json").read_text("utf-8"))
        assert content["options"]["refine_normals"] == content["normals"]["asked"] == asked
        assert content["normals"]["why"] == why


def test_inspect_says_whether_normals_can_be_refined_and_how_far_off_they_are(
    tmp_path: Path,
) -> None:
    said = done("inspect", folder_of(tmp_path / "two", 2))
    assert "normal error      unknown\n" in said
    assert f"refine normals    not possible: {hindrance(scene(2))}\n" in said
    three = folder_of(tmp_path / "three", 3, normal_sigma=np.full((SIZE, SIZE), 7.25))
    said = done("inspect", three)
    assert "normal error      7.2 degrees (median), 7.2 (95 %), from uncertainty.Y\n" in said
    assert "refine normals    possible\n" in said


def test_the_page_shows_given_and_refined_normals_and_the_decision(
    result: Result, tmp_path: Path
) -> None:
    page = written(result, tmp_path / "page.html")
    given, change = known(result.given_normals), known(result.normal_change)
    for alt, normals in (
        ("Normals as colours", result.normals),
        ("Normals as colours, given", given),
        ("Normals as colours, refined", result.normals),
    ):
        found = np.asarray(page.picture(alt))[..., :3]
        expected = np.rint(255 * (0.5 + 0.5 * normals))
        np.testing.assert_array_equal(found[result.mask], expected[result.mask])
    found = np.asarray(page.picture("Angle between given and refined normals").convert("RGBA"))
    expected = np.rint(255 * PALETTE[turned(change).indices()])
    np.testing.assert_array_equal(found[result.mask][:, :3], expected[result.mask])
    assert (found[~result.mask][:, 3] == 0).all()
    words = f"The normals were {result.refinement.in_words()}."
    assert page.text.count(words) == 2  # at the top, and beside the pictures
    assert "refined, in camera space" in page.text
    values = {float(e.attributes["value"]) for e in page.all("data")}
    assert set(result.refinement.figures.values()) <= values


@pytest.mark.slow
def test_the_page_says_why_normals_are_as_given(result: Result, tmp_path: Path) -> None:
    figures = {"noise": 0.01, "something_new": 3.0, "residual_before": math.nan}
    left = Refinement("auto", False, "the pictures are explained to their noise", figures)
    plain = dataclasses.replace(result, refinement=left, given_normals=None)
    page = written(plain, tmp_path / "page.html")
    words = "The normals were left as given: the pictures are explained to their noise."
    assert page.text.count(words) == 2
    assert "something new" in page.text
    assert "unknown" in page.text
    assert "Angle between" not in page.content
    off = dataclasses.replace(result, refinement=NOT_ASKED, given_normals=None)
    page = written(off, tmp_path / "page.html")
    assert "The normals were" not in page.text
    assert "as given, in camera space" in page.text
