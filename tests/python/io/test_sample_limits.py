"""Limits of samples of other primaries, through the matrix."""

from __future__ import annotations

import numpy as np
import pytest

from pbrfit.io import color
from pbrfit.io.limits import AT_LEAST, AT_MOST, converted


# Display P3 to Rec.709: rows (1.22, −0.22, 0), (−0.04, 1.04, 0), (−0.02, −0.08, 1.10).
@pytest.mark.parametrize(
    ("stored", "expected"),
    [
        ((AT_LEAST, 0, 0), (AT_LEAST, AT_MOST, AT_MOST)),
        ((0, 0, AT_LEAST), (0, 0, AT_LEAST)),
        ((AT_MOST, 0, 0), (AT_MOST, AT_LEAST, AT_LEAST)),
        # All three exceed by the same: so does what they make.
        ((AT_LEAST, AT_LEAST, AT_LEAST), (AT_LEAST, AT_LEAST, AT_LEAST)),
        # What is hidden above may be any amount, what is below at most a code.
        ((AT_LEAST, AT_MOST, 0), (AT_LEAST, AT_MOST, AT_MOST)),
        ((0, 0, 0), (0, 0, 0)),
    ],
)
def test_limits_of_other_primaries(stored: tuple[int, ...], expected: tuple[int, ...]) -> None:
    limits = np.array([[stored]], dtype=np.uint8)
    matrix = color.to_rec709(color.DISPLAY_P3)
    assert tuple(converted(limits, matrix)[0, 0].tolist()) == expected
    assert converted(limits, None) is limits
