"""`pbrfit generate` with tiny networks and with a service on loopback, as users run it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from acquire.image_service import KEY, Answer, Call, Serve, Service, failure, picture
from command_runs import ran
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


def prompts_of(service: Service) -> list[str]:
    return [call.text["prompt"] for call in service.calls]


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


def test_other_steps_are_other_settings(
    photo: Path, tiny_flux2_klein: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert generate(photo, *klein(tiny_flux2_klein, "--count", 1)) == 0
    more = ("--model", tiny_flux2_klein, "--steps", 2, "--device", "cpu", "--count", 1)
    assert generate(photo, *more, "--resume") == 2
    assert "found steps 1 (now 2); --overwrite" in capsys.readouterr().err


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


def test_a_service_that_fails_in_the_middle_is_not_asked_again_for_what_it_gave(
    photo: Path, serve: Serve
) -> None:
    service = serve(dimmed, dimmed, failure(403, "Your organization must be verified."))
    options = ("--generator", "gpt-image-2", "--count", 4)
    said = complaint(photo, *options)
    assert "must be verified" in said
    assert "2 answers are kept in" in said
    given = prompts_of(service)[:2]
    service = serve(dimmed)
    assert generate(photo, *options, "--resume") == 0
    assert len(service.calls) == 2
    assert not set(given) & set(prompts_of(service))
