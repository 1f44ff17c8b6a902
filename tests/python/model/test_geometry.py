"""Angles between normals."""

from __future__ import annotations

import numpy as np

from pbrfit.model.geometry import angles_between


def test_angles_by_hand() -> None:
    x, y = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    tiny = np.array([1.0, 1e-9, 0.0])
    found = angles_between(np.stack([x, x, x, tiny]), np.stack([x, y, -x, x]))
    np.testing.assert_allclose(found, [0, 90, 180, np.degrees(1e-9)], rtol=1e-6, atol=1e-12)
    assert np.isnan(angles_between(np.full((1, 3), np.nan), x[None])).all()
