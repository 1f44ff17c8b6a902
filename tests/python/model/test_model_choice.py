"""Which reflection model: said once, kept with scenes and results, never mixed."""

from __future__ import annotations

import ast
import dataclasses
import functools
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pbrfit
from pbrfit import InputError, Objective, Result, Scene, decompose, relight
from pbrfit.model.reflection import DEFAULT_MODEL, MODELS, Model, render_directional
from pbrfit.scene import folder as scene_folder
from pbrfit.synthetic import make_scene
from scene_files import held_out_of, lights_of, run, truth_of, write_folder

ROOT = Path(__file__).resolve().parents[3]
OTHER: dict[Model, Model] = {"paper": "principled", "principled": "paper"}
FEW = ("--iterations", 1, "--no-priors", "--quiet")


@functools.cache
def room(model: Model, noise: float = 0.0) -> Scene:
    return make_scene("room", size=12, lights=3, held_out=2, seed=3, model=model, noise=noise)


@functools.cache
def result(model: Model) -> Result:
    return decompose(room(model), iterations=2, refine_normals="off", priors=None)


def edited(folder: Path, **changes: Any) -> Path:
    """A result folder whose result.json says something else."""
    file = folder / "result.json"
    content = json.loads(file.read_text("utf-8")) | changes
    file.write_text(json.dumps(content), "utf-8")
    return folder


def misnamed(model: Any) -> Iterator[Callable[[], object]]:
    pixel: dict[str, Any] = {"normal": [0, 0, 1], "view": [0, 0, 1], "albedo": [0.5] * 3}
    pixel |= {"roughness": 0.5, "metallic": 0.0}
    scene = room("paper")
    known = truth_of(scene).materials, scene.normals
    light = np.zeros((16, 3))
    yield lambda: pbrfit.kernel.shade(**pixel, model=model)
    yield lambda: pbrfit.kernel.shade_vjp(**pixel, cotangent=np.zeros((3, 16)), model=model)
    yield lambda: pbrfit.kernel.render(*known, light, 60.0, model=model)
    yield lambda: render_directional(*known, [0, 0, 1], [1, 1, 1], 60.0, model=model)
    yield lambda: Objective(scene, model=model)
    yield lambda: decompose(scene, model=model)
    yield lambda: make_scene("room", size=8, model=model)
    yield lambda: dataclasses.replace(scene, model=model)


@pytest.mark.parametrize("model", ["eq12", "Paper", 3, np.arange(3)])
def test_a_name_of_no_model_is_refused_wherever_one_is_given(model: Any) -> None:
    for call in misnamed(model):
        with pytest.raises(InputError, match=r"^model: expected paper or principled, found .+$"):
            call()


MODEL_CALLS = ("render", "shade", "shade_vjp", "render_directional")


def calls_without_model(path: Path) -> list[str]:
    """Calls of the functions that have a model, imported from where they are, which do not say it.

    And those of the core's, which have it as their last argument.
    """
    text = path.read_text("utf-8")
    if not any(name in text for name in (*MODEL_CALLS, "Problem")):
        return []
    tree = ast.parse(text)
    imported = {
        alias.asname or alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module in ("pbrfit", "pbrfit.model.reflection")
        for alias in node.names
        if alias.name in MODEL_CALLS
    }
    found = []
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        named = isinstance(node.func, ast.Name) and node.func.id in imported
        of_core = ast.unparse(node.func) == "_core.Problem"
        partial = ast.unparse(node.func) == "partial" and ast.unparse(node.args[0]) in imported
        if (named or of_core or partial) and "model" not in {one.arg for one in node.keywords}:
            found.append(f"{path.name}:{node.lineno}: {ast.unparse(node.func)}")
    return found


def test_nothing_in_the_package_leaves_the_model_to_a_default() -> None:
    package = sorted((ROOT / "python" / "pbrfit").rglob("*.py"))
    assert len(package) > 100
    assert [call for path in package for call in calls_without_model(path)] == []


def test_a_call_that_leaves_it_to_the_default_would_be_found(tmp_path: Path) -> None:
    file = tmp_path / "some.py"
    file.write_text(
        "from pbrfit.model.reflection import render\nrender(m, n, light, 60.0)\n", "utf-8"
    )
    assert calls_without_model(file) == ["some.py:2: render"]


def test_scene_toml_names_a_model_or_is_refused(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "scene", fov='fov = 60\nmodel = "eq12"')
    with pytest.raises(InputError) as refused:
        Scene.load(folder)
    expected = "model: expected one of paper, principled, found 'eq12'"
    assert str(refused.value) == f"{folder / 'scene.toml'}: {expected}"


