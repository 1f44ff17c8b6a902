"""What commands replace: what they wrote themselves, and through no link."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest

from command_runs import done, ran, refused
from pbrfit.export import EXPORT_FOLDER, export_result
from pbrfit.export.presets import PRESETS
from pbrfit.fit.decompose import decompose
from pbrfit.io import images
from pbrfit.result.result import Result
from pbrfit.scene.folder import SCENE_FOLDER
from pbrfit.scene.options import Source
from pbrfit.synthetic import make_scene
from scene_files import Argument, truth_of, write_folder

POSIX = pytest.mark.skipif(sys.platform == "win32", reason="links need rights there")

FEW = ("--iterations", 0, "--quiet")

SMALL = ("--size", 8, "--lights", 3)


@pytest.fixture(scope="module")
def fitted() -> Result:
    return decompose(make_scene("room", size=8, lights=3), iterations=2)


@pytest.fixture
def result(fitted: Result, tmp_path: Path) -> Path:
    fitted.save(tmp_path / "result")
    return tmp_path / "result"


@pytest.mark.parametrize("preset", [None, *PRESETS])
def test_an_export_holds_what_it_lists(fitted: Result, tmp_path: Path, preset: str | None) -> None:
    export_result(fitted, tmp_path / "out", preset=preset)  # type: ignore[arg-type]
    assert list(EXPORT_FOLDER.foreign(tmp_path / "out")) == []
    (tmp_path / "out" / "png" / "edited.png").touch()
    assert [path.name for path in EXPORT_FOLDER.foreign(tmp_path / "out")] == ["edited.png"]
    (tmp_path / "out" / "export.json").write_text("{")
    assert list(EXPORT_FOLDER.foreign(tmp_path / "out"))


@pytest.mark.parametrize(
    ("command", "out"),
    [
        *((("decompose",), out) for out in ("images/out", "flat/out", "truth", "loose/images")),
        *((("inspect",), out) for out in ("images/a.md", "images/light_00.exr", "segments.png")),
        (("lights", "--from", "ball"), "normals.exr"),
        *((command, "images/new") for command in (("report",), ("export",))),
        (("relight", "--light", "0,0"), "images/new.png"),
        *((command, "loose/a.PNG") for command in (("inspect",), ("relight", "--light", "0,0"))),
    ],
)
def test_nothing_is_written_where_a_scene_is_read(
    fitted: Result, folder: Path, tmp_path: Path, command: tuple[str, ...], out: str
) -> None:
    if out.startswith("loose"):
        folder = (folder / "images").rename(tmp_path / "loose")
    place = (folder.parent if folder.name == "loose" else folder) / out
    dataclasses.replace(fitted, source=Source(folder)).save(tmp_path / "result")
    of_result = command[0] in ("report", "export", "relight")
    option = "--preview" if command[0] in ("inspect", "lights") else "--out"
    before = {path: path.read_bytes() for path in folder.rglob("*.*")}
    assert "expected a place that is not read with the pictures of the scene, found" in refused(
        *command, tmp_path / "result" if of_result else folder, option, place, "--overwrite"
    )
    assert {path: path.read_bytes() for path in folder.rglob("*.*")} == before


def test_a_saved_scene_holds_nothing_of_others(tmp_path: Path) -> None:
    made = make_scene("furnished", size=8, lights=3, held_out=1)
    scene = dataclasses.replace(
        made,
        mask=np.arange(64).reshape(8, 8) > 0,
        weights=np.ones((8, 8), np.float32),
        depth=np.ones((8, 8), np.float32),
        lighting=truth_of(made).lighting,
    )
    scene.save(tmp_path / "out")
    assert {path.name for path in (tmp_path / "out").iterdir()} >= {
        *("mask.png", "weights.exr", "depth.exr", "lighting.json", "segments.png")
    }
    assert list(SCENE_FOLDER.foreign(tmp_path / "out")) == []
    scene.save(tmp_path / "out", overwrite=True)
    for mine in ("images/mine.png", "images/mine.exr", "truth/relight/mine.exr"):
        (tmp_path / "out" / mine).touch()
        with pytest.raises(FileExistsError, match=f"found {mine} besides"):
            scene.save(tmp_path / "out", overwrite=True)
        (tmp_path / "out" / mine).unlink()


@pytest.mark.parametrize(
    "command",
    [
        ("synth", "OUT", *SMALL),
        ("export", "RESULT", "--out", "OUT"),
        ("relight", "RESULT", "--light", "0,45", "--turntable", 2, "--out", "OUT"),
        ("decompose", "SCENE", "--out", "OUT", *FEW),
        pytest.param(("demo", "OUT", *SMALL, *FEW), marks=pytest.mark.slow),
    ],
    ids=lambda command: command[0],
)
def test_what_somebody_put_into_an_output_keeps_it(
    result: Path, tmp_path: Path, command: tuple[Argument, ...]
) -> None:
    out = tmp_path / "out"
    named: dict[Argument, Path] = {"OUT": out, "RESULT": result}
    if "SCENE" in command:
        named["SCENE"] = write_folder(tmp_path / "scene")
    arguments = [named.get(one, one) for one in command]
    done(*arguments)
    done(*arguments, "--overwrite")
    (out / "notes.txt").write_text("mine")
    (out / "renders").mkdir()
    before = sorted(out.rglob("*"))
    assert refused(*arguments, "--overwrite") == (
        f"pbrfit: {out}: expected nothing but an earlier output to replace, found notes.txt, "
        "renders besides; move it away first\n"
    )
    assert sorted(out.rglob("*")) == before


@POSIX
@pytest.mark.parametrize(
    "command",
    [
        ("report", "RESULT", "--overwrite", "--out", "out.html"),
        ("relight", "RESULT", "--light", "0,45", "--overwrite", "--out", "out.png"),
        ("inspect", "SCENE", "--overwrite", "--preview", "out.png"),
        ("generate", "--overwrite", "--save-prompts", "out.toml"),
        ("normals", "SCENE", "--from", "flat", "--overwrite", "SCENE/normals.exr"),
        ("normals", "SCENE", "--from", "flat", "--overwrite", "SCENE/weights.exr"),
        ("segments", "SCENE", "--from", "IDS", "--overwrite", "SCENE/segments.png"),
    ],
    ids=lambda command: f"{command[0]}-{Path(command[-1]).name}",
)
def test_no_file_is_written_through_a_link(
    result: Path, folder: Path, tmp_path: Path, command: tuple[str, ...]
) -> None:
    ids = tmp_path / "ids.png"
    images.write_png(ids, np.ones((16, 16), np.uint8), None)
    *arguments, name = command
    out = Path(str(tmp_path / name).replace("SCENE", "scene"))
    out.unlink(missing_ok=True)
    out.symlink_to(tmp_path / "theirs")
    (tmp_path / "theirs").write_text("precious")
    named = {"RESULT": result, "SCENE": folder, "IDS": ids}
    given: list[Argument] = [named.get(one, one) for one in arguments]
    if not name.startswith("SCENE"):
        given.append(out)
    found = ran(*given)
    assert found.code == 2
    assert found.err == (
        f"pbrfit: {out}: expected a file or nothing, found a link to {tmp_path / 'theirs'}\n"
    )
    assert (tmp_path / "theirs").read_text() == "precious"
    assert out.is_symlink()
