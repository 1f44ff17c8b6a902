"""Exposure, tone mapping and the sRGB curve."""

from __future__ import annotations

import numpy as np
import pytest

from pbrfit import InputError
from pbrfit.display.tone import ToneMap, encoded
from pbrfit.io.color import decode_srgb


def test_without_a_tone_map_radiance_is_clipped_and_encoded() -> None:
    shown = decode_srgb(encoded(np.array([-1.0, 0.0, 0.2, 1.0, 7.0])))
    np.testing.assert_allclose(shown, [0, 0, 0.2, 1, 1], atol=1e-12)


def test_a_stop_doubles_radiance() -> None:
    radiance = np.linspace(0, 0.4, 9).reshape(3, 3)
    np.testing.assert_array_equal(encoded(radiance, exposure=1), encoded(2 * radiance))


@pytest.mark.parametrize("tone_map", ["none", "neutral"])
def test_outside_the_mask_stays_nan_and_black_is_black(tone_map: ToneMap) -> None:
    shown = encoded(np.array([[np.nan] * 3, [0.0] * 3]), tone_map=tone_map)
    np.testing.assert_array_equal(shown, [[np.nan] * 3, [0.0] * 3])


def test_neutral_keeps_what_is_no_highlight() -> None:
    # What a white light leaves of a base colour: the colour and 4 % of white.
    colors = np.random.default_rng(0).uniform(0.05, 0.75, (50, 3))
    np.testing.assert_allclose(
        decode_srgb(encoded(colors + 0.04, tone_map="neutral")), colors, atol=1e-12
    )


def test_neutral_is_continuous_rises_and_stays_below_white() -> None:
    radiance = np.linspace(0, 20, 20001)[:, None] * np.array([1.0, 0.6, 0.3])
    shown = encoded(radiance, tone_map="neutral")
    assert np.diff(shown[:, 0]).min() >= 0
    assert np.abs(np.diff(decode_srgb(shown), axis=0)).max() < 2e-3
    assert shown.max() < 1
    # Very bright colours fade to white.
    assert encoded(1e6 * radiance[-1:], tone_map="neutral").min() > 0.99


def test_wrong_options() -> None:
    with pytest.raises(InputError, match="tone_map: expected one of none, neutral, found 'aces'"):
        encoded(np.ones(3), tone_map="aces")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="exposure: expected a number of stops, found nan"):
        encoded(np.ones(3), exposure=float("nan"))
