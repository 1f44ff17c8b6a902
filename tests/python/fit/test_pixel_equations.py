"""Derivatives of pixels, and what is made of them, against the slow reference."""

from __future__ import annotations

import numpy as np
import pytest

import reference
from random_pixels import Array, Example, Kind
from shared_system import check_equations, close

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


@every_kind
def test_derivatives_and_equations_are_those_of_the_reference(kind: Kind) -> None:
    example = Example(kind, 150, 6, noise=0.3, grazing=kind.free_normals)
    if kind.free_normals:
        cosine = np.sum(example.normals * example.views, axis=1)
        assert np.count_nonzero(cosine < CLAMP) > 10
        assert np.count_nonzero(np.abs(cosine - CLAMP) < 0.1) > 10
    check_equations(example, PIXELS)


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
        close(by_unknowns[..., 3 + axis], slope, 1e-5)
