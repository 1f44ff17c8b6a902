"""Heights of an export, integrated from the normals of planted surfaces (docs/export.md)."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from command_runs import done
from pbrfit import Result, decompose
from pbrfit.export import export_result
from pbrfit.export.displacement import FLAT, Displacement
from pbrfit.export.view_mesh import camera
from pbrfit.io import images
from pbrfit.synthetic import make_scene
from pbrfit.values.arrays import Array
from reference import unit
from relit import card
from scene_files import known

HEIGHT, WIDTH = 48, 64


@pytest.fixture(scope="module")
def fitted() -> Result:
    return decompose(make_scene("room", size=8, lights=3, held_out=1), iterations=1)


def hills(x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Height and its slopes at places in picture widths."""
    a, b = 2 * np.pi * 2, 2 * np.pi * 1.5
    height = 0.03 * np.sin(a * x) * np.cos(b * y)
    right = 0.03 * a * np.cos(a * x) * np.cos(b * y)
    return height, right, -0.03 * b * np.sin(a * x) * np.sin(b * y)


def on_card() -> tuple[Array, Array]:
    i, j = np.mgrid[:HEIGHT, :WIDTH]
    return (j + 0.5) / WIDTH - 0.5, (0.5 * HEIGHT - i - 0.5) / WIDTH


def test_a_planted_surface_comes_back_in_picture_widths(fitted: Result, tmp_path: Path) -> None:
    x, y = on_card()
    height, right, up = hills(x, y)
    normals = unit(np.stack([-right, -up, np.ones_like(x)], axis=-1))
    export_result(card(fitted, normals, 0.0), tmp_path / "out")
    told = json.loads((tmp_path / "out" / "export.json").read_text("utf-8"))["displacement"]
    assert (told["unit"], told["source"]) == ("picture widths", "normals")
    floats = images.read_channels(tmp_path / "out" / "exr" / "displacement.exr")["Y"]
    off = floats - height
    assert np.abs(off - off.mean()).max() < 0.01 * np.ptp(height)
    assert told["low"] == pytest.approx(floats.min(), abs=1e-7)
    assert told["high"] == pytest.approx(floats.max(), abs=1e-7)
    codes = images.read_picture(tmp_path / "out" / "png" / "displacement.png", "linear").pixels
    decoded = told["low"] + (told["high"] - told["low"]) * codes[..., 0]
    step = (told["high"] - told["low"]) / 65535
    np.testing.assert_allclose(decoded, floats, atol=0.51 * step + 1e-7)


def test_with_perspective_height_and_rays_are_the_surface(fitted: Result) -> None:
    """A sphere in front of the camera of the card: points by height and ray lie on it."""
    fov = 50.0
    _, distance = camera(HEIGHT, WIDTH, fov)
    x, y = on_card()
    rays = np.stack([x, y, np.full_like(x, -distance)], axis=-1)  # from the eye to the card
    centre, radius = np.array([0.05, -0.02, -2.0 * distance]), 1.3 * distance
    square = np.sum(rays**2, axis=-1)
    along = rays @ centre
    under = along**2 - square * (centre @ centre - radius**2)
    assert (under > 0).all()  # the sphere fills the view
    points = ((along - np.sqrt(under)) / square)[..., None] * rays
    normals = unit(points - centre)
    found = known(Displacement.of(card(fitted, normals, fov)))
    got = rays * (1 - found.height / distance)[..., None]
    scale = np.median(-points[..., 2]) / distance
    error = np.linalg.norm(scale * got - points, axis=-1) / scale
    assert error.max() < 0.003  # picture widths
    assert np.median(found.height) == pytest.approx(0, abs=1e-6)


def test_depth_of_the_scene_places_what_hangs_together_nowhere(fitted: Result) -> None:
    """A step between two flat parts, of which normals say nothing."""
    normals = np.zeros((HEIGHT, WIDTH, 3))
    normals[..., 2] = 1
    flat = card(fitted, normals, 0.0)
    assert Displacement.of(flat) is None
    depth = np.full((HEIGHT, WIDTH), 3.0, np.float32)
    depth[:, WIDTH // 2 :] = 2.5
    found = known(Displacement.of(dataclasses.replace(flat, depth=depth)))
    # Half of the picture's width is 1 of an orthographic depth.
    assert found.high - found.low == pytest.approx(0.25, abs=0.01)
    tilted = unit(np.broadcast_to([FLAT / 4, 0, 1.0], normals.shape))
    assert Displacement.of(card(fitted, tilted, 0.0)) is None
    tilted = unit(np.broadcast_to([10 * FLAT, 0, 1.0], normals.shape))
    assert Displacement.of(card(fitted, tilted, 0.0)) is not None


def test_a_height_map_is_left_out_where_it_is_not_wanted(fitted: Result, tmp_path: Path) -> None:
    x, y = on_card()
    _, right, up = hills(x, y)
    result = card(fitted, unit(np.stack([-right, -up, np.ones_like(x)], axis=-1)), 0.0)
    result.save(tmp_path / "result")
    done("export", tmp_path / "result", "--out", tmp_path / "out", "--no-height")
    assert not list((tmp_path / "out").rglob("displacement*"))
    assert "displacement" not in json.loads((tmp_path / "out" / "export.json").read_text("utf-8"))
    done("export", tmp_path / "result", "--out", tmp_path / "unity", "--preset", "unity")
    assert (tmp_path / "unity" / "png" / "HeightMap.png").is_file()
