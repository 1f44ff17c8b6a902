"""What is said about time before a fit, against what fits took."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pbrfit.fit.parameters import ParameterLayout
from pbrfit.report.inspection import expected_seconds
from pbrfit.synthetic import make_scene

MEASURED = [
    (32, 4, 3.5),
    (32, 16, 4.6),
    (32, 64, 7.4),
    (32, 200, 29.3),
    (128, 4, 4.8),
    (128, 16, 6.0),
    (128, 64, 11.8),
    (512, 4, 12.0),
    (512, 16, 16.4),
]
"""Side, pictures and seconds of processor time of default fits: textured rooms with 1 % noise."""


@pytest.mark.parametrize(("side", "pictures", "seconds"), MEASURED)
def test_expected_time_is_at_most_twice_off(side: int, pictures: int, seconds: float) -> None:
    few = ParameterLayout.of(make_scene("textured", size=8, lights=2))
    layout = replace(few, valid=np.ones((side, side), bool), pictures=pictures)
    assert seconds / 2 < expected_seconds(layout) < 2 * seconds
