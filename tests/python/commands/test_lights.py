"""`pbrfit lights`: lamps of a scene folder, from a ball or from a file."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from balls import COLOR, ball_pictures, far_lamps
from command_runs import done, refused
from pbrfit import Scene
from pbrfit.io.images import read_data
from pbrfit.model.geometry import angles_between
from pbrfit.scene.ball import Ball
from scene_files import known, write_exr

SIZE = (90, 120)
BALL = Ball(62.0, 41.0, 24.0)
LAMPS = far_lamps(3)
LP = "3\nlight_01 0.6 0 0.8\nlight_00 0 0.6 0.8\nlight_02 0 0 1\n"


def with_ball(folder: Path, kind: str = "matt") -> Path:
    """A folder of three pictures with a ball, and nothing else."""
    (folder / "images").mkdir(parents=True)
    made = ball_pictures("matt" if kind == "matt" else "mirror", BALL, SIZE, 60.0, LAMPS)
    for i, image in enumerate(made):
        write_exr(folder / "images" / f"light_{i:02d}.exr", image)
    (folder / "scene.toml").write_text("fov = 60\n")
    return folder


@pytest.mark.parametrize("kind", ["matt", "mirror"])
def test_a_ball_gives_lamps_that_the_scene_reads(tmp_path: Path, kind: str) -> None:
    scene, preview = with_ball(tmp_path / "scene", kind), tmp_path / "preview.png"
    said = done("lights", scene, "--preview", preview)
    lamps = known(Scene.load(scene).lamps)
    assert angles_between(lamps.places, LAMPS).max() < 3
    assert not lamps.colored
    lines = said.splitlines()
    assert re.match(
        rf"{scene}/lights.json: 3 far lamps, colours unknown, from a {kind} ball at 6[12]\.\d,4[01]"
        r"\.\d,2[34]\.\d \(X,Y,R, found; --circle sets it\)$",
        lines[0],
    )
    assert lines[1] == "  field of view 60 degrees, from scene.toml"
    rows = [line.split() for line in lines[3:6]]
    azimuth, elevation = np.array([[float(v.rstrip("°")) for v in row[1:3]] for row in rows]).T
    x, y, z = lamps.places.T
    np.testing.assert_allclose(azimuth, np.degrees(np.arctan2(x, z)), atol=0.06)
    np.testing.assert_allclose(elevation, np.degrees(np.arcsin(y)), atol=0.06)
    assert ("--albedo" in said) == (kind == "matt")
    assert "leave the ball out of the fit: in " in said
    assert re.search(r"mask.png make black a disc of radius 2\d around 62,41", said)
    assert said.endswith(f"look at them: {preview}\n")
    assert read_data(preview).shape[:2] == (744, 1440)


def test_a_given_circle_and_an_albedo_give_colours(tmp_path: Path) -> None:
    scene = with_ball(tmp_path / "scene")
    circle = f"{BALL.x},{BALL.y},{BALL.radius}"
    said = done("lights", scene, "--circle", circle, "--ball", "matt", "--albedo", "0.5")
    assert "3 far lamps, colours known, from a matt ball at 62.0,41.0,24.0 (X,Y,R, as given" in said
    lamps = known(Scene.load(scene).lamps)
    np.testing.assert_allclose(lamps.colors, np.tile(COLOR, (3, 1)), rtol=0.05)
    twice = ("--circle", circle, "--circle", circle)
    assert done("lights", scene, *twice, "--overwrite", "--quiet") == ""


def test_a_file_is_converted(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "dome.lp").write_text(LP)
    preview = tmp_path / "preview.png"
    said = done("lights", folder, "--from", tmp_path / "dome.lp", "--preview", preview)
    assert said.splitlines() == [
        f"{folder}/lights.json: known, 3 far lamps, colours unknown, from dome.lp",
        "  picture    azimuth  elevation",
        "  light_00      0.0°      36.9°",
        "  light_01     36.9°       0.0°",
        "  light_02      0.0°       0.0°",
        f"look at them: {preview}",
    ]
    lamps = known(Scene.load(folder).lamps)
    np.testing.assert_allclose(lamps.places, [(0, 0.6, 0.8), (0.6, 0, 0.8), (0, 0, 1)])
    with Image.open(preview) as picture:
        assert picture.size == (744, 744)


def test_near_lamps_of_a_file(folder: Path, tmp_path: Path) -> None:
    rows = "".join(f"light_0{i},{i},2,-1,1,1,1,near\n" for i in range(3))
    (tmp_path / "rig.csv").write_text(rows)
    said = done("lights", folder, "--from", tmp_path / "rig.csv")
    assert "3 near lamps, colours known, from rig.csv" in said
    assert "  light_02  near, at 2, 2, -1" in said
    assert "azimuth" not in said


def test_existing_lamps_are_kept(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "dome.lp").write_text(LP)
    convert = ("lights", folder, "--from", tmp_path / "dome.lp")
    done(*convert)
    before = (folder / "lights.json").read_bytes()
    assert "lights.json: expected no lamps yet, found some; --overwrite" in refused(*convert)
    done(*convert, "--overwrite", "--quiet")
    assert (folder / "lights.json").read_bytes() == before
    (folder / "lights.json").rename(tmp_path / "away.json")
    (folder / "own.lp").write_text(LP)
    said = refused(*convert, "--overwrite")
    assert "own.lp: expected no lamps yet, found some; it is read as it is" in said
    assert not (folder / "lights.json").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--from", "ballpark"), "--from: expected ball or a file, found 'ballpark'"),
        (("--circle", "1,2"), "--circle: expected X,Y,R, finite numbers, found '1,2'"),
        (("--circle", "1,2,nan"), "--circle: expected X,Y,R, finite numbers"),
        (("--circle", "8,8,2"), "scene: circle: expected a radius of 4 pixels or more, found 2"),
        (("--ball", "glass"), "--ball: invalid choice: 'glass'"),
        (("--albedo", "1.5"), "albedo: expected a number above 0, 1 at most, found 1.5"),
        ((), "scene: ball: expected a circle with an outline all around"),
    ],
)
def test_what_cannot_be_done_is_refused_in_one_line(
    folder: Path, arguments: tuple[str, ...], message: str
) -> None:
    assert message in refused("lights", folder, *arguments)
    assert not (folder / "lights.json").exists()


def test_options_without_meaning_and_files_of_other_pictures_are_refused(
    folder: Path, tmp_path: Path
) -> None:
    (tmp_path / "dome.lp").write_text(LP)
    convert = ("lights", folder, "--from", tmp_path / "dome.lp")
    assert "--albedo: has no meaning with --from" in refused(*convert, "--albedo", "0.5")
    mirror = with_ball(tmp_path / "mirror", "mirror")
    said = refused("lights", mirror, "--albedo", "0.5")
    assert "--albedo: has no meaning with a mirror ball" in said
    (tmp_path / "dome.lp").write_text("1\nx 0 0 1\n")
    expected = "dome.lp: expected a lamp for each of the 3 pictures, found 1"
    assert expected in refused(*convert)
