"""The lamp of one more picture of surfaces that are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pbrfit.fit.lamps.picture_light import fit_picture_light
from pbrfit.model.geometry import angles_between
from pbrfit.model.lamps import Lamps
from pbrfit.result.relighting import rendered_picture
from under_lamps import ball_under_lamps


@pytest.mark.parametrize("ambient_terms", [0, 9])
def test_the_lamp_of_one_more_picture_is_found(ambient_terms: int) -> None:
    result = ball_under_lamps()
    place, color = np.array([[0.36, 0.48, 0.8]]), np.array([[1.1, 0.9, 0.7]])
    lamp = Lamps(np.zeros(1, np.intp), place, colors=color)
    around = np.zeros((1, 16, 3))
    if ambient_terms:
        around[:, :4] = 0.05 * np.random.default_rng(0).normal(size=(1, 4, 3))
        around[:, 0] += 0.2
    picture = rendered_picture(replace(result, lamps=lamp, lighting=around, pictures=("new",)), 0)
    found, ambient = fit_picture_light(result, picture, ambient_terms=ambient_terms)
    assert angles_between(found.places, lamp.places)[0] < 1
    np.testing.assert_allclose(found.colors, lamp.colors, rtol=0.05)
    assert ambient.shape == (16, 3)
    known, _ = fit_picture_light(
        result, picture, direction=lamp.places[0], ambient_terms=ambient_terms
    )
    np.testing.assert_array_equal(known.places, lamp.places)
    np.testing.assert_allclose(known.colors, lamp.colors, rtol=0.05)
