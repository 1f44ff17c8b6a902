"""What notebooks and prompts show: short names, maps, verdicts, and a call for each next thing."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from left_out_pictures import EXPLAINED, SENTENCE
from page_reader import Page, decoded
from pbrfit import DirectionalLight, InputError, Result, Scene, decompose, relight
from pbrfit.display.notebook import PICTURES_MAX
from pbrfit.result.advice import next_steps
from pbrfit.result.verdict import MARKS, Verdict, in_short
from pbrfit.synthetic import make_scene
from scene_files import known

VERDICTS = {
    "albedo": Verdict("usable", 0.031),
    "roughness": Verdict("rough guide", 0.12, "<b>few</b> & dim lights", "more would help"),
    "metallic": Verdict("not determined", 0.31),
}


@pytest.fixture(scope="module")
def scene() -> Scene:
    mask = np.ones((8, 12), bool)
    mask[:, :2] = False
    made = make_scene("room", size=12, lights=3, held_out=1, noise=0.01)
    return Scene(images=made.images[:, :8], normals=made.normals[:8], fov=50, mask=mask)


@pytest.fixture(scope="module")
def result(scene: Scene) -> Result:
    found = decompose(scene, iterations=2, refine_normals="off")
    return replace(found, uncertainty=replace(known(found.uncertainty), verdicts=VERDICTS))


def test_names_are_short_and_hold_no_arrays(scene: Scene, result: Result) -> None:
    assert repr(scene) == ("Scene(3 pictures of 12 × 8, fov 50°, normals, 80 of 96 pixels valid)")
    assert repr(result) == (
        "Result(3 pictures of 12 × 8, model paper, iteration_limit, residual "
        f"{result.metrics['recon_rmse']:.3g}, albedo usable, roughness rough guide, "
        "metallic not determined)"
    )
    assert repr(result.materials) == "Materials(12 × 8)"
    assert repr(result.uncertainty) == (
        "Uncertainty(albedo usable, roughness rough guide, metallic not determined)"
    )
    unknown = Scene(images=scene.images, segments=np.zeros((8, 12), int))
    assert repr(unknown) == (
        "Scene(3 pictures of 12 × 8, fov 60°, to be fitted, no normals, segments known)"
    )


def notebook(result: Result) -> Page:
    """What a notebook shows of a result, as a page."""
    return Page(f"<!doctype html>\n<body>{result._repr_html_()}</body>")


def test_a_notebook_shows_maps_and_verdicts(result: Result) -> None:
    page = notebook(result)
    maps = [image.attributes["alt"] for image in page.all("img")]
    assert maps == ["albedo", "roughness", "metallic", "normals"]
    for name, one in VERDICTS.items():
        assert f"{MARKS[one.level].sign} {in_short(name, one)}" in page.text
    assert all(step in page.text for step in next_steps(result))  # escaped, and so read as it is
    assert page.all("b") == []
    assert "expected error" not in notebook(replace(result, uncertainty=None)).text


def test_a_notebook_says_how_left_out_pictures_are_explained(result: Result) -> None:
    for held_out in (EXPLAINED, None):
        text = notebook(replace(result, held_out=held_out)).text
        assert (SENTENCE in text) == ("not fitted to" in text) == (held_out is not None)


def test_a_notebook_shows_a_scene_in_small(scene: Scene) -> None:
    bright = np.repeat(np.repeat(scene.images, 40, axis=1), 40, axis=2)
    mask = np.repeat(np.repeat(scene.valid, 40, axis=0), 40, axis=1)
    many = Scene(
        images=np.concatenate([bright] * 10),
        mask=mask,
        names=[f"<{i}>" for i in range(30)],  # type: ignore[arg-type]
        assumed={"fov": "a & b"},
    )
    page = Page(f"<!doctype html>\n<body>{many._repr_html_()}</body>")
    shown = [np.asarray(decoded(image)) for image in page.all("img")]
    assert len(shown) == PICTURES_MAX
    assert {max(codes.shape) for codes in shown} == {128}
    assert np.mean(shown[0][..., 3] > 0) == pytest.approx(mask.mean(), abs=0.02)
    opaque = np.concatenate([codes[codes[..., 3] == 255][:, :3] for codes in shown]) / 255
    assert np.mean(opaque == 1) == pytest.approx(0.02, abs=0.01)
    for said in ("<0>", "fov: a & b", f"{30 - PICTURES_MAX} more pictures", repr(many)):
        assert said in page.text


def test_a_path_is_as_good_as_a_scene(folder: Path, tmp_path: Path) -> None:
    options: dict[str, Any] = {"iterations": 1, "refine_normals": "off"}
    expected = decompose(Scene.load(folder), **options)
    for path in (folder, str(folder)):
        found = decompose(path, **options)
        np.testing.assert_array_equal(found.albedo, expected.albedo)
        assert found.source == expected.source
    with pytest.raises(FileNotFoundError, match="none: expected a scene folder"):
        decompose(tmp_path / "none")
    with pytest.raises(InputError, match="scene: expected a Scene or the path of a scene folder"):
        decompose(5)  # type: ignore[arg-type]


def test_progress_by_a_bar(scene: Scene, capsys: pytest.CaptureFixture[str]) -> None:
    options: dict[str, Any] = {"iterations": 2, "refine_normals": "off"}
    shown = decompose(scene, progress=True, **options)
    assert re.search(r"fit: .*\d+/\d+.*recon", capsys.readouterr().err)
    quiet = decompose(scene, progress=False, **options)
    assert capsys.readouterr().err == ""
    np.testing.assert_array_equal(shown.albedo, quiet.albedo)


def test_what_comes_next_is_one_call(result: Result, tmp_path: Path) -> None:
    result.report(tmp_path / "page.html")
    assert "<html" in (tmp_path / "page.html").read_text("utf-8")
    exported = result.export(tmp_path / "textures", format="png")
    assert (tmp_path / "textures" / "export.json").exists()
    assert {"png/roughness.png"} <= {file.path for file in exported.files}
    light = DirectionalLight(-40, 30)
    np.testing.assert_array_equal(result.relight(light), relight(result, light))
    np.testing.assert_array_equal(
        result.relight(result.lighting[0]), relight(result, result.lighting[0])
    )


def test_refusals_speak_python(result: Result, tmp_path: Path) -> None:
    for write in (result.save, result.report, result.export):
        path = tmp_path / f"{write.__name__}.html"
        write(path)
        with pytest.raises(FileExistsError, match=r"; overwrite=True replaces it$") as refused:
            write(path)
        assert "--" not in str(refused.value)
    (tmp_path / "save.html" / "result.json").write_text("old")
    result.save(tmp_path / "save.html", overwrite=True)
    assert Result.load(tmp_path / "save.html").evaluations == result.evaluations
    assert len(list(tmp_path.iterdir())) == 3
