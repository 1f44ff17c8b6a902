"""Users' files are regular files of bounded size; whatever else is there is refused at once."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import pytest

from command_runs import refused
from pbrfit import InputError, Scene, _core
from pbrfit.acquire.prompts import read_prompts
from pbrfit.errors import in_one_line
from pbrfit.io import images
from pbrfit.io.images import read_stored
from pbrfit.io.input_files import (
    LIST_BYTES,
    SETTINGS_BYTES,
    TEXT_BYTES,
    digest,
    read_bytes,
)
from pbrfit.io.json_files import read_json
from pbrfit.io.lamp_files import read_lamps
from pbrfit.model.panorama import read as read_panorama
from pbrfit.result.history import History
from pbrfit.scene.folder import locate, read_settings
from pbrfit.synthetic import make_scene

POSIX = pytest.mark.skipif(sys.platform == "win32", reason="no pipes and devices there")


def read_anything_json(path: Path) -> object:
    return read_json(path, "anything")


def listed_pictures(path: Path) -> object:
    return locate(path.parent).pictures


READERS: tuple[Callable[[Path], object], ...] = (
    *(images.read_picture, images.read_data, images.read_ids, images.read_channels),
    *(read_panorama, digest),
    *(read_anything_json, read_stored, History.load, read_settings, read_prompts),
)


@POSIX
@pytest.mark.parametrize("read", READERS, ids=lambda read: read.__qualname__)
def test_irregular_files_are_never_read(tmp_path: Path, read: Callable[[Path], object]) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("pipe")
    (tmp_path / "zero").symlink_to("/dev/zero")
    (tmp_path / "folder").mkdir()
    for name, found in (("pipe", "pipe"), ("link", "pipe"), ("zero", "device"), ("folder",) * 2):
        with pytest.raises(InputError) as caught:
            read(tmp_path / name)
        assert str(caught.value) == f"{tmp_path / name}: expected a regular file, found a {found}"
    (tmp_path / "lost").symlink_to("nowhere")
    with pytest.raises(InputError, match=r"lost: expected a file, found a link to nowhere, where"):
        read(tmp_path / "lost")


@POSIX
def test_no_pipe_is_waited_for_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "file").touch()
    was = (tmp_path / "file").stat()
    with monkeypatch.context() as patched:
        patched.setattr(Path, "stat", lambda _: was)
        with pytest.raises(InputError, match="expected a regular file, found a pipe"):
            read_bytes(tmp_path / "pipe", 1)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene folder with truth."""
    folder = tmp_path_factory.mktemp("whole") / "scene"
    make_scene("room", size=8, lights=3, held_out=1).save(folder)
    return folder


@POSIX
@pytest.mark.parametrize(
    "name",
    [
        *("mask.png", "normals.exr", "normals.png", "segments.png", "weights.exr", "scene.toml"),
        *("lighting.json", "lights.json", "lights.csv", "lamps.lp", "depth.exr", "depth.npy"),
        *("dark.png", "images/light_00.exr", "images/lamps.lp", "light_directions.txt"),
        *("truth/materials.exr", "truth/lighting.json", "truth/relight/relight_00.exr"),
    ],
)
@pytest.mark.parametrize("kind", ["pipe", "lost link"])
def test_a_scene_with_something_else_in_place_of_a_file_is_refused(
    whole: Path, tmp_path: Path, name: str, kind: str
) -> None:
    folder = tmp_path / "scene"
    shutil.copytree(whole, folder)
    path = folder / name
    if name == "normals.png":
        (folder / "normals.exr").unlink()
    path.unlink(missing_ok=True)
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("nowhere")
    said = refused("inspect", folder)
    assert said.startswith(f"pbrfit: {path}: expected ")
    assert ("a pipe" if kind == "pipe" else "a link to") in said


@POSIX
@pytest.mark.parametrize("kind", ["a pipe", "a folder", "a link to nothing", "a device"])
@pytest.mark.parametrize("name", ["light_09.exr", "more", "notes.txt"])
def test_whatever_is_no_file_beside_pictures_is_named(folder: Path, name: str, kind: str) -> None:
    path = folder / "images" / name
    if kind == "a pipe":
        os.mkfifo(path)
    elif kind == "a folder":
        path.mkdir()
    else:
        path.symlink_to("/dev/null" if kind == "a device" else "nowhere")
    assert refused("inspect", folder) == (
        f"pbrfit: {path}: expected only pictures in images/, found {kind}\n"
    )
    path.rename(path.with_name(f".{name}"))  # hidden
    assert len(locate(folder).pictures) == 3


@POSIX
def test_links_to_files_are_files(folder: Path, tmp_path: Path) -> None:
    for name in ("images/light_00.exr", "normals.exr", "scene.toml"):
        moved = tmp_path / Path(name).name
        (folder / name).rename(moved)
        (folder / name).symlink_to(moved)
    assert len(Scene.load(folder).images) == 3


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_settings_are_read_as_editors_save_them(tmp_path: Path, encoding: str, end: str) -> None:
    path = tmp_path / "scene.toml"
    path.write_bytes(f"# für später{end}fov = 40.5{end}".encode(encoding))
    assert read_settings(path).fov == 40.5


def sparse(path: Path, start: bytes, size: int) -> Path:
    """A file that takes no room on disk."""
    path.write_bytes(start)
    os.truncate(path, size)
    return path


@pytest.mark.parametrize(
    ("read", "most"),
    [(read_settings, SETTINGS_BYTES), (read_prompts, SETTINGS_BYTES)]
    + [(read, TEXT_BYTES) for read in (read_anything_json, History.load)]
    + [(read, LIST_BYTES) for read in (read_lamps, listed_pictures)],
)
def test_long_texts_are_refused(tmp_path: Path, read: Callable[[Path], object], most: int) -> None:
    path = sparse(tmp_path / "filenames.txt", b"", 2 * most)
    said = f"filenames.txt: expected a file of at most {most:,} bytes, found {2 * most:,}"
    with pytest.raises(InputError, match=said):
        read(path)


def test_large_other_files_are_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = sparse(tmp_path / "mask.png", b"", 2**36)
    monkeypatch.setattr(images, "content_of", lambda *_: pytest.fail("it was read"))
    with pytest.raises(InputError, match=r"mask\.png: expected EXR, HDR, PNG, JPEG or TIFF, found"):
        images.read_data(path)


def test_a_picture_beyond_its_bound_is_refused(tmp_path: Path) -> None:
    path = sparse(tmp_path / "mask.png", b"\x89PNG\r\n\x1a\n", 2**35)
    with pytest.raises(InputError, match=r"mask\.png: .* at most 17,179,869,184 bytes, found 34,"):
        images.read_data(path)
    with pytest.raises(InputError, match="at most 17,179,869,184 bytes, found 34,359,738,368"):
        digest(path)


@pytest.mark.parametrize("words", ["", "Unable to allocate 3. GiB"])
def test_too_little_memory_names_the_file(
    folder: Path, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "mask.png").write_bytes(b"\x89PNG\r\n\x1a\n")

    def decode_raster(*_: object, **__: object) -> NoReturn:
        raise MemoryError(*filter(None, [words]))

    monkeypatch.setattr(_core, "decode_raster", decode_raster)
    said = refused("inspect", folder)
    expected = "expected memory for what it holds, found too little" + f": {words}" * bool(words)
    assert said == f"pbrfit: {folder / 'mask.png'}: {expected}\n"


def test_too_little_memory_is_told_where_nobody_knows_more() -> None:
    assert in_one_line(MemoryError()) == "not enough memory"
