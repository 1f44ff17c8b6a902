"""Depth like a network's: errors have the sizes and lengths that are said."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from evaluation_tasks import depth_off, normals_off
from pbrfit.model.geometry import view_directions
from pbrfit_evaluation import depth_errors
from pbrfit_evaluation.depth_errors import (
    ROUGH,
    disturbed,
)

SIZE, FOV = 64, 60.0
ALL = np.ones((SIZE, SIZE), bool)

Array = NDArray[np.float64]


def plane(normal: tuple[float, float, float], distance: float = 3.0) -> tuple[Array, Array]:
    """Depth and normals (H, W, ...) of a plane."""
    n = np.array(normal) / np.linalg.norm(normal)
    views = view_directions(SIZE, SIZE, FOV)
    depth = distance * n[2] / (views @ n) * views[..., 2]
    return depth, np.broadcast_to(n, (SIZE, SIZE, 3))


def step() -> Array:
    depth = np.full((SIZE, SIZE), 3.0)
    depth[:, SIZE // 2 :] = 2.0
    return depth


def test_depth_is_off_as_networks_are() -> None:
    depth, normals = plane((0.1, 0.3, 1.0))
    rngs = [np.random.default_rng(seed) for seed in range(30)]
    found = [disturbed(depth, rng) for rng in rngs]
    assert 0.03 < np.mean([depth_off(one, depth, ALL) for one in found]) < 0.06
    assert 8 < np.mean([normals_off(one, normals, FOV, ALL) for one in found]) < 18
    rough = disturbed(depth, np.random.default_rng(0), noise=ROUGH)
    assert normals_off(rough, normals, FOV, ALL) > 30


def test_edges_are_washed_out_over_two_pixels(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(depth_errors, "SCALE", 0.0)
    monkeypatch.setattr(depth_errors, "SHIFT", 0.0)
    row = disturbed(step(), np.random.default_rng(4), noise=0.0)[SIZE // 2]
    assert (np.diff(row) <= 1e-12).all()
    share = (1 / row - 1 / 3) / (1 / 2 - 1 / 3)
    assert np.count_nonzero((share > 0.1) & (share < 0.9)) == 2
    tilted = plane((0.3, 0.4, 1.0))[0]
    inner = np.s_[4:-4, 4:-4]
    blurred = disturbed(tilted, np.random.default_rng(4), noise=0.0)
    np.testing.assert_allclose(blurred[inner], tilted[inner], rtol=1e-6)
