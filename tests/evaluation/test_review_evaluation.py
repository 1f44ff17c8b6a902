"""`pbrfit evaluate review`: damages are what they say, and the suite counts right."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pbrfit.io.color import encode_srgb
from pbrfit.registration import alignment
from pbrfit_evaluation.review.figures import Rate
from pbrfit_evaluation.review.pictures import AREA, REPAINTS, SEEN, damaged, relights

VIEW = relights("furnished", "own", 2020, size=160, count=2)


@pytest.mark.parametrize("kind", REPAINTS)
def test_repaints_change_what_they_say(kind: Any) -> None:
    honest = VIEW.images[0]
    changed, amount = damaged(honest, kind, VIEW.segments, np.random.default_rng(1))
    difference = np.abs(encode_srgb(changed.clip(0, 1)) - encode_srgb(honest.clip(0, 1))).mean(-1)
    assert AREA[0] - 0.001 <= amount["area"] <= 0.26
    assert amount["change"] > SEEN
    assert np.mean(difference > 0.05) >= 0.95 * AREA[0]
    assert np.mean(difference > 1e-3) <= amount["area"] + 0.03


def test_shifts_and_warps_move_as_far_as_they_say() -> None:
    rng = np.random.default_rng(2)
    honest = VIEW.images[0]
    moved, amount = damaged(honest, "shift", VIEW.segments, rng)
    found = alignment.compare(alignment.edges(honest), alignment.edges(moved))
    assert found is not None
    assert np.hypot(*found.shift) == pytest.approx(amount["pixels"] * 160 / 512, abs=0.1)
    _, amount = damaged(honest, "warp", VIEW.segments, rng)
    assert 3 <= amount["pixels"] <= 8


def test_rates_and_their_intervals() -> None:
    rate = Rate(1, 10)
    assert rate.share == 0.1
    # Wilson's interval of 1 in 10, as printed in Brown, Cai and DasGupta (2001).
    np.testing.assert_allclose(rate.interval(), (0.0179, 0.4042), atol=2e-4)
    assert np.isnan(Rate(0, 0).share)
