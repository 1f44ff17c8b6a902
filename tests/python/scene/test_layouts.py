"""Layouts of a scene, files that are named, and how pictures are read by options and frames."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from command_runs import done, refused
from pbrfit import InputError, Result, Scene, write_report
from pbrfit.batch.scenes import scenes_in
from pbrfit.io import images
from pbrfit.scene import folder as scene_folder
from pbrfit.scene.options import ReadOptions
from pbrfit.scene.reading import PERSPECTIVE_OFF, read_pictures
from scene_files import LIGHTS, SIZE, known, room, write_exr, write_folder, write_integers

NAMES = [f"{i + 1:03d}" for i in range(LIGHTS)]


def photographs(folder: Path, names: list[str] = NAMES) -> Path:
    """Pictures of the room that lie beside each other."""
    folder.mkdir(parents=True)
    for name, image in zip(names, room().images, strict=True):
        write_integers(folder / f"{name}.png", image)
    return folder


def as_diligent(folder: Path) -> Path:
    """The pictures in another order than that of their names, and a file that is not listed."""
    photographs(folder, ["9", "10", "x"])
    write_integers(folder / "other.png", np.zeros((4, 4, 3)))
    (folder / "filenames.txt").write_text("10.png\nx.png\n9.png\n")
    np.savetxt(folder / "light_directions.txt", np.eye(3))
    return folder


def test_photographs_beside_each_other_are_a_scene(tmp_path: Path) -> None:
    folder = photographs(tmp_path / "photos")
    for name in ("mask", "dark", "segments", "normals_gt", "preview"):
        images.write_png(folder / f"{name}.png", np.full((SIZE, SIZE), 3, np.uint8), tag=None)
    (folder / "segments.png").replace(folder / "Mask.png")  # a part, which warnings tell of
    scene = Scene.load(folder)
    assert scene.names == tuple(NAMES)
    assert scene.assumed["layout"] == "pictures: those of the folder itself, 001.png to 003.png (3)"
    assert "dark frame" in scene.assumed
    assert scene_folder.digests(folder) == scene.inputs
    assert "\nassumed layout    pictures: those" in done("inspect", folder)
    (folder / "Mask.png").replace(folder / "Mask_0001.png")  # as renderers number them
    assert Scene.load(folder).names == tuple(NAMES)
    (folder / "Mask_0001.png").unlink()
    for command in (("lights",), ("normals", "--from", "pictures")):
        assert "an EXR file with layer x" in refused(*command, folder, "--layer", "x")
    (folder / "005.heic").write_bytes(b"\0\0\0\x18ftypheic" + bytes(20))
    with pytest.raises(InputError, match=r"005.heic: expected EXR, .* found HEIC"):
        Scene.load(folder)


def test_only_listed_pictures_count_and_lamps_have_their_order(tmp_path: Path) -> None:
    scene = Scene.load(as_diligent(tmp_path / "bear"))
    assert scene.names == ("10", "x", "9")
    assert "the 3 that filenames.txt lists; 1 more left out; linear" in scene.assumed["layout"]
    np.testing.assert_array_equal(known(scene.lamps).places, np.eye(3))
    assert (scene.assumed["color"], scene.response) == ("linear (as asked for)", None)
    (tmp_path / "bear" / "filenames.txt").write_text("10.png\n../bear/x.png\n")
    with pytest.raises(InputError, match=r"filenames.txt: expected names of pictures beside it"):
        Scene.load(tmp_path / "bear")


def test_a_folder_of_scenes_is_a_batch_and_one_of_photographs_a_scene(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    photos, bear = photographs(tmp_path / "photos"), as_diligent(tmp_path / "bear")
    shutil.copytree(photos, photos / "flat")
    assert scenes_in(photos) == [photos]
    assert scenes_in(tmp_path) == [bear, photos]
    assert not caplog.records
    write_integers(tmp_path / "sheet.png", room().images[0])
    assert scenes_in(tmp_path) == [bear, photos]
    assert "sheet.png not read, as folders in it are scenes" in caplog.text
    (photos / "result.json").write_text("{}")
    assert scenes_in(photos) == []


def test_files_of_one_folder_have_its_parts_and_others_none(folder: Path, tmp_path: Path) -> None:
    pictures = sorted((folder / "images").iterdir())
    scene = Scene.load(pictures[:2])
    assert scene.normals_known
    assert (scene.names, scene.fov) == (room().names[:2], 60)
    assert set(scene.inputs) == {f"images/{path.name}" for path in pictures[:2]} | {
        "normals.exr",
        "scene.toml",
    }
    assert scene_folder.digests(pictures[:2]) == scene.inputs
    photos = photographs(tmp_path / "photos")
    several = Scene.load([*pictures[:2], photos / "003.png"])
    assert not several.normals_known
    assert several.assumed["layout"].endswith(
        "3 files of 2 folders, without other parts of a scene"
    )
    assert several.names == (*room().names[:2], "003")
    message = f"{folder}: expected a picture, found a folder"
    assert message in refused("decompose", pictures[0], folder, "--out", tmp_path / "out")
    with pytest.raises(InputError, match=r"scene: expected a folder or pictures, found none"):
        Scene.load([])
    with pytest.raises(FileNotFoundError, match=r"no.png: expected a picture, found no file"):
        Scene.load([pictures[0], tmp_path / "no.png"])


def test_a_result_reads_the_named_pictures_again_as_they_were_read(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "scene", fov="fov = 20\nlayer = 'x'")
    for path in (folder / "images").iterdir():
        channels = images.read_channels(path)
        images.write_exr(path, {f"x.{name}": channel for name, channel in channels.items()})
    pictures = sorted((folder / "images").iterdir())[:2]
    out = tmp_path / "out"
    few = ("--iterations", 1, "--quiet", "--crop", "2,4,12,8")
    done("decompose", *pictures, "--out", out, *few)
    result = Result.load(out)
    assert known(result.source).files == ("images/light_00.exr", "images/light_01.exr")
    assert known(result.source).options == ReadOptions(crop=(2, 4, 12, 8))
    assert result.mask.shape == (8, 12)
    page = tmp_path / "page.html"
    write_report(result, page)
    assert "is gone, has changed" not in page.read_text("utf-8")
    assert "changed since" not in page.read_text("utf-8")
    assert '"kept"' in done("decompose", *pictures, "--out", out, *few, "--resume", "--json")


def test_a_crop_is_of_pictures_and_all_maps(folder: Path) -> None:
    window = np.s_[2:10, 4:16]
    weights = 1 + np.arange(SIZE * SIZE, dtype=np.float32).reshape(SIZE, SIZE)
    images.write_exr(folder / "weights.exr", {"Y": weights})
    images.write_exr(folder / "depth.exr", {"Z": weights})
    mask = np.full((SIZE, SIZE), 255, np.uint8)
    mask[3, 5] = mask[0] = 0
    images.write_png(folder / "mask.png", mask, tag=None)
    write_exr(folder / "dark.exr", np.broadcast_to(weights[..., None] / 1e6, (SIZE, SIZE, 3)))
    whole, part = Scene.load(folder), Scene.load(folder, crop=(4, 2, 12, 8))
    np.testing.assert_array_equal(part.images, whole.images[:, *window])
    np.testing.assert_array_equal(part.normals, whole.normals[window])
    for name in ("valid", "depth"):
        np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[window])
    np.testing.assert_array_equal(known(part.weights), known(whole.weights)[:, *window])
    assert Scene.load(folder, crop=(4, 2, 12, 8), max_size=6).images.shape[1:3] == (4, 6)
    alone = read_pictures(folder, ReadOptions(crop=(4, 2, 12, 8)))[0]
    assert alone.pixels.shape[1:3] == (SIZE, SIZE)
    with pytest.raises(InputError, match=r"crop: expected X,Y,W,H within 16 × 16 .* 4,2,13,8"):
        Scene.load(folder, crop=(4, 2, 13, 8))
    for bad in ((0, 0, 0, 4), (-1, 0, 4, 4), (0, 0, 4), "4"):
        with pytest.raises(InputError, match="crop: expected X,Y,W,H, whole pixels"):
            Scene.load(folder, crop=bad)


@pytest.mark.parametrize("left", [0, 4, 5])
def test_a_crop_has_its_share_of_the_field_of_view(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, left: int
) -> None:
    """Of 8 columns of 16; where its middle is off the axis, directions are as much off."""
    folder = write_folder(tmp_path / "scene", fov=None)
    slope = 16 * np.tan(np.radians(PERSPECTIVE_OFF)) / 2 * 1.001  # of half the width, at 5
    fov = float(2 * np.degrees(np.arctan(slope)))
    scene = Scene.load(folder, fov=fov, crop=(left, 4, 8, 8))
    assert np.tan(np.radians(scene.fov / 2)) == pytest.approx(slope / 2)
    np.testing.assert_allclose(
        Scene.load(folder, fov=fov, crop=(4, 4, 8, 8)).views,
        Scene.load(folder, fov=fov).views[4:12, 4:12],
    )
    off = {0: "4.0", 4: None, 5: "1.0"}[left]
    assert (f"{off} degrees off the optical axis" in caplog.text) == (off is not None)
    closer = Scene.load(folder, fov=0.99 * fov, crop=(5, 4, 8, 8))
    assert "off the optical axis" not in closer.assumed["fov"]


def test_alpha_is_a_mask_or_ignored(folder: Path) -> None:
    for path in (folder / "images").iterdir():
        channels = images.read_channels(path)
        images.write_exr(path, channels | {"A": np.tile([0.4, 1.0], (SIZE, SIZE // 2))})
    for alpha, share in ((None, 0.5), ("mask", 0.5), ("ignore", 1.0)):
        scene = Scene.load(folder, alpha=alpha)
        assert scene.valid.mean() == share
        assert ("ignored" in scene.assumed["alpha"]) == (alpha == "ignore")
    (folder / "scene.toml").write_text('alpha = "ignore"\ncrop = [0, 0, 8, 8]\n')
    assert Scene.load(folder).valid.shape == (8, 8)
    assert Scene.load(folder).all_valid


def test_equal_pictures_are_named_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = write_folder(tmp_path / "scene", "8-bit PNG")
    shutil.copy(folder / "images" / "light_01.png", folder / "images" / "a copy.png")
    (folder / "lights.csv").write_text(
        "name,x,y,z\n" + "".join(f"{n},0,{i},1\n" for i, n in enumerate([*room().names, "a copy"]))
    )
    scene = Scene.load(folder)
    assert scene.names == ("a copy", "light_00", "light_02")
    assert scene.assumed["duplicates"] == "equal pictures count once: a copy.png, light_01.png"
    assert scene.assumed["duplicates"] in caplog.text
    np.testing.assert_allclose(
        known(scene.lamps).places[:, 1], np.array([3, 0, 2]) / np.hypot(1, [3, 0, 2])
    )
    assert scene_folder.digests(folder) == scene.inputs


def uneven(name: str) -> Any:
    """What a frame of a white surface shows, (H, W, 3): each lamp falls off in another way."""
    across = np.linspace(0.4, 1, SIZE)[:: -1 if name.endswith("1") else 1]
    return np.broadcast_to(across[:, None], (SIZE, SIZE, 3)).astype(np.float32) * [1, 0.9, 0.8]


@pytest.mark.parametrize("each", [False, True])
def test_pictures_are_divided_by_a_flat_field_frame(tmp_path: Path, each: bool) -> None:
    """By one for all, or by one each; less the dark frame, which is in both."""
    folder, dark = write_folder(tmp_path / "scene"), np.float32(0.01)
    names = room().names if each else ("flat",) * LIGHTS
    if each:
        (folder / "flat").mkdir()
    for name, picture, image in zip(names, room().names, room().images, strict=True):
        gain = uneven(name) / uneven(name).mean(axis=(0, 1))
        write_exr(folder / "images" / f"{picture}.exr", (image * gain + dark).astype(np.float32))
        flat = uneven(name) + dark
        flat[3, 4] = 0
        write_exr(folder / ("flat" if each else ".") / f"{name}.exr", flat.astype(np.float32))
    write_exr(folder / "dark.exr", np.full((SIZE, SIZE, 3), dark, np.float32))
    scene = Scene.load(folder)
    used = np.ones((SIZE, SIZE), bool)
    used[3, 4] = False
    np.testing.assert_array_equal(scene.valid, used)
    ratio = (scene.images / room().images)[:, used]  # a factor a channel, as a pixel is left out
    np.testing.assert_allclose(ratio, np.broadcast_to(ratio[:, :1], ratio.shape), rtol=1e-4)
    for i, name in enumerate(names):
        share = known(scene.weights)[i][used] / uneven(name)[used]
        np.testing.assert_allclose(share, np.broadcast_to(share[0], share.shape), rtol=1e-4)
    assert "left out that are clipped or black" in scene.assumed["flat field"]
    assert (scene.response, scene_folder.digests(folder)) == (None, scene.inputs)
    np.testing.assert_array_equal(read_pictures(folder)[0].pixels, scene.images)
    assert Scene.load(folder, max_size=SIZE // 2).weights is not None


SPOILED: dict[str, tuple[Callable[[Path], Any], str]] = {
    "none for a picture": (
        lambda f: (f / "flat" / "light_01.exr").unlink(),
        "flat: expected a flat-field frame for every picture, found none for light_01",
    ),
    "one more": (lambda f: write_exr(f / "flat.exr", uneven("")), "flat.exr or flat/, found both"),
    "black": (
        lambda f: write_exr(f / "flat" / "light_01.exr", 0 * uneven("")),
        "light_01.exr: expected an even surface, brighter than black",
    ),
    "of another size": (
        lambda f: write_exr(f / "flat" / "light_01.exr", uneven("")[1:]),
        "light_01.exr: expected the pictures' size",
    ),
}


@pytest.mark.parametrize("how", SPOILED)
def test_what_is_no_flat_field_frame_is_refused(folder: Path, how: str) -> None:
    (folder / "flat").mkdir()
    for name in (*room().names, "spare"):
        write_exr(folder / "flat" / f"{name}.exr", uneven(name))
    assert "of no picture: spare.exr" in Scene.load(folder).assumed["flat field"]
    spoil, message = SPOILED[how]
    spoil(folder)
    with pytest.raises(InputError, match=message):
        Scene.load(folder)
