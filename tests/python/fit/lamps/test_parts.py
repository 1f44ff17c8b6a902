"""The steps of the start, each against what physics or algebra says of it."""

from __future__ import annotations

import numpy as np
import pytest

from lamp_scenes import LampScene, around, ball, relief
from pbrfit.fit.lamps.integrability import equations
from pbrfit.fit.lamps.outline import outline
from pbrfit.fit.lamps.photometric import DARK, Factors, factors, pseudo_normals, weights_of
from pbrfit.fit.lamps.samples import brightness


def sine_between(first: np.ndarray, second: np.ndarray) -> float:
    """Largest, between the spaces of two (N, 3)."""
    bases = [np.linalg.qr(one)[0] for one in (first, second)]
    return float(np.sqrt(max(0, 1 - np.linalg.svd(bases[0].T @ bases[1])[1].min() ** 2)))


def across(normals: np.ndarray) -> np.ndarray:
    """Unit vectors (P, 2) of normals' azimuth, seen along z."""
    return np.asarray(normals[:, :2] / np.linalg.norm(normals[:, :2], axis=1, keepdims=True))


def factors_of(scene: LampScene) -> Factors:
    grey = scene.samples.mean(axis=-1)[:, scene.mask].T
    usable = np.asarray(scene.usable.all(axis=-1))[:, scene.mask].T
    return factors(grey / brightness(grey, usable)[:, None], usable)


def test_highlights_and_cast_shadows_leave_pseudo_normals_as_they_are() -> None:
    rng = np.random.default_rng(0)
    lamps = around(12, 40, 15)
    truth = around(200, 20, 20, seed=1) * rng.uniform(0.2, 0.8, (200, 1))
    samples = np.maximum(truth @ lamps.T, 0)
    for p in range(200):
        bright, dark = np.split(rng.choice(12, 5, replace=False), [2])
        samples[p, bright] += rng.uniform(0.5, 5, 2)
        samples[p, dark] = 0.0
    bright = np.median(samples, axis=1, keepdims=True)
    found = pseudo_normals(samples / bright, np.ones_like(samples, bool), lamps)
    np.testing.assert_allclose(found.vectors * bright, truth, atol=1e-3)


def test_samples_just_below_dark_say_nothing_and_just_above_do() -> None:
    for share, counts in ((0.9 * DARK, False), (1.1 * DARK, True)):
        samples = np.ones((1, 6))
        samples[0, 0] = share
        weights = weights_of(samples, np.ones((1, 6), bool), samples, 1.0)
        assert (weights[0, 0] > 0) == counts


def test_the_factors_span_the_space_of_the_lamps_beside_gloss_and_shadows() -> None:
    scene = ball(around(10, 45, 15), gloss=0.5)
    found = factors_of(scene)
    assert found.rank == 3
    assert sine_between(found.lamps, scene.directions) < 0.01


@pytest.mark.parametrize(("height", "rank"), [(0.0, 2), (0.2, 3)])
def test_the_rank_is_that_of_the_lamps(height: float, rank: int) -> None:
    angle = np.radians(np.linspace(-50, 50, 8))
    lamps = np.stack([np.sin(angle), 0 * angle + height, np.cos(angle)], axis=1)
    scene = ball(lamps / np.linalg.norm(lamps, axis=1, keepdims=True))
    found = factors_of(scene)
    # A constant height is a cone about the vertical: with 0 it is a plane.
    assert found.rank == rank


@pytest.mark.parametrize("fov", [0.0, 50.0])
def test_normals_of_a_surface_fulfil_the_equations_of_integrability(fov: float) -> None:
    scene = relief(around(3, 40), size=96, fov=fov)
    rng = np.random.default_rng(0)
    G = rng.normal(size=(3, 3))
    vectors = scene.normals @ np.linalg.inv(G)
    C = np.linalg.inv(G).T * np.linalg.det(G)
    blocks = np.zeros(scene.mask.shape, np.intp)
    covariances = np.broadcast_to(np.eye(3), (*scene.mask.shape, 3, 3))
    found = equations(vectors, covariances, scene.mask, scene.views, blocks)

    def ratio(C: np.ndarray) -> float:
        c = C.T.ravel()
        return float(c @ found.squares @ c / (c @ found.noise @ c))

    true = ratio(C)
    assert true < 1e-3 * ratio(rng.normal(size=(3, 3)))
    # Without perspective the third column is free: the generalised bas-relief ambiguity.
    C[:, 2] += [0.5, -1.0, 0.3]
    assert (ratio(C) < 2 * true) == (fov == 0)


def test_the_outline_of_a_ball_points_outwards_and_the_border_of_a_picture_is_none() -> None:
    scene = ball(around(3, 40))
    edge = outline(scene.mask, scene.views)
    true = scene.normals[edge.rows, edge.columns]
    assert (
        np.degrees(np.arccos(np.clip((across(true) * across(edge.normals)).sum(1), -1, 1))).max()
        < 6
    )
    assert np.abs(edge.normals[:, 2] - true[:, 2]).mean() < 0.1
    cut = outline(scene.mask[:40], scene.views[:40])
    assert cut.rows.max() < 40
    assert (across(cut.normals)[cut.rows == 39, 0] ** 2 > 0.8).all()
    assert len(outline(np.ones((20, 20), bool), scene.views[:20, :20])) == 0
