"""What estimators make of normals and depth: errors have the sizes that are said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from evaluation_tasks import depth_off, normals_off
from pbrfit.model.geometry import angles_between, view_directions
from pbrfit.synthetic import make_scene
from pbrfit.values.arrays import Array
from pbrfit_evaluation.estimator_errors import (
    LOWEST_COSINE,
    ROUGH,
    as_estimated,
    estimated_depth,
    estimated_normals,
)
from scene_files import known

SIZE, FOV = 64, 60.0
ALL = np.ones((SIZE, SIZE), bool)


def plane(normal: tuple[float, float, float], distance: float = 3.0) -> tuple[Array, Array]:
    """Depth and normals (H, W, ...) of a plane."""
    n = np.array(normal) / np.linalg.norm(normal)
    views = view_directions(SIZE, SIZE, FOV)
    depth = distance * n[2] / (views @ n) * views[..., 2]
    return depth, np.broadcast_to(n, (SIZE, SIZE, 3))


def test_depth_is_off_as_networks_are() -> None:
    depth, normals = plane((0.1, 0.3, 1.0))
    found = [estimated_depth(depth, seed) for seed in range(15)]
    assert 0.03 < np.mean([depth_off(one, depth, ALL) for one in found]) < 0.06
    assert 8 < np.mean([normals_off(one, normals, FOV, ALL) for one in found]) < 18
    rough = estimated_depth(depth, 0, noise=ROUGH)
    assert normals_off(rough, normals, FOV, ALL) > 30


def errors_of(size: int, seed: int) -> Array:
    scene = make_scene("room", size=size, lights=2, held_out=1, seed=seed)
    rng = np.random.default_rng(seed)
    found = as_estimated(scene.normals, scene.views, known(scene.segments), rng)
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1), 1.0, rtol=1e-12)
    facing = np.einsum("...i,...i->...", found, scene.views)
    assert facing.min() >= 0.9 * LOWEST_COSINE
    return angles_between(found, scene.normals)


def test_simulated_normals_err_as_published_estimators_do() -> None:
    """Of DSINE on NYUv2: mean 16.4, median 8.4 degrees; 60 % within 11.25, 84 % within 30."""
    off = np.concatenate([errors_of(64, seed).ravel() for seed in range(200, 212)])
    assert 12 <= off.mean() <= 18
    assert 7 <= np.median(off) <= 11
    assert 0.5 <= np.mean(off < 11.25) <= 0.7
    assert 0.8 <= np.mean(off < 30) <= 0.9


def test_normals_that_nobody_knows_spoil_no_others() -> None:
    whole = make_scene("room", size=32, lights=2, held_out=1, seed=3)
    unknown = np.zeros(whole.normals.shape[:2], bool)
    unknown[::3, ::2] = True
    masked = replace(
        whole,
        mask=~unknown,
        normals=np.where(unknown[..., None], np.nan, whole.normals),
        truth=None,
    )
    of_all, found = (estimated_normals(scene, 3) for scene in (whole, masked))
    np.testing.assert_array_equal(np.isnan(found).all(axis=-1), unknown)
    assert np.isfinite(of_all).all()
    assert np.median(angles_between(found, of_all)[~unknown]) < 2.0
