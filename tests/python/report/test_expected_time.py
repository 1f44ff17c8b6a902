"""What is said about time before a fit, against what `pbrfit decompose` took."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pbrfit.fit.parameters import ParameterLayout
from pbrfit.report.inspection import expected_seconds
from pbrfit.synthetic import make_scene

MEASURED = [
    *((True, 4096, 8, 4.7), (True, 16384, 16, 6.9), (True, 16384, 64, 12.4)),
    *((True, 65536, 6, 10.2), (True, 262144, 4, 19.1), (False, 83780, 6, 40.0)),
    *((False, 95432, 6, 28.0), (False, 45200, 24, 43.7), (False, 165825, 12, 36.3)),
    *((False, 224256, 20, 69.4), (False, 262144, 5, 66.1), (False, 262144, 8, 40.8)),
    *((False, 262144, 5, 83.0), (False, 213793, 16, 106.7)),
]
"""Whether normals were given, valid pixels, pictures, seconds of processor time."""


@pytest.mark.parametrize(("known", "pixels", "pictures", "seconds"), MEASURED)
def test_expected_time_is_mostly_right_within_half(
    known: bool, pixels: int, pictures: int, seconds: float
) -> None:
    few = ParameterLayout.of(make_scene("textured", size=8, lights=2))
    layout = replace(few, valid=np.ones((1, pixels), bool), pictures=pictures)
    assert seconds / 1.6 < expected_seconds(layout, normals_known=known) < 1.6 * seconds
