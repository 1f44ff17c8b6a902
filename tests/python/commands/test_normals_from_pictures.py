"""`pbrfit normals --from pictures`: normals and a height that lamps tell."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from command_runs import done, refused
from lamp_scenes import around, ball
from pbrfit import Scene
from pbrfit.io.images import read_channels
from pbrfit.model.geometry import angles_between
from scene_files import known, write_exr, write_integers

SCENE = ball(around(8, 40, 12), size=40)


def pictures(folder: Path, count: int = 8) -> Path:
    """A folder of pictures of a ball, and its mask."""
    (folder / "images").mkdir(parents=True)
    for i, image in enumerate(SCENE.samples[:count]):
        write_exr(folder / "images" / f"light_{i:02d}.exr", image.astype(np.float32))
    write_integers(folder / "mask.png", SCENE.mask.astype(float))
    (folder / "scene.toml").write_text('fov = 0\nnormals = "directx"\n')
    return folder


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A folder that has got normals, and what was said."""
    folder = pictures(tmp_path_factory.mktemp("told") / "scene")
    return folder, done("normals", folder, "--from", "pictures")


@pytest.mark.slow
def test_pictures_tell_normals_that_the_scene_reads(told: tuple[Path, str]) -> None:
    folder, said = told
    scene = Scene.load(folder)
    assert scene.normals_known
    off = angles_between(scene.normals, SCENE.normals)[scene.valid]
    assert off.mean() < 4
    sigma = known(scene.normal_sigma)[scene.valid]
    assert ((sigma > 0) & (sigma <= 90)).all()
    height = read_channels(folder / "height.exr")
    assert (height["mask.Y"] == scene.valid).all()
    assert height["Y"][20, 20] > height["Y"][20, 5]
    assert sorted(path.name for path in folder.iterdir()) == [
        *("height.exr", "images", "mask.png", "normals.exr", "scene.toml")
    ]
    lines = said.splitlines()
    assert lines[0] == f"{folder}/normals.exr: from 8 pictures under lamps"
    assert re.fullmatch(
        r"  turned away from the optical axis by \d+ degrees \(median\), \d+ \(95 %\)", lines[1]
    )
    assert re.fullmatch(r"  uncertain by [\d.]+ degrees \(median\), [\d.]+ \(95 %\)", lines[2])
    assert lines[3] == "  8 far lamps, colours known"
    assert re.fullmatch(rf"{folder}/height.exr: from -[\d.]+ to [\d.]+ pixels", lines[-2])


@pytest.mark.slow
def test_normals_that_are_there_are_replaced_unread(told: tuple[Path, str], tmp_path: Path) -> None:
    before = Scene.load(told[0])
    folder = tmp_path / "scene"
    shutil.copytree(told[0], folder)
    (folder / "normals.exr").write_bytes(b"no picture")
    assert "normals.exr: expected no normals yet, found some" in refused(
        "normals", folder, "--from", "pictures"
    )
    assert done("normals", folder, "--from", "pictures", "--overwrite", "--quiet") == ""
    np.testing.assert_array_equal(Scene.load(folder).normals, before.normals)
    (folder / "normals.exr").unlink()
    assert "height.exr: expected no height yet, found some" in refused(
        "normals", folder, "--from", "pictures"
    )


def test_what_cannot_be_told_is_refused_and_nothing_is_written(tmp_path: Path) -> None:
    folder = pictures(tmp_path / "scene", 2)
    assert refused("normals", folder, "--from", "pictures") == (
        f"pbrfit: {folder}: expected 3 or more pictures under different lamps, found 2\n"
    )
    assert "--convention: has no meaning with --from pictures" in refused(
        "normals", folder, "--from", "pictures", "--convention", "directx"
    )
    assert "--threads: has no meaning with --from flat" in refused(
        "normals", folder, "--from", "flat", "--threads", "1"
    )
    assert not (folder / "normals.exr").exists()
    assert not (folder / "height.exr").exists()
