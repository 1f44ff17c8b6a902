"""`pbrfit generate`: what it writes, says and refuses, with pictures that are there already."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from acquire_run import pixels, write_photo, write_pictures
from command_runs import Ran, done, ran
from pbrfit import Result
from pbrfit.acquire.prompts import read_prompts
from scene_files import Argument, run

FREE = ("--normals", "flat", "--segments", "none", "--no-review")


@pytest.fixture
def made(tmp_path: Path) -> Path:
    """A folder with `photo.png` and four pictures of the same room in `variants`."""
    write_photo(tmp_path / "photo.png")
    write_pictures(tmp_path / "variants")
    return tmp_path


def command(made: Path, *options: Argument) -> tuple[Argument, ...]:
    """Make `scene` of the pictures."""
    source = ("--generator", f"folder:{made / 'variants'}")
    return ("generate", made / "photo.png", "--out", made / "scene", *source, *FREE, *options)


def complaint(*arguments: Argument) -> str:
    """The last line of a refusal."""
    found = ran(*arguments)
    assert found.code == 2
    return found.err.splitlines()[-1]


@pytest.mark.slow
def test_the_scene_that_it_makes_can_be_decomposed_as_it_says(made: Path) -> None:
    said = {line[:12].strip(): line[12:] for line in done(*command(made, "--fov", 60)).splitlines()}
    assert said["pictures"] == "4 of 4 generated and the photograph"
    assert "cost" not in said
    assert "left out" not in said
    for path in (made / "variants").iterdir():
        np.testing.assert_array_equal(pixels(path), pixels(made / "scene" / "images" / path.name))
    with Image.open(said["review"]) as sheet:
        assert sheet.format == "PNG"
    following = shlex.split(said["next"])
    assert following[:2] == ["pbrfit", "decompose"]
    assert "material=1" in following
    assert run(*following[1:], "--iterations", "20", "--quiet") == 0
    assert Result.load(following[-1]).metrics["recon_rmse"] < 0.2


def test_a_picture_of_something_else_is_left_out_and_said_to_be(tmp_path: Path) -> None:
    write_photo(tmp_path / "photo.png", 160, count=5)
    first, *_ = write_pictures(tmp_path / "variants", 5, 160)
    path = tmp_path / "variants" / f"{first}.png"
    Image.fromarray(pixels(path)[:, ::-1]).save(path)
    source = ("--generator", f"folder:{tmp_path / 'variants'}")
    flat = ("--normals", "flat", "--segments", "none")
    said = done("generate", tmp_path / "photo.png", "--out", tmp_path / "s", *source, *flat)
    assert f"left out    {first}: " in said
    assert not (tmp_path / "s" / "images" / f"{first}.png").exists()
    review = json.loads((tmp_path / "s" / "review.json").read_text(encoding="utf-8"))
    assert review["reviewed"]
    [refused] = [each for each in review["pictures"] if each["name"] == first]
    assert not all(check["passed"] for check in refused["attempts"][0]["checks"])


def test_count_takes_the_first_and_resume_adds_the_rest_and_what_was_changed(made: Path) -> None:
    placed = made / "scene" / "images"
    done(*command(made, "--count", 2))
    assert len(list(placed.iterdir())) == 3
    [path, *_] = sorted((made / "variants").iterdir())
    flipped = pixels(path)[::-1]
    Image.fromarray(flipped).save(path)
    done(*command(made, "--resume"))
    assert len(list(placed.iterdir())) == 5
    np.testing.assert_array_equal(pixels(placed / path.name), flipped)
    said = complaint(*command(made))
    assert "--resume goes on" in said
    assert "--overwrite makes it anew" in said
    assert ran(*command(made, "--overwrite", "--quiet")) == Ran(0, "", "")


def test_json_is_the_review_and_nothing_else(made: Path) -> None:
    tilted = np.full((64, 64, 3), (128, 218, 218), dtype=np.uint8)
    Image.fromarray(tilted).save(made / "mine.png")
    found = ran(*command(made, "--json", "--normals", made / "mine.png", "--depth", "none"))
    written = json.loads((made / "scene" / "review.json").read_text(encoding="utf-8"))
    assert json.loads(found.out) == written
    assert written["generator"]["generator"] == "folder"
    assert written["normals"]["file"] == "mine.png"
    assert "field of view unknown, assumed 60 degrees" in found.err
    assert "60" in (made / "scene" / "scene.toml").read_text()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--quality", "low"), "--quality: goes with --generator gpt-image-2, found folder"),
        (("--guidance", "3"), "--guidance: goes with --generator flux2-klein, found folder"),
        (("--seed", "0"), "--seed: goes with --generator flux2-klein or gpt-image-2"),
        (("--negative", "dogs"), "--negative: goes with"),
        (("--negative", ""), "--negative: goes with"),
        (("--model", "x"), "--model: goes with"),
        (("--device", "cpu"), "--device: goes with depth-anything, flux2-klein, marigold, sam2"),
        (("--regenerate", "1"), "--regenerate: goes with"),
        (("--max-size", "60"), "max_size: expected at least 64"),
        (("--normals", "flatt"), "--normals: expected marigold, flat, depth:FILE or a file"),
        (("--generator", "flux"), "expected one of flux2-klein, gpt-image-2, folder:DIR, found"),
        (
            ("--generator", "gpt-image-2", "--steps", "4"),
            "--steps: goes with --generator flux2-klein, found gpt-image-2",
        ),
        (
            ("--generator", "gpt-image-2", "--regenerate", "1"),
            "--regenerate: goes with the review, found --no-review",
        ),
    ],
)
def test_options_that_would_do_nothing_or_cannot_be_are_refused_before_anything_is_made(
    options: tuple[str, ...], said: str, made: Path
) -> None:
    assert said in complaint(*command(made, *options))
    assert not (made / "scene").exists()


def test_depth_of_an_orthographic_camera_is_led_to_the_command_that_takes_it(made: Path) -> None:
    np.save(made / "depth.npy", np.full((64, 64), 3.0))
    depth = f"depth:{made / 'depth.npy'}"
    said = complaint(*command(made, "--normals", depth, "--fov", 0))
    assert f"pbrfit normals SCENE --from {depth} --view-width" in said
    assert not (made / "scene").exists()


@pytest.mark.parametrize(
    ("arguments", "missing"),
    [(("generate",), "PHOTO"), (("generate", "photo.png"), "--out SCENE")],
)
def test_what_must_be_given_is_named(arguments: tuple[str, ...], missing: str) -> None:
    assert f"generate: expected {missing}, found none" in complaint(*arguments)


def test_prompts_are_listed_and_saved_as_a_catalogue_to_edit(tmp_path: Path) -> None:
    mine = tmp_path / "mine.toml"
    done("generate", "--save-prompts", mine)
    assert read_prompts(mine) == read_prompts()
    listed = done("generate", "--list-prompts", "--prompts", mine)
    assert all(prompt.text in listed for prompt in read_prompts().lighting)
    mine.write_text("")
    assert "--overwrite" in complaint("generate", "--save-prompts", mine)
    done("generate", "--save-prompts", mine, "--overwrite")
    assert read_prompts(mine) == read_prompts()
