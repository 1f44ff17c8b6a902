"""Transfer curves and primaries against exact arithmetic and published values."""

from __future__ import annotations

from typing import Any, get_args

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import ImageCms

from pbrfit import _core
from pbrfit.io import color


def test_the_srgb_curve_equals_the_standard_in_high_precision() -> None:
    for code in range(256):
        value = mpmath.mpf(code) / 255
        if value <= mpmath.mpf("0.04045"):
            exact = value / mpmath.mpf("12.92")
        else:
            exact = ((value + mpmath.mpf("0.055")) / mpmath.mpf("1.055")) ** mpmath.mpf("2.4")
        np.testing.assert_allclose(color.decode_srgb(code / 255), float(exact), rtol=1e-15)


def test_the_srgb_curve_switches_at_the_published_thresholds() -> None:
    below, above = np.nextafter(0.04045, 0), np.nextafter(0.04045, 1)
    assert color.decode_srgb(below) == below / 12.92
    assert color.decode_srgb(above) == ((above + 0.055) / 1.055) ** 2.4
    below, above = np.nextafter(0.0031308, 0), np.nextafter(0.0031308, 1)
    assert color.encode_srgb(below) == below * 12.92
    assert color.encode_srgb(above) == 1.055 * above ** (1 / 2.4) - 0.055


@given(st.floats(-1e6, 1e6))
def test_encoding_undoes_decoding(value: float) -> None:
    # The two published thresholds do not meet exactly: 3e-8 apart around 0.04045.
    np.testing.assert_allclose(
        color.encode_srgb(color.decode_srgb(value)), value, rtol=1e-12, atol=1e-7
    )


@given(st.floats(0, 1e6))
def test_the_curve_is_odd_and_increasing(value: float) -> None:
    assert color.decode_srgb(-value) == -color.decode_srgb(value)
    assert color.encode_srgb(-value) == -color.encode_srgb(value)
    assert color.decode_srgb(np.nextafter(value, np.inf) + 1e-9) > color.decode_srgb(value)


@pytest.mark.parametrize(
    ("found", "published", "error"),
    [
        # IEC 61966-2-1:1999, equation 7, four digits.
        (
            color.rgb_to_xyz(color.REC709),
            [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]],
            6e-5,
        ),
        # As in the ACES 1.0.3 OpenColorIO configuration (Bradford from D60 to D65).
        (
            color.to_rec709(color.ACES_AP1),
            [
                [1.70505, -0.62179, -0.08326],
                [-0.13026, 1.14080, -0.01055],
                [-0.02400, -0.12897, 1.15297],
            ],
            1e-5,
        ),
        (color.to_rec709(color.REC709), np.eye(3), 1e-14),
    ],
)
def test_matrices_are_those_that_are_published(found: Any, published: Any, error: float) -> None:
    np.testing.assert_allclose(found, published, atol=error)


def test_rec709_is_recognised_up_to_rounding() -> None:
    half = color.Primaries((0.6401, 0.33), (0.30, 0.6001), (0.15, 0.06), (0.3127, 0.3290))
    assert color.near_rec709(half)
    assert not color.near_rec709(color.DISPLAY_P3)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("space", get_args(color.ColorSpace))
def test_integers_are_decoded_as_their_fractions_are(
    dtype: type[np.uint8 | np.uint16], space: color.ColorSpace
) -> None:
    top = int(np.iinfo(dtype).max)
    codes: NDArray[Any] = np.random.default_rng(1).integers(0, top + 1, (8, 9, 3)).astype(dtype)
    codes[0, 0], codes[0, 1] = 0, top
    convert = color.conversion(space)
    np.testing.assert_allclose(convert(codes), convert(codes / top), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("levels", [256, 65536])
def test_an_srgb_profile_agrees_with_the_exact_curve(levels: int) -> None:
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    curves, to_xyz = _core.decode_icc(profile, levels, "srgb.icc")
    exact = color.decode_srgb(np.arange(levels) / (levels - 1))
    for curve in curves:
        np.testing.assert_allclose(curve, exact, rtol=2e-4, atol=5e-6)
    assert to_xyz is not None
    np.testing.assert_allclose(
        color.colorants_to_rec709(to_xyz, color.ICC_D50), np.eye(3), atol=5e-5
    )
    convert = color.from_icc(curves, to_xyz)
    assert convert.matrix is None
