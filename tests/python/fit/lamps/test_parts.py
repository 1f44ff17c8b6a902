"""Steps of the start: which samples count, and what integrability leaves open."""

from __future__ import annotations

import numpy as np
import pytest

from lamp_scenes import around, relief
from pbrfit.fit.lamps.integrability import equations
from pbrfit.fit.lamps.photometric import DARK, weights_of
from pbrfit.fit.sampling import drawn


def test_samples_just_below_dark_say_nothing_and_just_above_do() -> None:
    for share, counts in ((0.9 * DARK, False), (1.1 * DARK, True)):
        samples = np.ones((1, 6))
        samples[0, 0] = share
        weights = weights_of(samples, np.ones((1, 6), bool), samples, 1.0)
        assert (weights[0, 0] > 0) == counts


@pytest.mark.parametrize("fov", [0.0, 50.0])
def test_normals_of_a_surface_fulfil_the_equations_of_integrability(fov: float) -> None:
    scene = relief(around(3, 40), size=96, fov=fov)
    rng = np.random.default_rng(0)
    G = rng.normal(size=(3, 3))
    vectors = scene.normals @ np.linalg.inv(G)
    C = np.linalg.inv(G).T * np.linalg.det(G)
    blocks = np.zeros(scene.mask.shape, np.intp)

    def covariances(row: np.ndarray, _: np.ndarray) -> np.ndarray:
        return np.broadcast_to(np.eye(3), (len(row), 3, 3))

    found = equations(vectors, covariances, scene.mask, scene.views, blocks)

    def ratio(C: np.ndarray) -> float:
        c = C.T.ravel()
        return float(c @ found.squares @ c / (c @ found.noise @ c))

    true = ratio(C)
    assert true < 1e-3 * ratio(rng.normal(size=(3, 3)))
    # Without perspective the third column is free: the generalised bas-relief ambiguity.
    C[:, 2] += [0.5, -1.0, 0.3]
    assert (ratio(C) < 2 * true) == (fov == 0)


def test_pixels_are_drawn_by_their_shares_and_stand_for_the_rest() -> None:
    shares = np.random.default_rng(0).uniform(1, 9, 5000)
    shares[1234] = 1e3
    rows, counts = drawn(shares, 400)
    assert 300 < len(rows) <= 400
    assert counts[rows == 1234].tolist() == [1]  # it is sure to be there, and stands for itself
    assert counts.sum() == pytest.approx(5000, rel=0.05)
    np.testing.assert_array_equal(drawn(np.ones(30), 400), [np.arange(30), np.ones(30)])
