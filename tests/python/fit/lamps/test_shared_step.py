"""A step of what all pixels share, against the whole system."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import block_diag, null_space

from pbrfit.fit.lamps.joint import step_of

System = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]

PICTURES, PIXELS, OWN = 12, 9, 4
EACH = 3
"""Unknowns of a picture; the first two are held to the sphere, the third is of one sum."""

NOWHERE = np.zeros((PICTURES * EACH, 0)), np.zeros((0, PICTURES * EACH))


def system(rng: np.random.Generator) -> System:
    """Of Jacobians at random, where each sample sees one picture's unknowns."""
    size = PICTURES * EACH
    shared, mixed = np.zeros((size, size)), np.zeros((PIXELS, OWN, size))
    own, gradients, gradient = np.zeros((PIXELS, OWN, OWN)), np.zeros((PIXELS, OWN)), np.zeros(size)
    for p in range(PIXELS):
        for i in range(PICTURES):
            of = slice(EACH * i, EACH * (i + 1))
            by_own, by_shared = rng.normal(size=(2, OWN)), rng.normal(size=(2, EACH))
            left = rng.normal(size=2)
            own[p] += by_own.T @ by_own
            shared[of, of] += by_shared.T @ by_shared
            mixed[p][:, of] += by_own.T @ by_shared
            gradients[p] += by_own.T @ left
            gradient[of] += by_shared.T @ left
    return shared, gradient, own, mixed, gradients


def directions(rng: np.random.Generator, *, held: bool) -> tuple[np.ndarray, np.ndarray]:
    of_pictures = [rng.normal(size=(2, 1 + i % 2)) for i in range(PICTURES)]
    along = block_diag(*(block_diag(one, np.eye(1)) for one in of_pictures))
    slopes = np.zeros((int(held), PICTURES * EACH))
    slopes[:, 2::EACH] = rng.uniform(0.5, 2, PICTURES)
    return along, slopes


def expected(given: System, basis: np.ndarray, damping: float) -> np.ndarray:
    """All unknowns in one matrix, the shared ones first."""
    shared, gradient, own, mixed, gradients = given
    free, pixels = basis.shape[1], PIXELS * OWN
    whole = np.zeros((free + pixels, free + pixels))
    whole[:free, :free] = basis.T @ shared @ basis
    for p in range(PIXELS):
        at = slice(free + p * OWN, free + (p + 1) * OWN)
        whole[at, at] = own[p] + damping * np.diag(np.diag(own[p]))
        whole[at, :free] = mixed[p] @ basis
        whole[:free, at] = whole[at, :free].T
    right = -np.concatenate([basis.T @ gradient, gradients.ravel()])
    return np.linalg.solve(whole, right)


@pytest.mark.parametrize("held", [False, True])
def test_a_step_solves_the_whole_system(held: bool) -> None:
    rng = np.random.default_rng(0)
    given, (along, slopes) = system(rng), directions(rng, held=held)
    basis = along @ null_space(slopes @ along)
    found = step_of(*given, along, slopes, 0.0)
    assert found is not None
    true = expected(given, basis, 0.0)
    np.testing.assert_allclose(found[0], basis @ true[: basis.shape[1]], rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(found[1].ravel(), true[basis.shape[1] :], rtol=1e-6, atol=1e-8)
    assert (np.abs(slopes @ found[0]) < 1e-8).all()


def test_nothing_moves_without_directions_and_a_singular_system_is_told() -> None:
    given = system(np.random.default_rng(2))
    found = step_of(*given, *NOWHERE, 0.0)
    assert found is not None
    assert not found[0].any()
    np.testing.assert_allclose(
        found[1], -np.linalg.solve(given[2], given[4][..., None])[..., 0], rtol=1e-9
    )
    shared, gradient, own, mixed, gradients = given
    assert step_of(shared, gradient, 0 * own, mixed, gradients, *NOWHERE, 0.0) is None
