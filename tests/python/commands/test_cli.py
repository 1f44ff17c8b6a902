"""The command line: what each command does, prints, writes and returns."""

from __future__ import annotations

import argparse
import dataclasses
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pbrfit import InputError, Result, Scene
from pbrfit.commands.fit_options import add_priors, given_priors
from pbrfit.io import images
from pbrfit.model.lighting import Lighting
from pbrfit.result.options import Priors
from pbrfit.synthetic import make_scene
from result_files import FILES, KEYS
from scene_files import (
    FORMATS,
    LIGHTS,
    SIZE,
    one_line,
    room,
    run,
    write_folder,
    write_jpeg,
    write_normals,
)

FEW = ("--iterations", 3)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_folder(tmp_path / "scene")


def outcome(out: Path) -> Any:
    return json.loads((out / "result.json").read_text("utf-8"))


def without_priors(left_out: list[str]) -> list[str]:
    """Beside priors, which depend on the lights that were found."""
    return [entry for entry in left_out if not entry.startswith("prior")]


# decompose


@pytest.mark.parametrize("form", FORMATS)
def test_decompose_every_format(
    tmp_path: Path, form: str, capsys: pytest.CaptureFixture[str]
) -> None:
    suffix, _, _, color = FORMATS[form]
    folder, out = write_folder(tmp_path / "scene", form), tmp_path / "out"
    assert run("decompose", folder, "--out", out, *FEW) == 0
    captured = capsys.readouterr()
    assert captured.err == ""  # no progress bar where stderr is no terminal
    assert f"{out}: 3 pictures of 16 × 16, 3 iterations in " in captured.out
    assert sorted(path.name for path in out.iterdir()) == FILES
    facts = outcome(out)
    assert list(facts) == KEYS
    assert facts["version"] == version("pbrfit")
    assert facts["assumed"]["color"].startswith(color)
    assert facts["assumed"]["fov"] == "60 degrees, from scene.toml"
    assert f"images/light_00{suffix}" in facts["inputs"]
    assert all(re.fullmatch("[0-9a-f]{64}", value) for value in facts["inputs"].values())
    assert Result.load(out).metrics["recon_rmse"] < 0.1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "scene"]


def test_decompose_says_what_it_assumed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, out = write_folder(tmp_path / "scene", "8-bit PNG", fov=None), tmp_path / "out"
    assert run("decompose", folder, "--out", out, *FEW, "--max-size", 8) == 0
    assert "WARNING" in (message := capsys.readouterr().err)
    assert f"{folder}: field of view unknown, assumed 60 degrees" in message
    assumed = outcome(out)["assumed"]
    assert assumed["fov"].startswith("60 degrees: neither")
    assert assumed["size"] == "averaged down from 16 × 16 to 8 × 8 pixels"
    assert "code 250 of 255" in assumed["exposure"]  # the room's brightest pixel is 255
    arguments = ("--fov", 40, "--color-space", "linear", "--code-range", "0,255", "--overwrite")
    assert run("decompose", folder, "--out", out, *FEW, *arguments) == 0
    assert capsys.readouterr().err == ""
    assumed = outcome(out)["assumed"]
    assert assumed["fov"] == "40 degrees, asked for"
    assert assumed["color"] == "linear (as asked for)"
    assert "exposure" not in assumed
    assert outcome(out)["fov"] == 40


