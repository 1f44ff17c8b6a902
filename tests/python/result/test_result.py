"""The result folder (docs/formats.md): written, read by others, read back, refused when broken."""

from __future__ import annotations

import csv
import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from pbrfit import InputError, Result, Scene, Status, decompose
from pbrfit.model.reflection import DEFAULT_MODEL
from pbrfit.result.options import Priors
from pbrfit.synthetic import make_scene
from result_files import FILES, KEYS, layers_of
from scene_files import known

SIZE = 12
LAYERS = {
    *("albedo.R", "albedo.G", "albedo.B", "roughness.Y", "metallic.Y"),
    *("normal.X", "normal.Y", "normal.Z", "mask.Y"),
    *(
        f"uncertainty.{kind}{channel}"
        for kind in ("", "low.", "high.")
        for channel in ("albedo.R", "albedo.G", "albedo.B", "roughness.Y", "metallic.Y")
    ),
}
HISTORY = ["elapsed_s", "iteration", "evaluations", "loss", "recon_rmse"]
ERRORS = ["albedo_rmse", "roughness_rmse", "metallic_rmse"]


def masked_scene(*, truth: bool) -> Scene:
    made = make_scene("room", size=SIZE, lights=3, held_out=1)
    mask = np.ones((SIZE, SIZE), bool)
    mask[:, 0] = mask[4:7, 5:9] = False
    return Scene(
        images=made.images,
        normals=made.normals,
        fov=made.fov,
        mask=mask,
        names=("a", "b", "ç"),
        truth=made.truth if truth else None,
        inputs={"images/a.exr": "0" * 64},
        assumed={"fov": "60 degrees, asked for"},
    )


@pytest.fixture(scope="module")
def result() -> Result:
    return decompose(masked_scene(truth=False), solver="lbfgsb", iterations=30)


