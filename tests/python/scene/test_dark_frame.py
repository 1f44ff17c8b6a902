"""A dark frame is subtracted from all pictures in linear radiance."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import pbrfit
from command_runs import done
from pbrfit import InputError, Scene
from pbrfit.scene import folder as scene_folder
from scene_files import FORMATS, SIZE, room, write_exr, write_folder, write_integers

LEVEL = 0.02


def glow(level: float = LEVEL) -> NDArray[np.float32]:
    """Light that is in all pictures alike, more on the left."""
    across = np.linspace(2, 0, SIZE, dtype=np.float32)
    return np.broadcast_to(level * across[:, None], (SIZE, SIZE, 3)).astype(np.float32)


def glowing(folder: Path, form: str = "float EXR") -> Path:
    """A scene folder whose pictures have the glow too, without its picture."""
    made = write_folder(folder, form)
    suffix, write, _, _ = FORMATS[form]
    for name, image in zip(room().names, room().images, strict=True):
        write(made / "images" / f"{name}{suffix}", 0.9 * image + glow())
    return made


@pytest.mark.parametrize("form", ["float EXR", "16-bit PNG", "8-bit PNG"])
def test_what_all_pictures_share_goes(tmp_path: Path, form: str) -> None:
    folder = glowing(tmp_path / "scene", form)
    suffix, write, error, _ = FORMATS[form]
    write(folder / f"Dark{suffix}", glow())
    scene = Scene.load(folder)
    np.testing.assert_allclose(scene.images, 0.9 * room().images, rtol=0, atol=2 * error + 1e-7)
    share = 100 * LEVEL / (0.9 * room().images.mean() + LEVEL)
    assert re.match(
        rf"Dark{suffix} subtracted, {share:.2g} % of the mean radiance; ",
        scene.assumed["dark frame"],
    )
    assert scene_folder.digests(folder) == scene.inputs
    assert f"Dark{suffix}" in scene.inputs
    assert scene.response is None  # values that something was subtracted from have one curve


def test_noise_below_it_stays_negative_and_can_be_fitted(folder: Path) -> None:
    rng = np.random.default_rng(0)
    write_exr(folder / "dark.exr", rng.normal(0.01, 0.01, (SIZE, SIZE, 3)).astype(np.float32))
    write_exr(folder / "images" / "light_00.exr", 0.02 * room().images[0] + 0.01)
    scene = Scene.load(folder)
    below = 100 * np.mean(scene.images < 0)
    assert below > 1
    assert f"{below:.2g} % of the values are below 0 and stay so" in scene.assumed["dark frame"]
    result = pbrfit.decompose(scene, iterations=3, refine_normals="off")
    assert np.isfinite(result.metrics["recon_rmse"])
    assert "dark frame" in result.assumed


def spoil(folder: Path, how: str) -> Any:
    dark = folder / "dark.exr"
    if how == "two":
        write_exr(dark, glow())
        return write_integers(folder / "Dark.png", glow())
    if how == "another size":
        return write_exr(dark, glow()[1:])
    if how == "bright":
        return write_exr(dark, np.full((SIZE, SIZE, 3), 0.9, np.float32))
    if how == "clipped":
        return write_integers(folder / "dark.png", np.ones((SIZE, SIZE, 3)))
    return (folder / "dark.png").write_bytes(b"no picture")


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ("two", "scene: expected one picture dark[.][*], found Dark.png, dark.exr"),
        ("another size", "dark.exr: expected the pictures' size, 16 × 16 pixels, found 16 × 15"),
        ("bright", "dark.exr: expected a picture without light, .* light_0"),
        ("clipped", "dark.png: expected some pixel that is not clipped, found all clipped"),
        ("no picture", "dark.png: expected EXR, HDR"),
    ],
)
def test_what_is_no_dark_frame_is_refused(folder: Path, how: str, message: str) -> None:
    spoil(folder, how)
    with pytest.raises(InputError, match=message) as caught:
        Scene.load(folder)
    assert "\n" not in str(caught.value)


def test_inspect_tells_of_it(tmp_path: Path) -> None:
    folder = glowing(tmp_path / "scene")
    assert "dark frame" not in done("inspect", folder)
    write_exr(folder / "dark.exr", glow())
    assert "\nassumed dark frame dark.exr subtracted, " in done("inspect", folder)
