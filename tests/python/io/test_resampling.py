"""Averages over areas."""

from __future__ import annotations

import numpy as np
import pytest

from pbrfit.io.resampling import averaged, reduced_size


@pytest.mark.parametrize(
    ("old", "new"), [((12, 8), (4, 4)), ((7, 5), (3, 2)), ((10, 15), (4, 6)), ((3, 2), (7, 5))]
)
def test_parts_of_pixels_count_by_their_area(old: tuple[int, int], new: tuple[int, int]) -> None:
    plane = np.random.default_rng(0).normal(size=old)
    # Each old pixel as so many equal parts that whole numbers of them fall on each new one.
    parts = plane.repeat(new[0], axis=0).repeat(new[1], axis=1)
    expected = parts.reshape(new[0], old[0], new[1], old[1]).mean(axis=(1, 3))
    np.testing.assert_allclose(averaged(plane, new), expected, atol=1e-14)


def test_the_same_size_changes_nothing() -> None:
    plane = np.random.default_rng(0).normal(size=(3, 5))
    np.testing.assert_array_equal(averaged(plane, (3, 5)), plane)


def test_what_is_not_finite_stays_where_it_is() -> None:
    plane = np.ones((9, 9))
    plane[4, 0], plane[8, 8] = np.nan, np.inf
    small = averaged(plane, (4, 4))
    finite = np.ones((4, 4), bool)
    finite[1:3, 0] = finite[3, 3] = False  # row 4 of 9 is the middle: two new rows share it
    np.testing.assert_array_equal(np.isfinite(small), finite)
    np.testing.assert_allclose(small[finite], 1.0, atol=1e-15)


@pytest.mark.parametrize(
    ("shape", "side", "expected"),
    [
        ((24, 24), 24, (24, 24)),
        ((24, 24, 3), 23, (23, 23)),
        ((2, 300), 100, (1, 100)),
        ((300, 2), 100, (100, 1)),
        ((480, 640), 320, (240, 320)),
    ],
)
def test_proportions_are_kept(shape: tuple[int, ...], side: int, expected: tuple[int, int]) -> None:
    assert reduced_size(shape, side) == expected