def test_files_and_layers_as_another_reader_sees_them(result: Result, tmp_path: Path) -> None:
    result.save(tmp_path / "out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == FILES

    layers = layers_of(tmp_path / "out" / "materials.exr")
    assert set(layers) == LAYERS
    assert all(layer.dtype == np.float32 for layer in layers.values())
    assert all(np.isfinite(layer).all() for layer in layers.values())
    mask = masked_scene(truth=False).valid
    np.testing.assert_array_equal(layers["mask.Y"], mask.astype(np.float32))
    maps = {
        **{f"albedo.{c}": result.albedo[..., i] for i, c in enumerate("RGB")},
        "roughness.Y": result.roughness,
        "metallic.Y": result.metallic,
        **{f"normal.{c}": result.normals[..., i] for i, c in enumerate("XYZ")},
    }
    rows, columns = np.nonzero(mask)
    for name, values in maps.items():
        np.testing.assert_array_equal(layers[name][mask], values[mask].astype(np.float32))
        assert np.isnan(values[~mask]).all()
    for row, column in np.argwhere(~mask):
        distance = (rows - row) ** 2 + (columns - column) ** 2
        nearest = np.flatnonzero(distance == distance.min())
        found = [layers[name][row, column] for name in maps]
        assert any(
            found == [layers[name][rows[i], columns[i]] for name in maps] for i in nearest
        ), f"row {row}, column {column}"


def test_lighting_and_result_json(result: Result, tmp_path: Path) -> None:
    result.save(tmp_path / "out")
    content = json.loads((tmp_path / "out" / "result.json").read_text("utf-8"))
    assert list(content) == KEYS
    assert content["status"] == "iteration_limit"
    assert content["iterations"] == 30
    assert list(content["metrics"]) == ["recon_rmse"]
    assert content["options"] == {
        "solver": "lbfgsb",
        "iterations": 30,
        "time_limit": None,
        "sh_order": 3,
        "metallic": None,
        "mono_light": False,
        "priors": dataclasses.asdict(Priors()),
        "robust": "auto",
        "equal_exposures": None,
        "white": None,
        "align": "auto",
        "response": "auto",
        "transport": "auto",
        "light": "auto",
        "same_lamp": False,
        "refine_normals": "auto",
        "model": None,
        "uncertainty": True,
    }
    assert content["model"] == DEFAULT_MODEL
    assert content["stages"] == [dataclasses.asdict(stage) for stage in result.stages]
    assert {type(stage["seconds"]) for stage in content["stages"]} == {float}
    assert content["assumed"] == {
        "fov": "60 degrees, asked for",
        "model": f"{DEFAULT_MODEL}, the default",
        "alignment": "not checked: pictures below 24 pixels",
        "scale": "by the highlights of dielectrics, with the material prior",
    }
    masked, monochrome, surroundings, lamps = content["left_out"]
    assert masked == f"{SIZE + 12} pixels outside the mask"
    assert monochrome.startswith("prior monochrome: coloured lights, 0.")
    assert surroundings == "surroundings: no depth is given"
    assert lamps == "lamps: not compared with environment light"
    assert content["inputs"] == {"images/a.exr": "0" * 64}

    light = json.loads((tmp_path / "out" / "lighting.json").read_text("utf-8"))
    assert light["basis"] == "real SH, no Condon-Shortley phase, index l(l+1)+m"
    assert light["order"] == 3
    assert light["pictures"] == ["a", "b", "ç"]
    np.testing.assert_array_equal(light["coefficients"], result.lighting)


@pytest.mark.parametrize("truth", [False, True])
def test_history_and_metrics_have_errors_where_there_is_truth(truth: bool, tmp_path: Path) -> None:
    result = decompose(masked_scene(truth=truth), solver="lbfgsb", iterations=3)
    result.save(tmp_path / "out")
    with (tmp_path / "out" / "history.csv").open(newline="") as file:
        header, *rows = csv.reader(file)
    assert header == (HISTORY + ERRORS if truth else HISTORY)
    assert [row[1] for row in rows] == ["0", "1", "2", "3"]
    assert np.isfinite(np.array(rows, dtype=float)).all()
    losses = [float(row[3]) for row in rows]
    assert losses == sorted(losses, reverse=True)
    content = json.loads((tmp_path / "out" / "result.json").read_text("utf-8"))
    expected = {"recon_rmse", *ERRORS, "albedo_scaled_rmse", "relight_rmse"}
    assert set(content["metrics"]) == (expected if truth else {"recon_rmse"})
    for name in ERRORS if truth else ():
        last = float(rows[-1][header.index(name)])
        assert content["metrics"][name] == pytest.approx(last, rel=1e-12)


def test_save_and_load_give_the_same_result(result: Result, tmp_path: Path) -> None:
    result.save(tmp_path / "out", scene=masked_scene(truth=True))
    loaded = Result.load(tmp_path / "out")
    for name in ("albedo", "roughness", "metallic", "normals"):
        stored = getattr(result, name).astype(np.float32)
        np.testing.assert_array_equal(getattr(loaded, name), stored)
    np.testing.assert_array_equal(loaded.lighting, result.lighting)
    np.testing.assert_array_equal(loaded.mask, result.mask)
    assert loaded.status is Status.ITERATION_LIMIT
    assert loaded.history.columns == result.history.columns
    for name in loaded.history.columns:
        np.testing.assert_array_equal(loaded.history[name], result.history[name])
    for name in (
        *("fov", "pictures", "stop_reason", "evaluations", "seconds", "metrics", "options"),
        *("assumed", "left_out", "stages", "inputs", "refinement", "camera", "held_out"),
    ):
        assert getattr(loaded, name) == getattr(result, name), name
    loaded.save(tmp_path / "again", scene=masked_scene(truth=True))
    for name in ("history.csv", "lighting.json", "materials.exr", "result.json"):
        again = (tmp_path / "again" / name).read_bytes()
        assert again == (tmp_path / "out" / name).read_bytes(), name


def edit(name: str, old: str, new: str) -> Any:
    def apply(folder: Path) -> None:
        text = (folder / name).read_text("utf-8")
        assert old in text
        (folder / name).write_text(text.replace(old, new), "utf-8")

    return apply


BROKEN: dict[str, tuple[Any, str]] = {
    "no maps": (lambda f: (f / "materials.exr").unlink(), "materials.exr"),
    "no lights": (lambda f: (f / "lighting.json").unlink(), "lighting.json"),
    "no history": (lambda f: (f / "history.csv").unlink(), "history.csv"),
    "no facts": (lambda f: (f / "result.json").unlink(), "result.json"),
    "half of the facts": (
        lambda f: (f / "result.json").write_text('{"version": '),
        "result.json: expected what pbrfit writes, found",
    ),
    "facts that are a list": (lambda f: (f / "result.json").write_text("[]"), "result.json: exp"),
    "no status": (edit("result.json", '"status"', '"state"'), "result.json: expected .*status"),
    "an unknown status": (edit("result.json", "iteration_limit", "tired"), "result.json: .*tired"),
    "an unknown option": (edit("result.json", '"solver"', '"engine"'), "result.json: .*engine"),
    "an empty history": (lambda f: (f / "history.csv").write_text(""), "history.csv: expected"),
    "a history without rows": (
        lambda f: (f / "history.csv").write_text(",".join(HISTORY)),
        "history.csv: expected .*no rows",
    ),
    "other columns": (edit("history.csv", "loss", "cost"), "history.csv: expected .*cost"),
    "words for numbers": (
        lambda f: (f / "history.csv").write_text(",".join(HISTORY) + "\n0,0,1,low,0"),
        "history.csv: expected .*low",
    ),
    "a short row": (
        lambda f: (f / "history.csv").write_text(",".join(HISTORY) + "\n0,0,1"),
        "history.csv: expected",
    ),
    "a missing layer": (
        lambda f: OpenEXR.File({}, {"albedo.R": np.ones((2, 2), np.float32)}).write(
            str(f / "materials.exr")
        ),
        "materials.exr: expected channel mask.Y, found albedo.R",
    ),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_folders_are_refused_in_one_line(result: Result, tmp_path: Path, name: str) -> None:
    result.save(tmp_path / "out")
    break_it, message = BROKEN[name]
    break_it(tmp_path / "out")
    with pytest.raises((InputError, OSError), match=message) as caught:
        Result.load(tmp_path / "out")
    assert "\n" not in str(caught.value)


def test_where_the_scene_was_is_told_from_the_result_folder(tmp_path: Path) -> None:
    make_scene("room", size=8, lights=2).save(tmp_path / "scenes" / "ä room")
    scene = Scene.load(
        tmp_path / "scenes" / "ä room", max_size=6, code_range=(0, 255), orientation="as-stored"
    )
    decompose(scene, iterations=1).save(tmp_path / "out" / "result")
    text = (tmp_path / "out" / "result" / "result.json").read_text("utf-8")
    assert json.loads(text)["scene"] == {
        "path": "../../scenes/ä room",
        "files": [],
        "color_space": None,
        "color_matrix": None,
        "max_size": 6,
        "code_range": [0, 255],
        "fov": None,
        "orientation": "as-stored",
        "layer": None,
        "alpha": None,
        "crop": None,
    }
    assert str(tmp_path) not in text
    assert Result.load(tmp_path / "out" / "result").source == scene.source

    Result.load(tmp_path / "out" / "result").save(tmp_path / "copy")
    assert Result.load(tmp_path / "copy").source == scene.source


def test_a_result_of_arrays_names_no_scene(result: Result, tmp_path: Path) -> None:
    result.save(tmp_path / "out")
    content = json.loads((tmp_path / "out" / "result.json").read_text("utf-8"))
    assert content["scene"] is None
    assert Result.load(tmp_path / "out").source is None


def test_depth_of_the_scene_goes_through_fit_and_file(tmp_path: Path) -> None:
    made = masked_scene(truth=False)
    depth = np.full((SIZE, SIZE), 2.5, np.float32)
    depth[2, 3] = np.nan
    found = decompose(dataclasses.replace(made, depth=depth), iterations=2, priors=Priors.none())
    expected = depth  # outside the mask, too, where things block light
    np.testing.assert_array_equal(known(found.depth), expected)
    found.save(tmp_path / "out")
    stored = layers_of(tmp_path / "out" / "materials.exr")["depth.Z"]
    assert stored[2, 3] == 0  # unknown
    assert stored[0, 0] == 2.5  # outside the mask
    loaded = Result.load(tmp_path / "out")
    assert known(loaded.depth).dtype == np.float32
    np.testing.assert_array_equal(known(loaded.depth), expected)
