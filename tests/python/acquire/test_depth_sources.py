"""Depth from files, from normals, and what is made of a network's answer; no network runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from command_runs import done, refused
from pbrfit import Scene
from pbrfit._core import InputError
from pbrfit.acquire import depth as depths
from pbrfit.acquire import marigold
from pbrfit.acquire.depth import with_offset
from pbrfit.acquire.marigold import aligned_mean
from pbrfit.io import images
from pbrfit.model import geometry
from pbrfit.scene.depth import compared
from pbrfit.values.arrays import Array
from scene_files import known, world

SIZE = 64
FOV = 60.0


def surface(size: int = SIZE) -> tuple[Array, Array]:
    """Depth and normals of a synthetic room."""
    return world("room", 3, size, size, FOV)[:2]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A scene folder without depth."""
    pictures = np.random.default_rng(0).uniform(0.1, 1, (2, SIZE, SIZE, 3)).astype(np.float32)
    Scene(images=pictures, normals=surface()[1], fov=FOV).save(tmp_path / "scene")
    return tmp_path / "scene"


def read_back(folder: Path) -> NDArray[np.floating[Any]]:
    return known(Scene.load(folder).depth)


def off(found: NDArray[Any], true: Array) -> Array:
    """Relative errors after the best factor."""
    log = np.log(found / true)
    return np.asarray(np.abs(np.expm1(log - np.median(log))))


@pytest.mark.parametrize("disparity", [False, True])
@pytest.mark.parametrize("error_degrees", [0.0, 8.0])
def test_normals_tell_the_offset_of_relative_depth(disparity: bool, error_degrees: float) -> None:
    depth, normals = surface()
    noise = np.random.default_rng(1).normal(size=normals.shape)
    given = geometry.unit(normals + np.tan(np.radians(error_degrees)) * noise)
    relative = 1 / depth if disparity else depth
    relative = (relative - relative.min()) / np.ptp(relative)
    found, said = with_offset(relative, given, FOV, disparity=disparity)
    assert np.median(found) == pytest.approx(1, rel=1e-5)
    # Off by the offset alone, found to some percent with normals that are off by 8 degrees.
    assert off(found, depth).max() < (0.02 if error_degrees == 0 else 0.1)
    assert ("inverse depth" in said) == disparity
    assert "offset by the normals" in said


def test_an_offset_at_the_end_of_its_range_is_said() -> None:
    # A relief whose normals all face the camera is infinitely far away.
    facing = np.broadcast_to([0.0, 0.0, 1.0], (SIZE, SIZE, 3))
    _, said = with_offset(surface()[0], facing, FOV)
    assert "hardly tell" in said


def test_an_offset_that_nothing_tells_is_refused() -> None:
    depth, normals = surface()
    with pytest.raises(InputError, match="expected a field of view above 0"):
        with_offset(depth, normals, 0.0)
    with pytest.raises(InputError, match="expected normals beside it, found none"):
        with_offset(depth, np.nan * normals, FOV)
    with pytest.raises(InputError, match="expected different depths, found all equal"):
        with_offset(np.ones_like(depth), normals, FOV)


def test_members_that_differ_by_factor_and_offset_are_the_same_answer() -> None:
    first = surface()[0]
    np.testing.assert_allclose(aligned_mean([first, 3 * first - 2, 0.1 * first + 7]), first)
    noise = np.random.default_rng(2).normal(size=(10, *first.shape))
    mean = aligned_mean([first, *(2 * (first + 0.3 * one) + 1 for one in noise)])
    assert np.abs(mean - first).mean() < 0.15


@pytest.mark.parametrize(
    ("kind", "suffix"), [("z", ".exr"), ("z", ".npy"), ("ray", ".png"), ("disparity", ".exr")]
)
def test_depth_of_a_file(folder: Path, tmp_path: Path, kind: str, suffix: str) -> None:
    depth, _ = surface()
    views = geometry.view_directions(SIZE, SIZE, FOV)
    given = {"z": depth, "ray": depth / views[..., 2], "disparity": 1 / depth}[kind]
    path = tmp_path / f"map{suffix}"
    if suffix == ".exr":
        images.write_exr(path, {"Z": given})
    elif suffix == ".npy":
        np.save(path, given)
    else:
        images.write_png(path, np.rint(65535 * given / given.max()).astype(np.uint16), tag=None)
    said = done("depth", folder, "--from", path, "--depth-kind", kind)
    assert "depth.exr: " in said
    assert "degrees (median) from the scene's" in said
    assert off(read_back(folder), depth).max() < 1e-3