def test_robust_loss_and_exposures(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert run("decompose", folder, "--out", out, *FEW) == 0
    facts = outcome(out)
    assert (facts["options"]["robust"], facts["options"]["equal_exposures"]) == ("none", None)
    assert "exposures" not in facts["assumed"]
    arguments = ("--robust", "cauchy", "--exposures", "equal", "--overwrite")
    assert run("decompose", folder, "--out", out, *FEW, *arguments) == 0
    facts = outcome(out)
    assert (facts["options"]["robust"], facts["options"]["equal_exposures"]) == ("cauchy", True)
    assert "each picture counts relative to its own" in facts["assumed"]["exposures"]
    assert run("decompose", folder, "--out", out, *FEW, "--exposures", "as-is", "--overwrite") == 0
    assert outcome(out)["options"]["equal_exposures"] is False
    demo = ("--size", 8, "--lights", 2, "--robust", "huber", "--exposures", "equal")
    assert run("demo", tmp_path / "demo", *demo, *FEW, "--quiet") == 0
    assert outcome(tmp_path / "demo" / "result")["options"]["robust"] == "huber"


def test_known_lights_stay_as_they_are(tmp_path: Path) -> None:
    made = make_scene("room", size=SIZE, lights=LIGHTS, held_out=1)
    assert made.truth is not None
    assert made.truth.lighting is not None
    made.save(tmp_path / "scene")
    shutil.copy(tmp_path / "scene" / "truth" / "lighting.json", tmp_path / "scene")
    for path in sorted((tmp_path / "scene" / "images").iterdir())[1:]:
        path.unlink()  # a single picture will do now
    out = tmp_path / "out"
    assert run("decompose", tmp_path / "scene", "--out", out, *FEW) == 0
    facts = outcome(out)
    assert without_priors(facts["left_out"]) == [
        "lights and their gradient: known, so only materials were fitted"
    ]
    assert facts["assumed"]["lighting"] == "known, from lighting.json"
    light = Lighting.load(out / "lighting.json")
    assert light.pictures == ("light_00",)
    np.testing.assert_array_equal(light.coefficients[0], made.truth.lighting[0])


def test_names_in_any_script(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "Küche 厨房 🏺")
    out = tmp_path / "Ergebnis für später"
    assert run("decompose", folder, "--out", out, *FEW) == 0
    assert Result.load(out).pictures == room().names


def test_quiet_prints_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_folder(tmp_path / "scene", fov=None)
    assert run("decompose", folder, "--out", tmp_path / "out", *FEW, "--quiet") == 0
    assert run("demo", tmp_path / "demo", "--size", 8, "--lights", 2, *FEW, "--quiet") == 0
    assert capsys.readouterr() == ("", "")
    assert run("decompose", tmp_path / "none", "--out", tmp_path / "out", "--quiet") == 2
    assert "none: expected a scene folder" in one_line(capsys)  # errors are shown


def test_a_result_is_replaced_only_when_asked(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert run("decompose", folder, "--out", out, "--iterations", 1) == 0
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    capsys.readouterr()
    assert run("decompose", folder, "--out", out, "--iterations", 2) == 2
    assert f"{out}: expected a folder that does not exist yet" in one_line(capsys)
    (folder / "normals.exr").rename(folder / "away")
    assert run("decompose", folder, "--out", out, "--iterations", 2, "--overwrite") == 2
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    (folder / "away").rename(folder / "normals.exr")
    assert run("decompose", folder, "--out", out, "--iterations", 2, "--overwrite") == 0
    assert outcome(out)["iterations"] == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "scene"]


@pytest.mark.parametrize("out", ["scene", "."])
def test_the_scene_is_never_replaced_by_its_result(
    folder: Path, out: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("decompose", folder, "--out", folder.parent / out, "--overwrite") == 2
    assert "expected a folder apart from the scene, found" in one_line(capsys)
    assert len(list((folder / "images").iterdir())) == LIGHTS


@pytest.mark.parametrize("command", ["decompose", "synth", "demo"])
@pytest.mark.parametrize("inside", ["images", "thesis"])
def test_only_an_earlier_output_is_replaced(
    folder: Path, command: str, inside: str, capsys: pytest.CaptureFixture[str]
) -> None:
    precious = folder / inside
    precious.mkdir(exist_ok=True)
    (precious / "thesis.txt").write_text("three years")
    before = sorted(path.name for path in precious.iterdir())
    arguments: tuple[str | Path | int, ...] = (command, precious, "--size", 8)
    if command == "decompose":
        arguments = (command, folder, "--out", precious, *FEW)
    assert run(*arguments, "--overwrite") == 2
    assert f"{precious}: expected an earlier output to replace" in one_line(capsys)
    assert sorted(path.name for path in precious.iterdir()) == before


def test_nobody_reading_the_table_does_not_fail_the_fit(folder: Path, tmp_path: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("no device that is always full")
    command = [sys.executable, "-m", "pbrfit", "decompose", folder, "--out", tmp_path / "out"]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run([*map(str, command), *map(str, FEW)], stdout=full, check=False)
    assert done.returncode == 0
    assert (tmp_path / "out" / "result.json").exists()


def test_near_misses_are_named(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    (folder / "Mask.tif").write_bytes(b"")
    Scene.load(folder)
    [record] = caplog.records
    assert f"{folder / 'Mask.tif'}: not read; expected" in record.message


# Several scenes


@pytest.fixture
def scenes(tmp_path: Path) -> Path:
    for name in ("one", "two"):
        write_folder(tmp_path / "scenes" / name)
    (tmp_path / "scenes" / "notes").mkdir()
    return tmp_path / "scenes"


@pytest.mark.parametrize("as_folder", [True, False])
def test_several_scenes_go_below_the_output(tmp_path: Path, scenes: Path, as_folder: bool) -> None:
    given = [scenes] if as_folder else [scenes / "one", scenes / "two"]
    out = tmp_path / "out"
    assert run("decompose", *given, "--out", out, *FEW) == 0
    assert sorted(path.name for path in out.iterdir()) == ["one", "two"]
    for name in ("one", "two"):
        assert sorted(path.name for path in (out / name).iterdir()) == FILES


def test_a_folder_of_one_scene_is_a_folder_of_scenes(tmp_path: Path, scenes: Path) -> None:
    shutil.rmtree(scenes / "two")
    assert run("decompose", scenes, "--out", tmp_path / "out", *FEW) == 0
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["one"]


def test_a_failing_scene_does_not_stop_the_others(
    tmp_path: Path, scenes: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (scenes / "one" / "normals.exr").unlink()
    assert run("decompose", scenes, "--out", tmp_path / "out", *FEW) == 1
    first, last = capsys.readouterr().err.splitlines()
    assert first.startswith(f"pbrfit: {scenes / 'one'}: expected normals.exr or normals.png")
    assert last == f"pbrfit: 1 of 2 scenes failed: {scenes / 'one'}"
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["two"]


def test_when_all_scenes_fail_nothing_is_left(
    tmp_path: Path, scenes: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("decompose", scenes, "--out", tmp_path / "out", "--iterations", -1) == 2
    lines = capsys.readouterr().err.splitlines()
    expected = "iterations: expected a whole number, 0 or more, found -1"
    assert lines[0] == f"pbrfit: {scenes / 'one'}: {expected}"
    assert lines[2].startswith("pbrfit: 2 of 2 scenes failed")
    assert not (tmp_path / "out").exists()


def test_equal_names_and_taken_outputs_are_refused_before_any_work(
    tmp_path: Path, scenes: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_folder(tmp_path / "more" / "two")
    out = tmp_path / "out"
    assert run("decompose", scenes, tmp_path / "more" / "two", "--out", out, *FEW) == 2
    assert "expected different names, found two twice" in one_line(capsys)
    assert not out.exists()
    (out / "two").mkdir(parents=True)
    assert run("decompose", scenes, "--out", out, *FEW) == 2
    assert f"{out / 'two'}: expected a folder that does not exist yet" in one_line(capsys)
    assert not (out / "one").exists()
    assert run("decompose", scenes, "--out", scenes, "--overwrite", *FEW) == 2
    assert "expected a folder apart from the scene" in one_line(capsys)


# The other commands


def test_inspect_tells_facts_and_writes_only_the_preview(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mask = np.full((SIZE, SIZE), 255, np.uint8)
    mask[:4] = 0
    images.write_png(folder / "mask.png", mask, tag=None)
    preview = tmp_path / "preview.png"
    assert run("inspect", folder, "--preview", preview) == 0
    output = capsys.readouterr()
    assert output.err == ""
    for line in (
        "pictures          3 of 16 × 16 pixels",
        "mask              192 pixels used, 75.0 %",
        "facing away       0.0 % of the normals",
        "segments          none",
        "colour            three channels",
        "lights            unknown, will be fitted",
        "ground truth      none",
        "assumed color     linear Rec.709",
        "assumed normals   normals.exr, opengl axes, camera space",
        "assumed fov       60 degrees, from scene.toml",
        f"unknowns          {5 * 192 + 48 * LIGHTS}",
        "memory needed     about ",
    ):
        assert f"\n{line}" in f"\n{output.out}"
    assert images.read_data(preview).shape[2] == 3
    assert sorted(path.name for path in tmp_path.iterdir()) == ["preview.png", "scene"]


def test_synth_with_textures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, maps = tmp_path / "scene", tmp_path / "maps"
    arguments = ("--scene", "detailed", "--size", 8, "--lights", 2, "--textures", maps)
    assert run("synth", scene, *arguments) == 2
    assert f"{maps}: expected a folder of texture maps, found none" in one_line(capsys)
    maps.mkdir()
    for name in ("clay_albedo", "clay_roughness"):
        images.write_png(maps / f"{name}.png", np.full((4, 4, 3), 120, dtype=np.uint8), tag=None)
    assert run("synth", scene, *arguments) == 0
    assert f"{scene}: detailed, 2 pictures and ground truth" in capsys.readouterr().out
    made = make_scene("detailed", size=8, lights=2, textures=maps)
    np.testing.assert_array_equal(Scene.load(scene).images, made.images.astype(np.float32))
    assert run("synth", tmp_path / "other", "--scene", "room", "--textures", maps) == 2
    assert "textures: expected the kind detailed with them, found room" in one_line(capsys)


def test_synth_then_decompose(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "scene"
    arguments = ("--scene", "spheres", "--size", 8, "--lights", 3, "--noise", 0.01, "--seed", 5)
    assert run("synth", scene, *arguments) == 0
    assert f"{scene}: spheres, 3 pictures and ground truth" in capsys.readouterr().out
    made = make_scene("spheres", size=8, lights=3, noise=0.01, seed=5)
    loaded = Scene.load(scene)
    np.testing.assert_array_equal(loaded.images, made.images.astype(np.float32))
    assert len(list((scene / "truth" / "relight").glob("*.exr"))) == 16
    assert run("synth", scene) == 2
    assert "expected a folder that does not exist yet" in one_line(capsys)
    assert run("synth", scene, *arguments, "--overwrite", "--sh-order", 2) == 0
    assert run("decompose", scene, "--out", tmp_path / "out", *FEW) == 0
    table = capsys.readouterr().out
    for name in ("reconstruction", "albedo", "albedo, best scale", "roughness", "metallic"):
        assert re.search(rf"^{name} .*\d\.\d{{4}}$", table, re.MULTILINE)
    assert re.search(r"^relight +\d\.\d{4}$", table, re.MULTILINE)
    history = Result.load(tmp_path / "out").history
    assert history.columns[5:] == ("albedo_rmse", "roughness_rmse", "metallic_rmse")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--size", 0), "size"),
        (("--lights", 0), "expected at least 1 light"),
        (("--lights", 1), "images: expected at least two pictures"),
        (("--noise", -1), "noise"),
        (("--seed", -1), "seed"),
    ],
)
def test_synth_refuses_what_it_cannot_make(
    tmp_path: Path, arguments: Any, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for command in ("synth", "demo"):
        assert run(command, tmp_path / "a" / "scene", *arguments) == 2
        assert message in one_line(capsys)
    assert not list(tmp_path.iterdir())


def test_normals_from_flat(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("normals", folder, "--from", "flat") == 2
    assert "normals.exr: expected no normals yet, found some" in one_line(capsys)
    (folder / "normals.exr").rename(folder / "normals.png")  # to be replaced, so never read
    assert run("normals", folder, "--from", "flat", "--overwrite") == 0
    assert not (folder / "normals.png").exists()
    scene = Scene.load(folder)
    np.testing.assert_array_equal(scene.normals, np.broadcast_to([0, 0, 1], (SIZE, SIZE, 3)))
    assert run("normals", tmp_path / "none") == 2


def test_real_photographs_of_the_multi_illumination_layout(
    shared_data: Path, tmp_path: Path
) -> None:
    pictures = sorted((shared_data / "mit_multi_illumination").rglob("dir_*_mip6.jpg"))
    if not pictures:
        pytest.skip("these photographs are not in the data folder")
    scene = tmp_path / "kitchen"
    scene.mkdir()
    for path in pictures:
        shutil.copy(path, scene)
    assert run("normals", scene, "--from", "flat") == 0
    assert run("decompose", scene, "--out", tmp_path / "out", *FEW, "--max-size", 40) == 0
    facts = outcome(tmp_path / "out")
    assert len(facts["inputs"]) == 26
    assert facts["assumed"]["color"].startswith("sRGB (8-bit JPEG")


@pytest.mark.parametrize(
    ("arguments", "count", "left_out"),
    [(("--seed", 1), 12, ()), (("--sh-order", 2, "--metallic", 0), 9, ("metallic",))],
)
def test_check_gradients(
    folder: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: tuple[str | int, ...],
    count: int,
    left_out: tuple[str, ...],
) -> None:
    assert run("check-gradients", folder, *arguments) == 0
    output = capsys.readouterr().out
    assert f"{count} of {count} within" in output
    for name in ("albedo", "roughness", "metallic", "lighting"):
        assert (name in output) == (name not in left_out)


@pytest.mark.parametrize(("loss", "tolerance"), [("huber", "0.001"), ("cauchy", "0.0001")])
def test_check_gradients_of_robust_losses(
    folder: Path, capsys: pytest.CaptureFixture[str], loss: str, tolerance: str
) -> None:
    assert run("check-gradients", folder, "--robust", loss, "--exposures", "equal") == 0
    of_loss = capsys.readouterr().out
    assert f"12 of 12 within {tolerance}\n" in of_loss
    assert run("check-gradients", folder, "--exposures", "equal") == 0
    assert capsys.readouterr().out != of_loss


def test_check_gradients_of_priors(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    priors = ("--prior", "smoothness=0.1", "--prior", "monochrome=1", "--prior", "sparsity=1e-3")
    assert run("check-gradients", folder, *priors) == 0
    output = capsys.readouterr().out
    assert "24 of 24 within" in output
    for name, count in (("smoothness", 6), ("monochrome", 3), ("sparsity", 3)):
        assert output.count(f"\n{name} ") == count
    assert run("check-gradients", folder, "--mono-light", *priors) == 0
    assert "monochrome" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("prior", "complaint"),
    [
        ("cohesin=1", "expected NAME=WEIGHT with one of material, cohesion, smoothness"),
        ("cohesion", "expected a finite weight of 0 or more for cohesion, found ''"),
        ("cohesion=", "expected a finite weight of 0 or more for cohesion, found ''"),
        ("cohesion=much", "for cohesion, found 'much'"),
        ("sparsity=-1", "for sparsity, found '-1'"),
        ("material=nan", "for material, found 'nan'"),
        ("smoothness=inf", "for smoothness, found 'inf'"),
    ],
)
def test_unusable_priors_are_named(
    folder: Path, capsys: pytest.CaptureFixture[str], prior: str, complaint: str
) -> None:
    assert run("check-gradients", folder, "--prior", prior) == 2
    assert complaint in one_line(capsys)


def test_priors_that_are_asked_for_are_those_of_the_fit() -> None:
    parser = argparse.ArgumentParser()
    add_priors(parser)

    def priors(*arguments: str) -> Priors:
        return given_priors(parser.parse_args(arguments))

    assert priors() == Priors()
    assert priors("--no-priors") == Priors.none()
    assert priors("--prior", "cohesion=2", "--prior", "material=0") == Priors(
        material=0, cohesion=2
    )
    assert priors("--prior", "cohesion=2", "--prior", "cohesion=3").cohesion == 3
    only = dataclasses.replace(Priors.none(), monochrome=0.5)
    assert priors("--no-priors", "--prior", "monochrome=0.5") == only


def test_parts_of_the_model_can_be_left_out(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    arguments = ("--sh-order", 2, "--metallic", 0)
    assert run("decompose", folder, "--out", out, *FEW, *arguments) == 0
    facts = outcome(out)
    assert facts["options"]["sh_order"] == 2
    assert facts["options"]["metallic"] == 0.0
    assert without_priors(facts["left_out"]) == [
        "band 3 of the lights: order 2 was asked for",
        "metallic: given, so it was not fitted",
    ]
    result = Result.load(out)
    assert not result.lighting[:, 9:].any()
    assert not result.metallic.any()


def test_nothing_is_left_out_unasked(folder: Path, tmp_path: Path) -> None:
    for arguments in ((), ("--sh-order", 3, "--metallic", "free")):
        out = tmp_path / f"out{len(arguments)}"
        assert run("decompose", folder, "--out", out, *FEW, *arguments) == 0
        facts = outcome(out)
        assert facts["options"]["sh_order"] == 3
        assert facts["options"]["metallic"] is None
        assert without_priors(facts["left_out"]) == []


def test_what_was_left_out_is_printed(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = (*FEW, "--overwrite", "--no-priors", "--mono-light")
    arguments = ("decompose", folder, "--out", tmp_path / "out", *options)
    assert run(*arguments) == 0
    left_out = outcome(tmp_path / "out")["left_out"]
    assert "colour of the lights: one light for all channels was asked for" in left_out
    assert "priors: none asked for" in left_out
    assert f"\nleft out: {'; '.join(left_out)}\n" in capsys.readouterr().out
    lights = Result.load(tmp_path / "out").lighting
    np.testing.assert_array_equal(lights[..., 0], lights[..., 2])
    assert run(*arguments, "--quiet") == 0
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("command", ["decompose", "demo"])
def test_priors_change_a_fit(command: str, folder: Path, tmp_path: Path) -> None:
    found = []
    for weight in (0, 1000):
        out = tmp_path / f"out{weight}"
        to = ("--out", out) if command == "decompose" else ("--size", 8, "--lights", 3)
        first = folder if command == "decompose" else out
        options = ("--no-priors", "--prior", f"smoothness={weight}", "--quiet", "--iterations", 200)
        assert run(command, first, *to, *options) == 0
        result = Result.load(out if command == "decompose" else out / "result")
        found.append(np.nanstd(np.diff(result.roughness, axis=0)))
    assert found[1] < 0.95 * found[0]


def test_inspect_says_what_a_fit_would_have(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("inspect", folder) == 0
    text = capsys.readouterr().out
    assert f"\nfit by default    {SIZE**2} pixels of 3 pictures; albedo in three channels; " in text
    assert "; prior monochrome, if the fitted lights are near grey; " in text
    assert "\nleft out          nothing\n" in text


def test_grey_pictures_are_fitted_in_one_channel(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = tmp_path / "scene", tmp_path / "out"
    grey = np.repeat(room().images[..., :1], 3, axis=-1)
    Scene(images=grey, normals=room().normals, names=room().names).save(folder)
    assert run("inspect", folder) == 0
    text = capsys.readouterr().out
    assert "colour            grey: one channel will be fitted\n" in text
    assert f"unknowns          {3 * SIZE**2 + 16 * LIGHTS}\n" in text
    assert run("decompose", folder, "--out", out, *FEW) == 0
    assert without_priors(outcome(out)["left_out"]) == [
        "second and third colour channel: equal to the first"
    ]
    albedo = Result.load(out).albedo
    np.testing.assert_array_equal(albedo[..., 0], albedo[..., 2])


def test_demo(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "demo"
    assert run("demo", out, "--size", 8, "--lights", 3, *FEW) == 0
    assert "roughness" in capsys.readouterr().out
    made = ["history.png", "relit.png", "relit.webp", "report.html", "result", "scene"]
    assert sorted(path.name for path in out.iterdir()) == made
    assert sorted(path.name for path in (out / "result").iterdir()) == FILES
    assert Result.load(out / "result").metrics["relight_rmse"] > 0
    assert run("demo", out) == 2
    assert run("demo", out, "--size", 8, "--lights", 3, *FEW, "--overwrite") == 0


def test_a_demo_of_order_two_is_fitted_at_order_two(tmp_path: Path) -> None:
    out = tmp_path / "demo"
    arguments = ("--size", 8, "--lights", 3, "--sh-order", 2, *FEW, "--quiet")
    assert run("demo", out, *arguments) == 0
    assert outcome(out / "result")["options"]["sh_order"] == 2
    for folder in (out / "result", out / "scene" / "truth"):
        assert not Lighting.load(folder / "lighting.json").coefficients[:, 9:].any()


# Usage


def test_version_as_a_module() -> None:
    command = [sys.executable, "-m", "pbrfit", "--version"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == f"pbrfit {version('pbrfit')}\n"
    assert done.stderr == ""


COMMANDS = (
    *("decompose", "relight", "report", "export", "inspect", "normals", "segments", "synth"),
    *("check-gradients", "evaluate", "demo"),
)


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_names_defaults_once(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(*command.split(), "--help") == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "(default: False)" not in text
    assert "(default: None)" not in text
    assert ("--iterations K at most so many (default: 500)" in text) == (
        command in ("decompose", "demo")
    )
    assert ("--threads T" in text) == (command in ("decompose", "demo", "relight"))
    for option in ("--robust {none,huber,cauchy}", "--exposures {auto,as-is,equal}"):
        assert (option in text) == (command in ("decompose", "demo", "check-gradients"))
    if not command:
        assert all(name in text for name in COMMANDS)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("", "pbrfit: the following arguments are required: COMMAND"),
        ("fit x", "invalid choice: 'fit'"),
        ("decompose", "the following arguments are required: SCENE, --out"),
        ("decompose s --out o --solver adam", "--solver: invalid choice: 'adam'"),
        ("decompose s --out o --iterations many", "--iterations: invalid int value: 'many'"),
        ("decompose s --out o --iter 3", "unrecognized arguments: --iter 3"),
        ("decompose s --out o --robust l1", "--robust: invalid choice: 'l1'"),
        ("decompose s --out o --exposures no", "--exposures: invalid choice: 'no'"),
        ("decompose s --out o --sh-order 1", "--sh-order: invalid choice: 1"),
        ("decompose s --out o --metallic 0.5", "--metallic: invalid choice: '0.5'"),
        ("decompose s --out o --code-range 250", "--code-range: expected LOW,HIGH, found 250"),
        ("decompose s --out o --code-range a,b", "--code-range: invalid code_range value: 'a,b'"),
        ("decompose s --out o --color-space log", "--color-space: invalid choice: 'log'"),
        ("synth s --scene moon", "--scene: invalid choice: 'moon'"),
        ("normals s --from guess", "--from: expected marigold, flat, depth:FILE or a file"),
    ],
)
def test_wrong_usage_is_one_line(
    arguments: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(*arguments.split()) == 2
    line = one_line(capsys)
    assert message in line
    assert line.endswith("--help\n")


# Input that cannot be used, through the command: test_scene_folder.py has all kinds of it.


def no_normals(folder: Path) -> None:
    (folder / "normals.exr").unlink()


def cut(folder: Path) -> None:
    path = folder / "images" / "light_01.exr"
    path.write_bytes(path.read_bytes()[:300])


def raw(folder: Path) -> None:
    (folder / "images" / "photo.CR2").write_bytes(b"II*\0\x10\0\0\0CR\x02\0")


def zero_normals(folder: Path) -> None:
    write_normals(folder, np.zeros((SIZE, SIZE, 3)))


def other_size(folder: Path) -> None:
    write_jpeg(folder / "images" / "x.jpg", np.ones((SIZE, SIZE + 1, 3)))


def black(folder: Path) -> None:
    for path in (folder / "images").iterdir():
        images.write_exr(path, {c: np.zeros((SIZE, SIZE)) for c in "RGB"})


def keep(folder: Path) -> None:
    assert folder.is_dir()


@pytest.mark.parametrize(
    ("spoil", "arguments", "message"),
    [
        (no_normals, (), "scene: expected normals.exr or normals.png .*--from flat"),
        (cut, (), "light_01.exr: expected .*, found"),
        (raw, (), "photo.CR2: expected .*darktable-cli"),
        (zero_normals, (), "normals.exr: normals: expected unit vectors, found 256"),
        (other_size, (), "x.jpg: expected the size of light_00.exr, 16 × 16 pixels, found 17 × 16"),
        (black, (), "images: expected a positive mean radiance"),
        (shutil.rmtree, (), "scene: expected a scene folder, found nothing"),
        (keep, ("--fov", 180), r"fov: expected degrees in \[0, 180\), found 180"),
        (keep, ("--fov", "nan"), "fov: expected degrees"),
        (keep, ("--max-size", 0), "max_size: expected at least 1 pixel"),
        (keep, ("--code-range", "9,3"), "code_range: expected two 8-bit codes"),
        (keep, ("--iterations", -1), "iterations: expected a whole number, 0 or more, found -1"),
        (keep, ("--time-limit", -1), "time_limit: expected seconds"),
        (keep, ("--threads", -1), "threads: expected 0"),
    ],
)
def test_unusable_input_is_one_line_and_leaves_nothing(
    folder: Path,
    spoil: Callable[[Path], None],
    arguments: tuple[Any, ...],
    message: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    spoil(folder)
    out = folder.parent / "new" / "out"
    assert run("decompose", folder, "--out", out, *arguments) == 2
    assert re.search(message, one_line(capsys))
    assert {path.name for path in folder.parent.iterdir()} <= {"scene"}


def test_places_that_cannot_be_written_show_before_the_work(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    places = [folder / "scene.toml" / "out", folder / "scene.toml"]
    if Path("/proc/self").is_dir():
        places.append(Path("/proc/out"))
    for out in places:
        assert run("decompose", folder, "--out", out, "--iterations", 10**9) == 2
        assert str(out) in one_line(capsys)


def test_inspect_of_a_preview_that_cannot_be_written(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("inspect", folder, "--preview", folder / "none" / "preview.png") == 2
    assert "preview.png" in capsys.readouterr().err


def test_an_error_of_the_library_is_a_value_error() -> None:
    assert issubclass(InputError, ValueError)
