"""Maps of the relight view: averaged down, in whole numbers, packed; no browser needed."""

from __future__ import annotations

import base64
import dataclasses
import io
import json
import math
import re
import zlib

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from pbrfit import Scene
from pbrfit.display.tone import encoded
from pbrfit.kernel import ggx_band_weights
from pbrfit.model.geometry import unit, view_directions
from pbrfit.report.viewer import BAND_NODES, film, fragment, maps
from pbrfit.result import metrics
from relight_view import made


def unpacked(packed: bytes, height: int, width: int) -> dict[str, NDArray[np.int64]]:
    """Undo `maps.packed` as slowly and plainly as its description is worded."""
    content = np.frombuffer(zlib.decompress(packed), np.uint8).reshape(len(maps.UNITS), 2, -1)
    planes = {}
    for name, (high, low) in zip(maps.UNITS, content.astype(np.int64), strict=True):
        plane = np.zeros((height + 1, width + 1), np.int64)
        for i, stored in enumerate(256 * high + low):
            y, x = i // width + 1, i % width + 1
            a, b, c = plane[y, x - 1], plane[y - 1, x], plane[y - 1, x - 1]
            error = stored // 2 if stored % 2 == 0 else -(stored + 1) // 2
            plane[y, x] = (sorted((a, b, a + b - c))[1] + error) % 65536
        planes[name] = plane[1:, 1:]
    for name in ("red", "blue"):
        planes[name] = (planes[name] + planes["green"] - 32768) % 65536
    return planes


def test_what_is_unpacked_is_the_maps_to_within_half_a_code() -> None:
    mask = np.arange(12 * 17).reshape(12, 17) % 6 > 0
    result = made(12, 17, mask=mask)
    codes = unpacked(maps.packed(maps.of_result(result, 1024)), 12, 17)
    np.testing.assert_array_equal(codes["facing"] > 0, mask)
    for name, plane in (
        ("roughness", result.roughness),
        ("metallic", result.metallic),
        ("red", np.sqrt(result.albedo[..., 0])),
        ("green", np.sqrt(result.albedo[..., 1])),
        ("blue", np.sqrt(result.albedo[..., 2])),
    ):
        apart = np.abs(codes[name] * maps.UNITS[name] - plane)[mask]
        assert apart.max() <= 0.5001 * maps.UNITS[name], name

    u, v = (2 * maps.UNITS[name] * codes[name] - 1 for name in ("normal_u", "normal_v"))
    z = 1 - np.abs(u) - np.abs(v)
    x = np.where(z < 0, np.where(u >= 0, 1, -1) * (1 - np.abs(v)), u)
    y = np.where(z < 0, np.where(v >= 0, 1, -1) * (1 - np.abs(u)), v)
    found = unit(np.stack([x, y, z], axis=-1))
    assert np.abs(found - result.normals)[mask].max() < 7e-5
    assert result.normals[mask][:, 2].min() < -0.9

    views = view_directions(12, 17, result.fov)
    facing = np.sum(result.normals * views, axis=-1)
    corrected = np.sum(found * views, axis=-1) + (codes["facing"] - 32768) * maps.FACING_UNIT
    grazing = mask & (np.abs(facing) < 0.1)
    assert grazing.sum() > 5
    assert np.abs(corrected - facing)[grazing].max() <= 0.5001e-7
    assert (codes["facing"][mask & ~grazing] == 32768).all()


def test_normals_that_cancel_each_other_are_left_out() -> None:
    result = made(2, 2)
    normals = np.zeros((2, 2, 3))
    normals[..., 2] = [[1, -1], [-1, 1]]
    cancelling = dataclasses.replace(result, normals=normals)
    small = maps.of_result(cancelling, 1)
    assert not small.mask.any()
    assert np.isnan(small.materials.albedo).all()
    assert 'data-state="loading"' in fragment(cancelling, 1)


def test_band_weights_between_the_nodes_are_off_by_less_than_5e_6() -> None:
    embedded = re.search(r'class="relight-data">(.*?)</script>', fragment(made(2, 2)))
    assert embedded is not None
    nodes = np.array(json.loads(embedded[1])["bands"]).reshape(BAND_NODES, 4)
    roughness = np.linspace(0, 1, 50001)
    true, _ = ggx_band_weights(roughness)
    at = np.linspace(0, 1, BAND_NODES)
    for band in range(4):
        found = np.interp(roughness, at, nodes[:, band].astype(np.float32))
        assert np.abs(found - true[:, band]).max() < 5e-6, band


@pytest.mark.parametrize(("size", "kind"), [(20, "png"), (300, "jpeg")])
def test_inputs_are_shown_with_the_98th_percentile_as_white(size: int, kind: str) -> None:
    ramp = np.linspace(0, 4, size, dtype=np.float32)
    images = np.broadcast_to(ramp[None, None, :, None], (2, size, size, 3)) * 1.0
    images[1] *= 8
    images[1, 0, 0] = np.nan
    normals = np.broadcast_to((0.0, 0.0, 1.0), (size, size, 3))
    mask = np.ones((size, size), bool)
    mask[0, 0] = False
    scene = Scene(images, normals, mask=mask)
    whites = [metrics.white_of(image[mask]) for image in scene.images]
    first, second = film.of_scene(scene, whites, 1e9)
    assert first.exposure == pytest.approx(-math.log2(0.98 * 4), abs=0.06)
    assert second.exposure == pytest.approx(first.exposure - 3, abs=0.11)
    assert first.original
    head, _, data = first.address.partition(",")
    assert head == f"data:image/{kind};base64"
    shown = np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB"))
    true = 255 * encoded(np.asarray(scene.images[0], np.float64), first.exposure, "neutral")
    assert np.abs(shown[1:] - true[1:]).max() < (1 if kind == "png" else 12)
    if size > min(film.SIDES):  # they get smaller where they take too much
        [small, _] = film.of_scene(scene, whites, 2 * len(first.address) - 1)
        assert len(small.address) < len(first.address)
