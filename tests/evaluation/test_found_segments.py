"""Segments from pictures and normals: regions of things, not of shadows, and not of the mask."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from evaluation_tasks import purity
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import make_scene
from pbrfit_evaluation.found_segments import LEAST, found_segments, joined

SIZE = 32


def scene(albedo: NDArray[np.float64], light: NDArray[np.float64]) -> Scene:
    """Pictures of a wall of some albedo (H, W) under light (N, H, W)."""
    rng = np.random.default_rng(0)
    grey = albedo * light * np.exp(0.01 * rng.normal(size=light.shape))
    normals = np.broadcast_to([0.0, 0.0, 1.0], (SIZE, SIZE, 3))
    return Scene(images=np.repeat(grey[..., None], 3, axis=-1), normals=normals, fov=60.0)


def halves() -> NDArray[np.bool_]:
    return np.broadcast_to(np.arange(SIZE) < SIZE // 2, (SIZE, SIZE))


def lights() -> NDArray[np.float64]:
    return np.random.default_rng(1).uniform(0.5, 1.5, (6, 1, 1)) * np.ones((6, SIZE, SIZE))


def test_two_paints_are_two_regions() -> None:
    found = found_segments(scene(np.where(halves(), 0.2, 0.5), lights()))
    assert len(np.unique(found)) == 2
    assert purity(found.ravel(), halves().ravel().astype(int)) == 1


def test_a_shadow_that_moves_is_no_region() -> None:
    light = lights()
    for i, edge in enumerate((4, 8, 14, 19, 24, 28)):
        light[i, :, :edge] *= 0.3
    assert len(np.unique(found_segments(scene(np.full((SIZE, SIZE), 0.4), light)))) == 1


def test_an_edge_of_normals_parts_regions() -> None:
    wall = scene(np.full((SIZE, SIZE), 0.4), lights())
    normals = wall.normals.copy()
    normals[:, SIZE // 2 :] = [0.8, 0.0, 0.6]
    found = found_segments(replace(wall, normals=normals))
    assert purity(found.ravel(), halves().ravel().astype(int)) == 1


def test_specks_join_what_is_around_them() -> None:
    albedo = np.full((SIZE, SIZE), 0.4)
    albedo[10:12, 10:12] = 0.05
    assert LEAST > 4
    assert len(np.unique(found_segments(scene(albedo, lights())))) == 1


def test_regions_of_furniture_are_of_one_thing() -> None:
    room = make_scene("furnished", size=48, lights=8, held_out=1, seed=2003)
    assert room.segments is not None
    found = found_segments(room)
    assert len(np.unique(found)) < 120
    assert purity(found[room.valid], room.segments[room.valid]) > 0.85


def test_a_chain_is_joined_where_it_is_alike() -> None:
    count = 4 * LEAST
    ends = np.stack([np.arange(count - 1), np.arange(1, count)], axis=-1)
    differences = np.full(count - 1, 0.01)
    differences[2 * LEAST - 1] = 2.0
    found = joined(ends, differences, count)
    assert found.tolist() == [1] * (2 * LEAST) + [2] * (2 * LEAST)