def test_synthetic_pictures_are_rendered_with_the_model_and_all_else_is_the_same() -> None:
    one, other = room("paper"), room("principled")
    np.testing.assert_array_equal(one.normals, other.normals)
    np.testing.assert_array_equal(truth_of(one).materials.albedo, truth_of(other).materials.albedo)
    for scene in (one, other):
        assert scene.model is not None
        known = truth_of(scene).materials, scene.normals
        lights = lights_of(scene), held_out_of(scene)[1]
        for light, images in zip(lights, (scene.images, held_out_of(scene)[0]), strict=True):
            again = pbrfit.kernel.render(*known, light, scene.fov, model=scene.model)
            np.testing.assert_allclose(again, images, rtol=1e-12, atol=0)
            apart = pbrfit.kernel.render(*known, light, scene.fov, model=OTHER[scene.model])
            assert np.abs(apart - images).max() > 0.01


@pytest.mark.parametrize("model", MODELS)
def test_a_fit_takes_the_model_of_the_scene_unless_told_otherwise(model: Model) -> None:
    found = result(model)
    assert found.model == model
    assert found.options.model is None
    assert found.assumed["model"] == f"{model}, with which the pictures were rendered"
    other = decompose(
        room(model), iterations=0, refine_normals="off", priors=None, model=OTHER[model]
    )
    assert other.model == other.options.model == OTHER[model]
    asked = f"{OTHER[model]}, asked for; the pictures were rendered with {model}"
    assert other.assumed["model"] == asked
    unknown = dataclasses.replace(room(model), model=None)
    default = decompose(unknown, iterations=0, refine_normals="off", priors=None)
    assert default.model == DEFAULT_MODEL
    assert default.assumed["model"] == f"{DEFAULT_MODEL}, the default"


@pytest.mark.parametrize("model", MODELS)
def test_errors_of_a_result_are_those_of_its_own_model(model: Model) -> None:
    scene = room(model)
    for found in (result(model), decompose(scene, iterations=0, model=OTHER[model])):
        images = relight(found, found.lighting)
        assert pbrfit.result.metrics.rmse(images, scene.images) == pytest.approx(
            found.metrics["recon_rmse"], rel=1e-9
        )
        relit = relight(found, held_out_of(scene)[1])
        assert pbrfit.result.metrics.rmse(relit, held_out_of(scene)[0]) == pytest.approx(
            found.metrics["relight_rmse"], rel=1e-9
        )


@pytest.mark.parametrize("model", MODELS)
def test_a_result_to_start_from_is_of_the_same_model(model: Model) -> None:
    found = result(model)
    again = decompose(room(model), iterations=0, start=found, refine_normals="off", priors=None)
    np.testing.assert_array_equal(again.roughness, found.roughness)
    np.testing.assert_allclose(again.lighting, found.lighting, rtol=1e-12)
    message = f"^start: expected a result of model {OTHER[model]}, found one of model {model}; "
    with pytest.raises(InputError, match=message):
        decompose(room(model), start=found, model=OTHER[model])
    decompose(room(model), start=found.materials, model=OTHER[model], iterations=0)


@pytest.mark.parametrize("name", ["eq12", ["paper"]])
def test_a_result_of_no_known_model_is_refused(name: Any, tmp_path: Path) -> None:
    result("paper").save(tmp_path / "out")
    file = edited(tmp_path / "out", model=name) / "result.json"
    with pytest.raises(InputError, match="model: expected paper or principled, found") as refused:
        Result.load(tmp_path / "out")
    assert str(refused.value).startswith(f"{file}: model: ")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("light", [np.ones((16, 3)), pbrfit.DirectionalLight(20, 30)])
def test_a_result_is_relit_with_its_own_model(model: Model, light: Any) -> None:
    found = result(model)
    relit = relight(found, light)
    swapped = dataclasses.replace(found, model=OTHER[model])
    assert np.abs(relight(swapped, light) - relit).max() > 1e-3


def test_the_command_renders_and_fits_with_a_model(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, out = tmp_path / "scene", tmp_path / "out"
    assert run("synth", scene, "--size", 12, "--lights", 3, "--model", "principled") == 0
    assert scene_folder.read_settings(scene / "scene.toml").model == "principled"
    capsys.readouterr()
    assert run("inspect", scene) == 0
    assert "assumed model     principled, with which the pictures" in capsys.readouterr().out
    assert run("check-gradients", scene) == 0
    assert run("decompose", scene, "--out", out, *FEW) == 0
    assert Result.load(out).model == "principled"
    assert run("decompose", scene, "--out", out, *FEW, "--model", "paper", "--overwrite") == 0
    assert Result.load(out).model == "paper"


def test_results_of_other_models_stay(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, out = write_folder(tmp_path / "scenes" / "one"), tmp_path / "out"
    fit = ("decompose", scene, "--out", out, *FEW)
    assert run(*fit, "--model", "paper") == 0
    before = (out / "result.json").read_bytes()
    assert run(*fit, "--model", "paper", "--resume") == 0
    capsys.readouterr()
    assert run(*fit, "--model", "principled", "--resume") == 2
    assert capsys.readouterr().err == (
        f"pbrfit: {out}: expected a result of model principled to resume, found one of model "
        "paper; --model paper keeps it, --overwrite replaces it\n"
    )
    assert (out / "result.json").read_bytes() == before
    assert run(*fit, "--model", "principled", "--overwrite") == 0
    assert Result.load(out).model == "principled"
