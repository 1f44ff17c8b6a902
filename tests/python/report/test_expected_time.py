"""What is said about time before a fit, against what `pbrfit decompose` took."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pbrfit import Scene
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.report.inspection import expected_seconds, facts
from pbrfit.scene.options import ReadOptions
from pbrfit.scene.reading import load
from pbrfit.synthetic import make_scene

MEASURED = [
    *((True, 4096, 8, 4.7), (True, 16384, 16, 6.9), (True, 16384, 64, 12.4)),
    *((True, 65536, 6, 10.2), (True, 262144, 4, 19.1), (False, 83780, 6, 40.0)),
    *((False, 95432, 6, 28.0), (False, 45200, 24, 43.7), (False, 165825, 12, 36.3)),
    *((False, 224256, 20, 69.4), (False, 262144, 5, 66.1), (False, 262144, 8, 40.8)),
    *((False, 262144, 5, 83.0), (False, 213793, 16, 106.7)),
]
"""Whether normals were given, valid pixels, pictures, seconds of processor time."""


@pytest.mark.parametrize("suffix", ["jpg", "png"])
def test_pictures_are_looked_at_smaller_and_a_fit_is_told_whole(
    tmp_path: Path, suffix: str
) -> None:
    rng, exif = np.random.default_rng(1), Image.Exif()
    exif[0x0112] = 3
    for i in range(6):
        codes = rng.integers(60, 140, (16, 20, 1)).repeat(20, axis=0).repeat(20, axis=1)
        codes = np.rint(codes + rng.normal(0, 3, (320, 400, 3))).astype(np.uint8)
        Image.fromarray(codes).save(tmp_path / f"{i}.{suffix}", quality=95, exif=exif)
    looked, small = load(tmp_path, Scene, look=100), Scene.load(tmp_path, max_size=100)
    assert looked.images.shape == (6, 80, 100, 3)
    np.testing.assert_allclose(looked.images, small.images, atol=0.03)
    told, whole = dict(facts(looked)), dict(facts(Scene.load(tmp_path)))
    assert told["pictures"] == "6 of 400 × 320 pixels; values are of their means over 100 × 80"
    for topic in ("mask", "unknowns", "time needed", "memory needed", "assumed color"):
        assert told[topic] == whole[topic]
    assert "assumed size" not in told
    smaller = dict(facts(load(tmp_path, Scene, ReadOptions(max_size=250), look=100)))
    assert smaller["assumed size"] == "averaged down from 400 × 320 to 250 × 200 pixels"
    assert smaller["pictures"].startswith("6 of 250 × 200 pixels; values")


@pytest.mark.parametrize(("known", "pixels", "pictures", "seconds"), MEASURED)
def test_expected_time_is_mostly_right_within_half(
    known: bool, pixels: int, pictures: int, seconds: float
) -> None:
    few = ParameterLayout.of(make_scene("textured", size=8, lights=2))
    layout = replace(few, valid=np.ones((1, pixels), bool), pictures=pictures)
    assert seconds / 1.6 < expected_seconds(layout, normals_known=known) < 1.6 * seconds
