"""The double-precision path against 25-digit values, our own and, where present, the shared."""

from __future__ import annotations

import json
from decimal import Decimal
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import pbrfit

# Whatever the default is.
shade = partial(pbrfit.kernel.shade, model="paper")
shade_vjp = partial(pbrfit.kernel.shade_vjp, model="paper")

Array = NDArray[np.floating[Any]]

OWN_DATA = Path(__file__).resolve().parents[2] / "data"


@pytest.fixture(params=["own", "shared"])
def folder(request: pytest.FixtureRequest) -> Path:
    if request.param == "own":
        return OWN_DATA
    shared: Path = request.getfixturevalue("shared_data")
    return shared / "golden"


def read(path: Path, key: str) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))[key]
    return rows


def errors(found: Array, stated: list[Any]) -> Array:
    """|found − stated| with the subtraction done in decimal: 1e-14 of 4 is 22 float spacings."""
    exact = np.array(stated, dtype=object)
    assert found.shape == exact.shape
    assert np.isfinite(found).all()
    difference = [
        abs(Decimal(float(a)) - Decimal(b)) for a, b in zip(found.flat, exact.flat, strict=True)
    ]
    return np.array(difference, dtype=np.float64).reshape(found.shape)


@pytest.mark.parametrize(("column", "bar"), [("h", 1e-14), ("dh_dr", 5e-14)])
def test_band_weights(folder: Path, column: str, bar: float) -> None:
    rows = read(folder / "bands.json", "rows")
    r = np.array([row["r"] for row in rows])
    h, dh_dr = pbrfit.kernel.ggx_band_weights(r)
    error = errors({"h": h, "dh_dr": dh_dr}[column], [row[column] for row in rows])
    worst, band = np.unravel_index(np.argmax(error), error.shape)
    assert error.max() <= bar, f"{column}[{band}] at r = {r[worst]!r} misses by {error.max():.3g}"


@pytest.mark.parametrize(
    "quantity", ["weights", "radiance", "d_albedo", "d_roughness", "d_metallic", "d_normal"]
)
def test_shading(folder: Path, quantity: str) -> None:
    # d_normal is not stated where rounding decides on which side of the clamp n·v is, and in older
    # files nowhere.
    cases = [case for case in read(folder / "shading.json", "cases") if quantity in case]
    if not cases and folder != OWN_DATA:
        pytest.skip(f"{folder} does not state {quantity}")

    def stacked(key: str) -> Array:
        return np.array([np.array(case[key], dtype=np.float64) for case in cases])

    inputs = ("normal", "view", "albedo", "roughness", "metallic")
    pixels: dict[str, Any] = {name: stacked(name) for name in inputs}
    lighting = stacked("lighting").swapaxes(1, 2)  # (cases, 3, 16)
    weights = shade(**pixels)
    # One cotangent a channel, so that the derivatives come out channel by channel.
    cotangent = np.eye(3)[:, :, None] * lighting[:, None]
    d_albedo, d_roughness, d_metallic, d_normal = shade_vjp(
        **{name: array[:, None] for name, array in pixels.items()}, cotangent=cotangent
    )
    other_channels = d_albedo * (1 - np.eye(3))
    assert not other_channels.any(), "a channel's radiance depends on another channel's albedo"
    found = {
        "weights": weights,
        "radiance": np.sum(weights * lighting, axis=-1),
        "d_albedo": d_albedo.sum(axis=-1),
        "d_roughness": d_roughness,
        "d_metallic": d_metallic,
        "d_normal": d_normal,
    }[quantity]
    error = errors(found, [case[quantity] for case in cases]).reshape(len(cases), -1).max(axis=1)
    exact = np.abs(stacked(quantity)).reshape(len(cases), -1).max(axis=1)
    missed = error / np.maximum(1, exact)
    worst = int(np.argmax(missed))
    assert missed.max() <= 1e-12, f"{quantity} of case {worst} misses by {missed.max():.3g}"
