"""`pbrfit generate` with tiny networks and with a service on loopback, as users run it."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from acquire.image_service import KEY, Answer, Call, Serve, failure, picture
from acquire.tiny_maps import (
    save_tiny_depth_anything,
    save_tiny_marigold_normals,
    save_tiny_sam2,
)
from command_runs import ran
from pbrfit.acquire import depth as depths
from pbrfit.acquire import marigold, segments
from pbrfit.cli import main
from pbrfit.scene.scene import Scene

FREE = ("--normals", "flat", "--segments", "none", "--no-review", "--fov", "50")


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    down, right = np.mgrid[:72, :96]
    codes = np.stack([40 + 2 * down, 30 + 2 * right, 200 - down - right], axis=-1)
    path = tmp_path / "photo.png"
    Image.fromarray(codes.astype(np.uint8)).save(path)
    return path


def generate(photo: Path, *options: str | Path | int) -> int:
    scene = photo.parent / "scene"
    return main(["generate", str(photo), "--out", str(scene), *map(str, [*FREE, *options])])


def complaint(photo: Path, *options: str | Path | int) -> str:
    """The last line of a refusal, after which there is no scene."""
    found = ran("generate", photo, "--out", photo.parent / "scene", *FREE, *options)
    assert found.code == 2
    assert not (photo.parent / "scene" / "images").exists()
    return found.err.splitlines()[-1]


def klein(model: Path, *options: str | int) -> tuple[str | Path | int, ...]:
    return ("--model", model, "--steps", 1, "--device", "cpu", *options)


def dimmed(call: Call) -> Answer:
    return picture(call.image // 2)


def test_a_tiny_network_makes_a_scene_and_resume_adds_to_it(
    photo: Path, tiny_flux2_klein: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert generate(photo, *klein(tiny_flux2_klein, "--count", 2)) == 0
    assert "2 of 2 generated and the photograph" in capsys.readouterr().out
    scene = photo.parent / "scene"
    first = {path: path.read_bytes() for path in (scene / "generation").glob("*-*")}
    assert len(first) == 4
    assert generate(photo, *klein(tiny_flux2_klein, "--count", 3, "--resume")) == 0
    assert len(Scene.load(scene).images) == 4
    assert first == {path: path.read_bytes() for path in first}
    record = json.loads((scene / "review.json").read_text())["pictures"][2]["attempts"][0]["record"]
    assert record["generator"] == "flux2-klein"
    assert record["seed"] == 2
    assert generate(photo, *klein(tiny_flux2_klein, "--steps", 2, "--resume")) == 2
    assert "found steps 1 (now 2); --overwrite" in capsys.readouterr().err


def test_tiny_networks_make_all_that_a_scene_may_have(
    photo: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = photo.parent
    for module, name, save in (
        (marigold, "normals_of", save_tiny_marigold_normals),
        (segments, "by_sam2", save_tiny_sam2),
        (depths, "by_depth_anything", partial(save_tiny_depth_anything, metric=False)),
    ):
        model = str(save(here / module.__name__))
        monkeypatch.setattr(module, name, partial(getattr(module, name), model=model))
    (here / "relit").mkdir()
    Image.open(photo).transpose(Image.Transpose.ROTATE_180).save(here / "relit" / "a.png")
    source = ("--generator", f"folder:{here / 'relit'}", "--no-review", "--device", "cpu")
    assert main(["generate", str(photo), "--out", str(here / "scene"), "--fov", "50", *source]) == 0
    made = json.loads((here / "scene" / "review.json").read_text())
    found = [made[of]["source"] for of in ("normals", "segments", "depth")]
    assert found == ["marigold", "sam2", "depth-anything"]
    assert Scene.load(here / "scene").depth is not None


def test_what_cannot_be_shows_before_anything_is_made(
    photo: Path, tiny_distilled_flux2_klein: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    weights = "expected the weights black-forest-labs/FLUX.2-klein-base-4B in "
    assert weights in complaint(photo, "--device", "cpu")
    assert "distilled" in complaint(photo, *klein(tiny_distilled_flux2_klein))
    monkeypatch.delenv("OPENAI_API_KEY", raising=False)
    said = complaint(photo, "--generator", "gpt-image-2")
    assert "OPENAI_API_KEY: expected a key" in said
    assert not (photo.parent / "scene").exists()


def test_a_service_makes_a_scene_without_the_prompt_that_it_refused(
    photo: Path, serve: Serve, capsys: pytest.CaptureFixture[str]
) -> None:
    refusal = failure(400, "Rejected by the safety system.", "moderation_blocked")
    service = serve(dimmed, refusal, dimmed)
    options = ("--generator", "gpt-image-2", "--count", 4, "--quality", "low")
    assert generate(photo, *options) == 0
    said = capsys.readouterr()
    assert "3 of 4 generated and the photograph" in said.out
    assert "refused by moderation: Rejected by the safety system." in said.out
    assert len(service.calls) == 4
    assert generate(photo, *options, "--resume") == 0
    assert len(service.calls) == 4
    scene = photo.parent / "scene"
    written = b"".join(path.read_bytes() for path in scene.rglob("*") if path.is_file())
    assert KEY.encode() not in written
    assert KEY not in said.out + said.err
