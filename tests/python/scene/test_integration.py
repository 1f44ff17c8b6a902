"""Depth from normals: planes, spheres, corners and steps, with and without noisy depth."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pbrfit import InputError
from pbrfit.model import geometry
from pbrfit.model.depth_normals import from_depth
from pbrfit.model.geometry import angles_between
from pbrfit.scene.integration import depth_from_normals
from pbrfit.values.arrays import Array

SIZE = 96
FOV = 50.0


def plane(normal: Any, offset: float, size: int = SIZE) -> tuple[Array, Array]:
    """Depth and normals of the plane n·P = -offset."""
    unit = np.asarray(normal, float) / np.linalg.norm(normal)
    views = geometry.view_directions(size, size, FOV)
    return offset * views[..., 2] / (views @ unit), np.broadcast_to(unit, (size, size, 3)).copy()


def sphere(size: int) -> tuple[Array, Array, NDArray[np.bool_], Array]:
    """Depth, normals, where it is, and n·v, of a sphere of radius 1 at distance 4."""
    views = geometry.view_directions(size, size, FOV)
    centre = np.array([0.0, 0.0, -4.0])
    along = -views @ centre
    square = along**2 - (centre @ centre - 1)
    hit = square > 0
    points = -(along - np.sqrt(np.where(hit, square, np.nan)))[..., None] * views
    normals = points - centre
    return -points[..., 2], normals, hit, np.einsum("hwi,hwi->hw", normals, views)


def corner(size: int = SIZE) -> tuple[Array, Array]:
    """Two walls that meet in a vertical edge in front of the camera."""
    left, of_left = plane([1, 0, 1], 2.0, size)
    right, of_right = plane([-0.5, 0.1, 1], 2.0, size)
    nearer = left < right
    return np.where(nearer, left, right), np.where(nearer[..., None], of_left, of_right)


def off(found: NDArray[Any], true: Array, where: Any = ...) -> Array:
    """Relative errors after the best factor."""
    log = np.log(found[where] / true[where])
    return np.asarray(np.abs(np.expm1(log - np.median(log))))


@pytest.mark.parametrize("normal", [(0, 0, 1), (0.8, -0.3, 1), (-1, 1, 1.2)])
def test_planes_are_exact(normal: Any) -> None:
    # Differences of ln z have no error of discretisation on planes; float32 has 6e-8.
    depth, normals = plane(normal, 3.0)
    found = depth_from_normals(normals, FOV)
    assert np.median(found) == pytest.approx(1.0, rel=1e-6)
    assert off(found, depth).max() < 1e-5


def test_a_plane_without_perspective_is_exact() -> None:
    normal = np.array([0.4, -0.2, 1.0]) / np.linalg.norm([0.4, -0.2, 1.0])
    x = (2 * np.arange(SIZE) + 1 - SIZE) / SIZE
    depth = 5 + (normal[0] * x + normal[1] * -x[:, None]) / normal[2]
    normals = np.broadcast_to(normal, (SIZE, SIZE, 3))
    found = depth_from_normals(normals, 0.0)
    assert found.min() == pytest.approx(1.0)
    np.testing.assert_allclose(found, depth - depth.min() + 1, rtol=1e-5)
    noisy = depth + 0.02 * np.random.default_rng(0).normal(size=depth.shape)
    fused = depth_from_normals(normals, 0.0, depth=noisy)
    assert np.abs(fused - depth).max() < 0.003


def test_a_sphere_is_right_to_second_order() -> None:
    # The middle between two pixels halves nothing but the third derivative: a quarter the error
    # with half the pixels' width. Near the outline slopes are infinite.
    errors = []
    for size in (64, 128):
        depth, normals, there, facing = sphere(size)
        found = depth_from_normals(normals, FOV, mask=there)
        assert np.isnan(found[~there]).all()
        assert np.isfinite(found[there]).all()
        errors.append(off(found, depth, there & (facing > 0.5)).max())
    assert errors[0] < 2e-3
    assert errors[1] < errors[0] / 2.5


@pytest.mark.parametrize("segmented", [False, True])
def test_walls_meet_in_their_corner(segmented: bool) -> None:
    # The edge is taken to be in the middle of two pixels: half a pixel times the change of slope.
    depth, normals = corner()
    segments = (normals[..., 0] > 0).astype(int) if segmented else None
    found = depth_from_normals(normals, FOV, segments=segments)
    half_pixel = np.tan(np.radians(FOV / 2)) / SIZE
    assert off(found, depth).max() < 1.5 * half_pixel
    normals_found, _ = from_depth(found.astype(float), fov=FOV)
    assert np.median(angles_between(normals_found, normals)) < 0.1


def step() -> tuple[Array, Array, NDArray[np.int_]]:
    """A slanted wall, and a surface in front of it that nothing ties to it."""
    depth, normals = plane([0.3, 0.1, 1], 3.0)
    near, of_near = plane([-0.2, 0.4, 1], 1.5)
    segments = np.zeros(depth.shape, int)
    segments[30:70, 25:60] = 1
    front = segments == 1
    return np.where(front, near, depth), np.where(front[..., None], of_near, normals), segments


def test_surfaces_are_right_each_by_itself_across_a_step() -> None:
    depth, normals, segments = step()
    found = depth_from_normals(normals, FOV, segments=segments)
    for segment in (0, 1):
        assert off(found, depth, segments == segment).max() < 0.01
    # Without segments the step, which no normal tells, bends both.
    bent = depth_from_normals(normals, FOV)
    assert off(bent, depth, segments == 1).max() > 0.05


@pytest.mark.parametrize("segmented", [False, True])
def test_noisy_depth_tells_the_step_and_normals_remove_the_noise(segmented: bool) -> None:
    # 5 % of noise, averaged over some thousand pixels by exact normals: 50 times less.
    depth, normals, segments = step()
    noise = 0.05
    noisy = depth * np.exp(noise * np.random.default_rng(1).normal(size=depth.shape))
    noisy[40:44] = np.nan
    found = depth_from_normals(normals, FOV, segments=segments if segmented else None, depth=noisy)
    wrong = np.abs(np.log(found / depth))
    inside = np.ones(depth.shape, bool)
    if not segmented:  # a pixel at a border that nobody told may be of either side
        inside[28:72, 23:62] = False
        inside[33:67, 28:57] = True
    assert np.sqrt(np.mean(wrong[inside] ** 2)) < noise / 10
    assert np.median(wrong) < noise / 20


def test_pixels_without_normals_are_bridged() -> None:
    depth, normals = plane([0.5, -0.2, 1], 3.0)
    normals[20:30, 20:60] = np.nan
    mask = np.ones(depth.shape, bool)
    mask[:, 70:74] = False  # two parts, tied by nothing else
    found = depth_from_normals(normals, FOV, mask=mask)
    assert np.isnan(found[:, 70:74]).all()
    assert np.isfinite(found[mask]).all()
    seen = np.isfinite(normals).all(axis=-1) & mask
    seen[:, 70:] = False
    assert off(found, depth, seen).max() < 1e-3
    seen = mask.copy()
    seen[:, :74] = False
    assert off(found, depth, seen).max() < 1e-3


def test_what_cannot_be_integrated_is_refused() -> None:
    depth, normals = plane([0, 0, 1], 3.0)
    with pytest.raises(InputError, match=r"mask: expected shape \(96, 96\), found \(96, 95\)"):
        depth_from_normals(normals, FOV, mask=np.ones((96, 95), bool))
    with pytest.raises(InputError, match="normals: expected some in the mask, found none"):
        depth_from_normals(np.nan * normals, FOV)
    with pytest.raises(InputError, match="depth: expected distances above 0"):
        depth_from_normals(normals, FOV, depth=0 * depth)


def test_one_pixel_is_as_far_as_is_said() -> None:
    for depth, expected in ((None, 1.0), (np.full((1, 1), 3.0), 3.0)):
        assert depth_from_normals(np.array([[[0, 0, 1.0]]]), FOV, depth=depth) == expected
