"""Depth of a scene: checked, compared with the normals, read, written, averaged down, cut."""

from __future__ import annotations

import dataclasses
import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from command_runs import done
from pbrfit import InputError, Scene
from pbrfit.io import images
from pbrfit.model import geometry
from pbrfit.model.depth_normals import from_depth
from pbrfit.report import inspection
from pbrfit.scene import folder as scene_folder
from pbrfit.scene.depth import reduced
from scene_files import known, world

SIZE = 48
FOV = 60.0


def tilted(degrees: float, size: int = SIZE, fov: float = FOV) -> tuple[Any, Any]:
    """Depth and normals of a plane at distance 3 that is turned about Y from facing the camera."""
    angle = np.radians(degrees)
    normal = np.array([np.sin(angle), 0.0, np.cos(angle)])
    views = geometry.view_directions(size, size, fov)
    depth = 3.0 * normal[2] * views[..., 2] / (views @ normal)
    return depth, np.broadcast_to(normal, (size, size, 3))


def scene(depth: Any, normals: Any, **changes: Any) -> Scene:
    pictures = np.ones((2, *np.shape(normals)[:2], 3), np.float32)
    pictures[1] = 0.5
    return Scene(
        images=pictures, normals=normals, fov=changes.pop("fov", FOV), depth=depth, **changes
    )


