"""Derivatives of pixels, and what is made of them, against the slow reference."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import reference
from random_pixels import Array, Example, Kind

CLAMP = reference.CLAMP

KINDS = (
    Kind(),
    Kind(weights=3),
    Kind(channels=1, weights=2),
    Kind(sh_order=2, metallic=0.3, weights=3, known_lights=True),
    Kind(free_normals=True),
    Kind(free_normals=True, weights=3, known_lights=True),
    Kind(free_normals=True, metallic=0.3, weights=2),
    Kind(free_normals=True, channels=1, sh_order=2),
    Kind(free_normals=True, channels=1, metallic=0.0),
)
every_kind = pytest.mark.parametrize("kind", KINDS, ids=str)

PIXELS = np.random.default_rng(2).permutation(150)[:140].astype(np.uint64)


def example_of(kind: Kind) -> Example:
    """Whose pictures its materials do not explain."""
    return Example(kind, 150, 6, noise=0.3, grazing=kind.free_normals)


def assert_close(found: NDArray[Any], expected: NDArray[Any], share: float) -> None:
    """Within a share of the largest expected value."""
    assert found.shape == expected.shape
    np.testing.assert_allclose(found, expected, rtol=0, atol=share * np.abs(expected).max())


@every_kind
def test_derivatives_are_those_of_the_reference(kind: Kind) -> None:
    example = example_of(kind)
    if kind.free_normals:
        cosine = np.sum(example.normals * example.views, axis=1)
        assert np.count_nonzero(cosine < CLAMP) > 10
        assert np.count_nonzero(np.abs(cosine - CLAMP) < 0.1) > 10
    by_unknowns, by_light, weights = example.problem().derivatives(example.x(), PIXELS)
    expected, expected_by_light = (part[PIXELS] for part in example.slopes())
    assert_close(by_light, expected_by_light, 1e-12)
    np.testing.assert_array_equal(weights, example.omega[PIXELS])
    assert by_unknowns.shape == expected.shape
    # Of each pixel on its own, unless it is dark beside the others.
    scale = np.abs(expected).max(axis=(1, 2), keepdims=True)
    scale = np.maximum(scale, 1e-4 * scale.max(axis=0))
    assert (np.abs(by_unknowns - expected) <= 1e-12 * scale).all()


@every_kind
def test_normal_equations_are_products_of_derivatives(kind: Kind) -> None:
    example = example_of(kind)
    matrices, gradient, squares = example.problem().normal_equations(example.x(), PIXELS)
    j, w = example.jacobian()[0][PIXELS], example.omega[PIXELS]
    residual = (example.radiance(example.truth) - example.targets)[PIXELS]
    assert_close(matrices, np.einsum("pnci,pnc,pncj->pij", j, w, j), 1e-12)
    assert_close(gradient, np.einsum("pnci,pnc->pi", j, w * residual), 1e-12)
    assert_close(squares, (w * residual**2).sum(axis=(1, 2)), 1e-12)


@every_kind
def test_pixels_move_with_the_lights(kind: Kind) -> None:
    example = example_of(kind)
    rng = np.random.default_rng(3)
    factors = rng.normal(size=(len(PIXELS), kind.unknowns, kind.unknowns))
    covariances = factors @ factors.transpose(0, 2, 1)
    modes = rng.normal(size=(6, *example.lights.shape))
    j, by_light = (part[PIXELS] for part in example.jacobian())
    effects = np.einsum("pnci,pnc,pck,mnkc->pmi", j, example.omega[PIXELS], by_light, modes)
    found = example.problem().moves_with_lights(example.x(), PIXELS, covariances, modes)
    assert_close(found, np.square(effects @ covariances).sum(axis=1), 1e-11)


def test_slopes_at_the_clamp_are_those_of_one_side() -> None:
    """The clamped cosine does not move below the clamp, and moves above; the mirror always does."""
    example = Example(Kind(free_normals=True), 2, degrees=0.0)
    example.views[:] = 0, 0, 1
    for p, cosine in enumerate((CLAMP * 0.9, CLAMP * 1.1)):
        example.given[p] = np.sqrt(1 - cosine**2), 0, cosine
    by_unknowns, _, _ = example.problem().derivatives(example.x(), example.everything)
    step = 1e-7
    for axis in range(2):

        def moved(by: float, axis: int = axis) -> Array:
            offsets = by * np.tile(np.eye(2)[axis], (2, 1))
            return example.radiance(example.truth, reference.turned(example.given, offsets.T))

        slope = (moved(step) - moved(-step)) / (2 * step)
        assert_close(by_unknowns[..., 3 + axis], slope, 1e-5)
