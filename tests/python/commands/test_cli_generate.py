"""`pbrfit generate`: what it writes, says and refuses, with pictures that are there already."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from acquire_run import write_photo, write_pictures
from pbrfit import Result
from pbrfit.acquire.prompts import read_prompts
from scene_files import run

FREE = ("--normals", "flat", "--segments", "none", "--no-review")


@pytest.fixture
def made(tmp_path: Path) -> Path:
    """A folder with `photo.png` and four pictures of the same room in `variants`."""
    write_photo(tmp_path / "photo.png")
    write_pictures(tmp_path / "variants")
    return tmp_path


def generate(made: Path, *options: str | Path, out: str = "scene") -> int:
    return run(
        *("generate", made / "photo.png", "--out", made / out),
        *("--generator", f"folder:{made / 'variants'}", *FREE, *options),
    )


def error_of(capsys: pytest.CaptureFixture[str]) -> str:
    """The last line on stderr."""
    return capsys.readouterr().err.splitlines()[-1]


def test_the_scene_that_it_makes_can_be_decomposed_as_it_says(
    made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert generate(made, "--fov", "60") == 0
    said = {line[:12].strip(): line[12:] for line in capsys.readouterr().out.splitlines()}
    assert said["pictures"] == "4 of 4 generated and the photograph"
    assert "cost" not in said
    assert "left out" not in said
    with Image.open(said["review"]) as sheet:
        assert sheet.format == "PNG"
    command = shlex.split(said["next"])
    assert command[:2] == ["pbrfit", "decompose"]
    assert run(*command[1:], "--iterations", "20", "--quiet") == 0
    assert Result.load(command[-1]).metrics["recon_rmse"] < 0.2


def test_a_picture_of_something_else_is_left_out_and_said_to_be(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_photo(tmp_path / "photo.png", 160, count=5)
    first, *_ = write_pictures(tmp_path / "variants", 5, 160)
    path = tmp_path / "variants" / f"{first}.png"
    with Image.open(path) as picture:
        mirrored = np.asarray(picture)[:, ::-1]
    Image.fromarray(mirrored).save(path)
    source = ("--generator", f"folder:{tmp_path / 'variants'}")
    flat = ("--normals", "flat", "--segments", "none")
    assert run("generate", tmp_path / "photo.png", "--out", tmp_path / "s", *source, *flat) == 0
    said = capsys.readouterr().out
    assert f"left out    {first}: " in said
    assert not (tmp_path / "s" / "images" / f"{first}.png").exists()
    review = json.loads((tmp_path / "s" / "review.json").read_text(encoding="utf-8"))
    assert review["reviewed"]
    [refused] = [each for each in review["pictures"] if each["name"] == first]
    assert not all(check["passed"] for check in refused["attempts"][0]["checks"])


def test_pictures_of_a_folder_are_in_the_scene_as_they_are(made: Path) -> None:
    assert generate(made) == 0
    for path in (made / "variants").iterdir():
        with Image.open(path) as given, Image.open(made / "scene" / "images" / path.name) as placed:
            np.testing.assert_array_equal(np.asarray(given), np.asarray(placed))


def test_count_takes_the_first_of_a_folder_and_resume_adds_the_rest(made: Path) -> None:
    assert generate(made, "--count", "2") == 0
    assert len(list((made / "scene" / "images").iterdir())) == 3
    assert generate(made, "--resume") == 0
    assert len(list((made / "scene" / "images").iterdir())) == 5


def test_a_file_that_was_changed_is_taken_anew(made: Path) -> None:
    assert generate(made) == 0
    [path, *_] = sorted((made / "variants").iterdir())
    with Image.open(path) as picture:
        flipped = np.asarray(picture)[::-1]
    Image.fromarray(flipped).save(path)
    assert generate(made, "--resume") == 0
    with Image.open(made / "scene" / "images" / path.name) as placed:
        np.testing.assert_array_equal(np.asarray(placed), flipped)


def test_an_existing_scene_is_refused_with_what_to_do(
    made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert generate(made) == 0
    assert generate(made) == 2
    said = error_of(capsys)
    assert "--resume goes on" in said
    assert "--overwrite makes it anew" in said
    assert generate(made, "--overwrite") == 0


def test_json_is_the_review_and_nothing_else(
    made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert generate(made, "--json") == 0
    written = json.loads((made / "scene" / "review.json").read_text(encoding="utf-8"))
    assert json.loads(capsys.readouterr().out) == written
    assert written["generator"]["generator"] == "folder"


def test_quiet_says_nothing(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert generate(made, "--quiet") == 0
    assert capsys.readouterr() == ("", "")


def test_an_unknown_field_of_view_is_told(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert generate(made) == 0
    assert "field of view unknown, assumed 60 degrees" in capsys.readouterr().err
    assert "60" in (made / "scene" / "scene.toml").read_text()


def test_a_file_of_normals_is_placed_in_the_scene(made: Path) -> None:
    tilted = np.zeros((64, 64, 3), dtype=np.uint8)
    tilted[...] = (128, 218, 218)
    Image.fromarray(tilted).save(made / "mine.png")
    assert generate(made, "--normals", made / "mine.png") == 0
    said = json.loads((made / "scene" / "review.json").read_text())["normals"]
    assert said["file"] == "mine.png"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--quality", "low"), "--quality: goes with --generator gpt-image-2, found folder"),
        (("--guidance", "3"), "--guidance: goes with --generator flux2-klein, found folder"),
        (("--seed", "0"), "--seed: goes with --generator flux2-klein or gpt-image-2"),
        (("--negative", "dogs"), "--negative: goes with"),
        (("--no-negative",), "--negative: goes with"),
        (("--model", "x"), "--model: goes with"),
        (("--device", "cpu"), "--device: goes with flux2-klein, marigold or sam2"),
        (("--regenerate", "1"), "--regenerate: goes with"),
        (("--max-size", "60"), "max_size: expected at least 64"),
        (("--normals", "flatt"), "--normals: expected marigold, flat, depth:FILE or a file"),
    ],
)
def test_options_that_would_do_nothing_or_cannot_be_are_refused_before_anything_is_made(
    options: tuple[str, ...], said: str, made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert generate(made, *options) == 2
    assert said in error_of(capsys)
    assert not (made / "scene").exists()


def test_depth_of_an_orthographic_camera_is_led_to_the_command_that_takes_it(
    made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.save(made / "depth.npy", np.full((64, 64), 3.0))
    depth = f"depth:{made / 'depth.npy'}"
    assert generate(made, "--normals", depth, "--fov", "0") == 2
    assert f"pbrfit normals SCENE --from {depth} --view-width" in error_of(capsys)
    assert not (made / "scene").exists()


def test_options_of_one_service_are_refused_for_another(
    made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asking = ("generate", made / "photo.png", "--out", made / "scene", *FREE)
    assert run(*asking, "--generator", "gpt-image-2", "--steps", "4") == 2
    assert "--steps: goes with --generator flux2-klein, found gpt-image-2" in error_of(capsys)
    assert run(*asking, "--regenerate", "1") == 2
    assert "--regenerate: goes with the review, found --no-review" in error_of(capsys)


@pytest.mark.parametrize("name", ["flux", "folder", "folder:", "gpt-image-2:x"])
def test_a_generator_that_is_none_is_refused(
    name: str, made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = run("generate", made / "photo.png", "--out", made / "x", "--generator", name, *FREE)
    assert code == 2
    expected = "generator: expected one of flux2-klein, gpt-image-2, folder:DIR, found"
    assert expected in error_of(capsys)


@pytest.mark.parametrize(
    ("arguments", "missing"),
    [(("generate",), "PHOTO"), (("generate", "photo.png"), "--out SCENE")],
)
def test_what_must_be_given_is_named(
    arguments: tuple[str, ...], missing: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(*arguments) == 2
    assert f"generate: expected {missing}, found none" in error_of(capsys)


def test_prompts_are_listed_and_saved_as_a_catalogue_to_edit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("generate", "--save-prompts", tmp_path / "mine.toml") == 0
    assert read_prompts(tmp_path / "mine.toml") == read_prompts()
    capsys.readouterr()
    assert run("generate", "--list-prompts", "--prompts", tmp_path / "mine.toml") == 0
    listed = capsys.readouterr().out
    assert all(prompt.text in listed for prompt in read_prompts().lighting)
    (tmp_path / "mine.toml").write_text("")
    assert run("generate", "--save-prompts", tmp_path / "mine.toml") == 2
    assert "--overwrite" in capsys.readouterr().err
    assert run("generate", "--save-prompts", tmp_path / "mine.toml", "--overwrite") == 0
    assert read_prompts(tmp_path / "mine.toml") == read_prompts()


def test_help_has_a_group_for_each_part(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("generate", "--help") == 0
    said = capsys.readouterr().out
    for group in ("the photograph", "pictures under", "prompts", "review", "normals and segments"):
        assert f"\n{group}" in said
