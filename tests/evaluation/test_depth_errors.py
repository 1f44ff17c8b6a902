"""Depth like a network's: errors have the sizes and lengths that are said."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evaluation_tasks import depth_off, normals_off
from pbrfit.model.geometry import view_directions
from pbrfit_evaluation.estimator_errors import ROUGH, estimated_depth

SIZE, FOV = 64, 60.0
ALL = np.ones((SIZE, SIZE), bool)

Array = NDArray[np.float64]


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
