"""Pictures that are there several times: one alone, however often, tells no materials."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pbrfit import Result, Scene, decompose
from pbrfit.result.verdict import levels
from pbrfit.synthetic import make_scene


def fitted(scene: Scene) -> Result:
    return decompose(scene, priors=None, refine_normals="off", light="sh", threads=1)


@pytest.mark.parametrize("pictures", [2, 8])
def test_one_picture_many_times_tells_nothing(pictures: int) -> None:
    """A picture has three numbers a pixel, which has five unknowns: any fit is exact."""
    one = make_scene("room", size=12, lights=2, held_out=1, seed=1)
    images = np.repeat(one.images[:1], pictures, axis=0)
    result = fitted(replace(one, images=images, names=(), truth=None, lighting=None))
    assert result.uncertainty is not None
    for name, level in levels(result.uncertainty.deviation).items():
        assert (level[result.mask] > 0).all(), name