def furnished(size: int = 96) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Depth and normals of a synthetic room."""
    return world("room", 3, size, size, FOV)[:2]


def test_what_is_no_distance_becomes_unknown_and_is_told() -> None:
    depth, normals = tilted(30)
    for place, value in enumerate((1e-38, -1.0, np.inf, 1e10, np.nan)):
        depth[5, 5 * place] = value
    made = scene(depth, normals)
    assert made.depth is not None
    assert made.depth.dtype == np.float32
    assert np.isnan(made.depth[5, :21:5]).all()
    assert np.isfinite(made.depth).sum() == depth.size - 5
    assert made.assumed["depth"] == "4 pixels of 0, negative or infinite depth left out"
    again = dataclasses.replace(made, normals=normals)  # nothing is told twice
    assert again.assumed == made.assumed
    np.testing.assert_array_equal(again.depth, made.depth)


@pytest.mark.parametrize(
    ("depth", "said"),
    [
        (np.ones((SIZE, SIZE + 1)), r"depth: expected shape \(48, 48\), found \(48, 49\)"),
        (np.zeros((SIZE, SIZE)), "depth: expected distances above 0, found none"),
        (np.full((SIZE, SIZE), -2.5), "above 0, found none below 1e[+]09 but -2.5 to -2.5"),
        (np.full((SIZE, SIZE), np.nan), "depth: expected distances above 0, found none"),
        (np.full((SIZE, SIZE), 1j), "depth: expected real numbers, found complex128"),
    ],
)
def test_depth_that_cannot_be_used_is_refused(depth: Any, said: str) -> None:
    with pytest.raises(InputError, match=said):
        scene(depth, tilted(0)[1])


@pytest.mark.parametrize("factor", [1e-3, 1.0, 255.0])
def test_inverse_depth_of_a_room_is_refused(factor: float) -> None:
    depth, normals = furnished()
    scene(factor * depth, normals)
    with pytest.raises(InputError, match=r"depth: .* found inverse depth .normals"):
        scene(factor / depth, normals)


def test_distances_along_rays_become_those_along_the_axis() -> None:
    depth, normals = furnished()
    made = scene(depth / geometry.view_directions(96, 96, FOV)[..., 2], normals)
    assert made.assumed["depth"] == "read as distances along the rays, as the normals show"
    np.testing.assert_allclose(known(made.depth), depth, rtol=1e-6)
    assert dataclasses.replace(made, normals=normals).assumed == made.assumed  # once
    assert "depth" not in scene(depth, normals).assumed


@pytest.mark.parametrize("unit", [1, 10, 1000])
def test_depth_of_an_orthographic_camera_in_another_unit_is_not_inverse(unit: float) -> None:
    depth = 3 + np.add.outer(np.arange(40) * 0.01, np.sin(np.arange(40) / 8) * 0.1)
    normals, _ = from_depth(depth, fov=0, view_width=2.0)
    said = scene(unit * depth, normals, fov=0).assumed.get("depth", "")
    assert ("an orthographic view has to be 2 units wide" in said) == (unit > 1)
    with pytest.raises(InputError, match="found inverse depth"):
        scene(unit / depth, normals, fov=0)


def test_inverse_depth_is_told_from_depth_despite_wrong_normals_and_noise() -> None:
    # Normals off by about 10 degrees and noise of 0.1 %, which tilts normals by several degrees.
    depth, normals = furnished()
    rng = np.random.default_rng(0)
    noisy = depth * (1 + 1e-3 * rng.normal(size=depth.shape))
    off = normals + np.tan(np.radians(7)) * rng.normal(size=normals.shape)
    assert scene(noisy, off).depth is not None
    with pytest.raises(InputError, match="found inverse depth"):
        scene(1 / noisy, off)


@pytest.mark.parametrize(("tilt", "refused"), [(3.0, False), (9.0, True)])
def test_the_tilt_from_which_inverse_depth_can_be_told(tilt: float, refused: bool) -> None:
    # The axis of a narrow view: the inverse misses by twice the tilt, 6 or 18 degrees.
    depth, normals = tilted(tilt, fov=2.0)
    if refused:
        with pytest.raises(InputError, match="18 degrees from the given ones"):
            scene(1 / depth, normals, fov=2.0)
    else:
        scene(1 / depth, normals, fov=2.0)


def test_depth_that_contradicts_the_normals_either_way_is_told(
    caplog: pytest.LogCaptureFixture,
) -> None:
    depth, _ = tilted(50)
    normals = np.broadcast_to(np.array([0, np.sin(1.0), np.cos(1.0)]), (SIZE, SIZE, 3))
    with caplog.at_level(logging.WARNING, "pbrfit"):
        made = scene(depth, normals)
    assert "contradict each other" in caplog.text
    assert "contradict each other" in made.assumed["depth"]
    caplog.clear()
    with caplog.at_level(logging.WARNING, "pbrfit"):
        scene(depth, tilted(90 - 50)[1])  # 10 degrees off
    assert "contradict" not in caplog.text


def test_nothing_is_averaged_across_a_jump() -> None:
    depth = np.full((12, 12), 2.0)
    depth[:, 5:] = 6.0
    depth[:4, :4] = np.nan
    depth[0, 0] = 2.5
    found = reduced(depth, (6, 6))
    known = found[np.isfinite(found)]
    assert np.isin(known, [2.0, 2.5, 6.0]).all()
    assert found[0, 0] == 2.5  # the one sample there
    assert np.isnan(found).sum() == 3


def saved(folder: Path, **changes: Any) -> tuple[Path, Scene]:
    depth, normals = furnished()
    depth[3, 4] = np.nan
    made = scene(depth, normals, **changes)
    made.save(folder)
    return folder, made


def test_saved_depth_comes_back_and_is_an_input(tmp_path: Path) -> None:
    folder, made = saved(tmp_path / "scene")
    assert set(images.read_channels(folder / "depth.exr")) == {"Z"}
    read = Scene.load(folder)
    np.testing.assert_array_equal(read.depth, made.depth)
    assert read.inputs == scene_folder.digests(folder)
    assert "depth.exr" in read.inputs
    assert read.assumed["depth"].startswith("depth.exr: ")
    assert read.assumed["depth"].endswith("0.011 % of the pixels unknown")


def test_depth_of_numpy_is_read(tmp_path: Path) -> None:
    folder, made = saved(tmp_path / "scene")
    np.save(folder / "depth.npy", known(made.depth))
    for read in (Scene.load, scene_folder.digests):
        with pytest.raises(InputError, match=r"one file with depth, found depth.exr, depth.npy"):
            read(folder)
    (folder / "depth.exr").unlink()
    np.testing.assert_array_equal(Scene.load(folder).depth, known(made.depth))
    assert "depth.npy" in scene_folder.digests(folder)


def test_files_with_unusable_depth_are_named(tmp_path: Path) -> None:
    folder, made = saved(tmp_path / "scene")
    depth = known(made.depth)
    for stored, message in (
        (depth[:, :50], "depth.exr: expected the pictures' size, 96 × 96"),
        (0 * depth, "depth.exr: depth: expected distances above 0"),
        (1 / depth, "scene: depth: expected distances, found inverse depth"),
    ):
        images.write_exr(folder / "depth.exr", {"Z": stored})
        with pytest.raises(InputError, match=message):
            Scene.load(folder)


def test_inspect_tells_what_the_depth_is_like(tmp_path: Path) -> None:
    folder, made = saved(tmp_path / "scene")
    said = done("inspect", folder)
    [line] = [one for one in said.splitlines() if one.startswith("depth ")]
    depth = known(made.depth)
    assert line == (
        f"depth             depth.exr, {np.nanmin(depth):.3g} to {np.nanmax(depth):.3g}, unknown "
        "in 0.0 % of the mask; its normals 0.0 degrees (median) from the given ones"
    )
    assert dict(inspection.facts(scene(None, made.normals)))["depth"] == "none"
