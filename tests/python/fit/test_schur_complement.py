"""The system of what pixels share, these solved for, against a dense and slow one by numpy."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from shared_system import PIXELS, REACH, Dense, Seen, System, accuracy, close, dense

KINDS = {
    "plain": System(),
    "held at bounds": System(bounds=True),
    "held at bounds, with prior and damped": System(bounds=True, prior=True, damping=1e-3),
    "with prior, known metallic": System(prior=True, metallic=0.3),
    "clusters": System(prior=True, clusters=5),
    "one cluster, damped, known metallic, mono": System(
        prior=True, clusters=2, damping=0.3, metallic=0.3, mono=True
    ),
    "clusters, held at bounds, weighted, grey": System(
        prior=True, clusters=9, bounds=True, weights=3, channels=1
    ),
    "clusters, free normals": System(prior=True, clusters=4, free_normals=True, damping=1e-3),
    "clusters, known lights": System(prior=True, clusters=3, known_lights=True),
    "mono, damped, weighted": System(mono=True, damping=1e-2, weights=2),
    "grey, order 2, known metallic, weighted": System(
        channels=1, sh_order=2, metallic=0.6, weights=2, prior=True
    ),
    "order 2": System(sh_order=2, damping=1e-3),
    "known lights": System(known_lights=True),
    "free normals": System(free_normals=True, damping=1e-3),
    "free normals, held at bounds, mono": System(
        free_normals=True, bounds=True, mono=True, damping=1e-2
    ),
    "free normals, known metallic, weighted": System(
        free_normals=True, metallic=0.3, weights=3, damping=1e-3
    ),
    "free normals, grey, with prior, known metallic": System(
        free_normals=True, channels=1, sh_order=2, metallic=0.6, weights=2, prior=True
    ),
}


@cache
def expected_of(kind: str) -> tuple[Seen, Dense]:
    """An example of a kind, and the system of its pixels."""
    example = Seen(KINDS[kind])
    return example, dense(example, example.chosen)


@pytest.mark.parametrize("kind", KINDS)
def test_products_are_those_of_the_whole_system(kind: str) -> None:
    example, expected = expected_of(kind)
    moves = example.moves()
    kept = example.ask("kept_system")
    close(kept.product(moves), expected.matrix @ moves, max(1e-5, accuracy(example.kind)))
    close(kept.gradient, expected.gradient, accuracy(example.kind))
    np.testing.assert_array_equal(kept.product(0 * moves), 0 * moves)


@pytest.mark.parametrize("kind", KINDS)
def test_pixels_follow_the_lights_as_the_whole_system_says(kind: str) -> None:
    example, expected = expected_of(kind)
    moves = example.moves()
    found = example.ask("back_substitute", moves)
    of_material = example.kind.of_material
    before = example.unknowns(example.truth)[example.chosen]
    steps = expected.steps(moves, of_material)
    if example.kind.free_normals:
        lengths = np.linalg.norm(steps[:, of_material:], axis=1)
        assert 0.02 < np.mean(lengths > REACH - 1e-9) < 0.98
    after = before + steps
    if example.kind.bounds:
        held = (expected.forward == 0) & ~expected.follow.any(axis=2)
        assert 10 < np.count_nonzero(held) < held.size / 4
        np.testing.assert_array_equal(found[held], before[held])
    assert (found[:, :of_material] >= 0).all()
    assert (found[:, :of_material] <= 1).all()
    # What leaves its bounds far behind comes of a nearly singular pixel; it is clipped.
    after[:, :of_material] = np.clip(after[:, :of_material], 0, 1)
    np.testing.assert_allclose(found, after, rtol=0, atol=1e-7)


def test_offsets_grow_no_longer_than_tan_60_degrees() -> None:
    example = Seen(KINDS["free normals"])
    longest = np.sqrt(3)
    angles = np.random.default_rng(1).uniform(0, 2 * np.pi, PIXELS)
    lengths = np.where(np.arange(PIXELS) % 2, longest - 0.1, longest + 0.5)
    example.offsets = lengths[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    pixels = np.arange(PIXELS, dtype=np.uint64)
    # Moves that are large for the lights, so that all steps are as long as they may be.
    moves = 1e3 * example.moves()
    found = example.problem().back_substitute(example.x(), pixels, moves, damping=1e-3)[:, -2:]
    after = np.linalg.norm(found, axis=1)
    assert (after <= np.maximum(longest, lengths) * (1 + 1e-12)).all()
    assert np.count_nonzero(after > np.maximum(longest, lengths) * (1 - 1e-12)) > PIXELS / 5
    assert np.linalg.norm(found - example.offsets, axis=1).max() < REACH * (1 + 1e-12)


def test_pixels_that_nothing_is_known_about_stay() -> None:
    """Black ones, dark lights, a material without a slope, a pixel without weight: no NaN."""
    example = Seen(System(weights=2))
    assert example.weights is not None
    example.targets[0] = 0
    example.weights[:, 1] = 0
    example.truth[2:4] = 0, 0, 0, 0, 0
    example.truth[4:6] = 1, 1, 1, 1, 1
    example.truth[6] = 0.5, 0.5, 0.5, 0.0, 1.0
    pixels = np.arange(8, dtype=np.uint64)
    expected = dense(example, pixels)
    matrix, gradient = example.problem().schur_complement(example.x(), pixels)
    close(matrix, expected.matrix, 1e-8)
    close(gradient, expected.gradient, 1e-8)
    moves = example.moves()
    kept = example.problem().kept_system(example.x(), pixels)
    close(kept.product(moves), expected.matrix @ moves, 1e-5)
    followed = example.problem().back_substitute(example.x(), pixels, moves)
    np.testing.assert_array_equal(followed[1], example.truth[1])
    assert followed[6, 3] == 0  # the slope by roughness is r³

    example.lights[:] = 0
    problem = example.problem()
    matrix, gradient = problem.schur_complement(example.x(), pixels)
    assert np.isfinite(matrix).all()
    assert np.isfinite(gradient).all()
    np.testing.assert_array_equal(
        problem.back_substitute(example.x(), pixels, np.zeros(example.size)), example.truth[:8]
    )