def test_depth_of_normals(folder: Path) -> None:
    said = done("depth", folder, "--from", "normals")
    assert "in a unit of its own: normals tell depth up to a factor" in said
    scene = Scene.load(folder)
    assert compared(known(scene.depth), surface()[1], FOV)[0] < 5


def test_fusing_removes_noise(folder: Path, tmp_path: Path) -> None:
    depth = surface()[0]
    noisy = depth * np.exp(0.05 * np.random.default_rng(3).normal(size=depth.shape))
    np.save(tmp_path / "map.npy", noisy)
    assert "fused with the normals" in done(
        "depth", folder, "--from", tmp_path / "map.npy", "--fuse"
    )
    assert np.median(off(read_back(folder), depth)) < np.median(off(noisy, depth)) / 4


def test_inverse_depth_is_refused_before_it_is_written(folder: Path, tmp_path: Path) -> None:
    np.save(tmp_path / "map.npy", 1 / surface()[0])
    assert "found inverse depth" in refused("depth", folder, "--from", tmp_path / "map.npy")
    assert not (folder / "depth.exr").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--from", "normals", "--seed", "3"), "--seed: has no meaning with --from normals"),
        (("--depth-kind", "ray"), "--depth-kind: has no meaning with --from marigold"),
        (("--from", "depth-anything", "--steps", "3"), "--steps: has no meaning with"),
        (("--from", "nothing"), "expected marigold, depth-anything, normals"),
    ],
)
def test_what_the_command_cannot_do_changes_nothing(
    folder: Path, arguments: tuple[str, ...], message: str
) -> None:
    assert message in refused("depth", folder, *arguments)
    assert not (folder / "depth.exr").exists()


def test_sources_that_need_normals_say_so(folder: Path, tmp_path: Path) -> None:
    (folder / "normals.exr").unlink()
    np.save(tmp_path / "map.npy", surface()[0])
    for source, *fuse in (("normals",), (tmp_path / "map.npy", "--fuse")):
        said = refused("depth", folder, "--from", source, *fuse)
        assert "expected a scene with normals, found none" in said
    done("depth", folder, "--from", tmp_path / "map.npy")
    np.testing.assert_allclose(
        images.read_channels(folder / "depth.exr")["Z"], surface()[0], rtol=1e-6
    )


# What is made of a network's answer


def test_relative_answers_are_moved_by_the_normals(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    depth, _ = surface()
    shown = []

    def answer(srgb8: NDArray[np.uint8], **options: Any) -> Any:
        shown.append((srgb8.shape, options["ensemble"]))
        return (depth - depth.min()) / np.ptp(depth), {"model": "tiny"}

    monkeypatch.setattr(marigold, "depth_of", answer)
    said = done("depth", folder, "--ensemble", 2)
    assert shown == [((SIZE, SIZE, 3), 2)]
    assert "up to factor and offset: offset by the normals" in said
    assert off(read_back(folder), depth).max() < 0.02


@pytest.mark.parametrize("metric", [True, False])
def test_answers_of_depth_anything(
    folder: Path, monkeypatch: pytest.MonkeyPatch, metric: bool
) -> None:
    depth, _ = surface()
    relative = (1 / depth - (1 / depth).min()) / np.ptp(1 / depth)

    def answer(*_: Any, **__: Any) -> Any:
        return (depth if metric else relative), metric, {"model": "tiny"}

    monkeypatch.setattr(depths, "by_depth_anything", answer)
    said = done("depth", folder, "--from", "depth-anything")
    assert ("in metres, as the network has it" in said) == metric
    assert ("inverse depth up to factor and offset" in said) != metric
    found = read_back(folder)
    assert off(found, depth).max() < 0.02
    if metric:
        np.testing.assert_allclose(found, depth, rtol=1e-6)
