"""Maps of a result, and tables, as the viewer gets them: small, in whole numbers, packed."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import lobe_table
from pbrfit.model.geometry import unit, view_directions
from pbrfit.model.materials import Materials
from pbrfit.report.html import in_base64
from pbrfit.report.raster import reduced
from pbrfit.result.result import Result
from pbrfit.values.arrays import Array, Mask


@dataclass(frozen=True)
class Maps:
    """Maps of (H, W) pixels, NaN outside the mask."""

    materials: Materials
    normals: Array
    mask: Mask
    fov: float
    """As of a result."""


def of_result(result: Result, max_side: int) -> Maps:
    """Maps with at most `max_side` pixels on the longer side.

    Larger ones are averaged over the area that falls on each new pixel, its part in the mask alone,
    and normals made unit vectors again. A new pixel is valid if half of its area is.
    """
    normals = reduced(result.normals, max_side)
    length = np.linalg.norm(normals, axis=-1)
    # Opposite normals may cancel: such a pixel has no direction, and is shown as outside.
    mask = length > 1e-6
    normals = np.where(mask[..., None], normals / np.where(mask, length, 1.0)[..., None], np.nan)
    materials = result.materials.each(lambda plane: reduced(plane, max_side)).within(mask)
    return Maps(materials, normals, mask, result.fov)


LARGEST = {
    "normal_u": 65534,  # even, so that 0, and with it the normal (0, 0, 1), is met exactly
    "normal_v": 65534,
    "roughness": 16383,
    "green": 4095,
    "red": 4095,
    "blue": 4095,
    "metallic": 16383,
}
"""Largest code of each plane, in the order of packing; smaller ones are shares of it.

Normals are octahedral, and need all bits: where a panorama has a lamp beside darkness, what is
almost black shows an error in the last. Albedo is stored as its square root, which spends codes on
dark colours as the eye does, and is undone exactly by any graphics chip. Red and blue are stored as
differences from green: where colours are weak, and in grey pictures, these are small."""

FACING = "facing"
"""Last plane: 0 outside the mask; inside, MIDDLE plus what n·v of the stored normal lacks.

Seen at a grazing angle, G1 of a smooth surface falls from 1 to 0 within n·v of r⁴: there the error
of a stored normal, up to 6e-5, would show as one of 5 in 255."""

FACING_UNIT = 1e-7
GRAZING = 0.1
"""Where n·v is above this the correction is left out, which makes the plane small."""

MIDDLE = 1 << 15

UNITS = {**{name: 1 / largest for name, largest in LARGEST.items()}, FACING: FACING_UNIT}
"""What one code of each plane is worth, in the order of packing."""


def packed(maps: Maps) -> bytes:
    """All planes of `UNITS`, packed."""
    planes = codes(maps)
    return deflated(planes[name] for name in UNITS)


def deflated(planes: Iterable[NDArray[np.uint16]]) -> bytes:
    """Planes of codes, each as its prediction errors, as one zlib stream.

    A code is predicted from its left (a), upper (b) and upper left (c) neighbours as the median of
    a, b and a + b − c (Weinberger et al., "LOCO-I", 1996). Errors e, modulo 2^16 and in -2^15 ...
    2^15 − 1, are stored as 2e or −2e − 1, all high bytes of a plane before all low bytes.
    """
    # Errors have no repeating strings to look for, only runs: Z_RLE is 40 times as fast as the best
    # search, and 1 to 4 % smaller.
    deflate = zlib.compressobj(6, zlib.DEFLATED, zlib.MAX_WBITS, 9, zlib.Z_RLE)
    packed = b"".join(deflate.compress(prediction_errors(plane)) for plane in planes)
    return packed + deflate.flush()


def codes(maps: Maps) -> dict[str, NDArray[np.uint16]]:
    """Whole numbers (H, W) by the names of `UNITS`."""
    normals = np.where(maps.mask[..., None], maps.normals, (0.0, 0.0, 1.0))
    flat = normals[..., :2] / np.sum(np.abs(normals), axis=-1, keepdims=True)
    # The lower half of the octahedron is folded outwards.
    sign = np.where(flat >= 0, 1.0, -1.0)
    folded = np.where(normals[..., 2:] < 0, (1 - np.abs(flat[..., ::-1])) * sign, flat)
    root = np.sqrt(maps.materials.albedo)
    shares = {
        "normal_u": 0.5 + 0.5 * folded[..., 0],
        "normal_v": 0.5 + 0.5 * folded[..., 1],
        "roughness": maps.materials.roughness,
        "green": root[..., 1],
        "red": root[..., 0],
        "blue": root[..., 2],
        "metallic": maps.materials.metallic,
    }
    found = {
        name: np.rint(np.where(maps.mask, share, 0.0) * LARGEST[name]).astype(np.uint16)
        for name, share in shares.items()
    }
    height, width = maps.mask.shape
    views = view_directions(height, width, maps.fov)
    facing = np.sum(normals * views, axis=-1)
    lacking = facing - np.sum(_unfolded(found) * views, axis=-1)
    correction = np.rint(np.where(np.abs(facing) < GRAZING, lacking, 0.0) / FACING_UNIT)
    found[FACING] = np.where(maps.mask, MIDDLE + correction, 0).astype(np.uint16)
    for name in ("red", "blue"):
        found[name] = found[name] - found["green"] + np.uint16(MIDDLE)
    return found


def _unfolded(found: dict[str, NDArray[np.uint16]]) -> Array:
    """Normals (H, W, 3) as the shader finds them in the codes."""
    flat = np.stack([2 * UNITS[name] * found[name] - 1 for name in ("normal_u", "normal_v")], -1)
    up = 1 - np.sum(np.abs(flat), axis=-1, keepdims=True)
    flat = flat - np.where(flat >= 0, 1.0, -1.0) * np.maximum(-up, 0)
    return unit(np.concatenate([flat, up], axis=-1))


def prediction_errors(plane: NDArray[np.uint16]) -> bytes:
    """Prediction errors of a plane of codes (H, W): its high bytes, then its low bytes."""
    padded = np.pad(plane.astype(np.int64), ((1, 0), (1, 0)))
    a, b, c = padded[1:, :-1], padded[:-1, 1:], padded[:-1, :-1]
    predicted = np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), a + b - c))
    error = (padded[1:, 1:] - predicted + (1 << 15)) % (1 << 16) - (1 << 15)
    stored = np.where(error >= 0, 2 * error, -2 * error - 1).astype(np.uint16)
    high, low = (stored >> 8).astype(np.uint8), (stored & 255).astype(np.uint8)
    return bytes(high.tobytes() + low.tobytes())


HEADER = struct.Struct("<8s2I4f")
STORED = 24
FUNCTIONS = 22

CODES = 65535
"""Largest code; 0 is a function's least coefficient."""


def lobes() -> dict[str, Any]:
    """What the page holds, as JSON: `axes`, `low`, `step` and `codes`.

    The functions are cubic B-splines over s(n·v) and t(r), w(1+c) x/(x+c) + (1−w) x with a c and w
    of their own (tools/lobe_table.py). `axes` are their numbers of cells, c and w. A coefficient is
    `low` plus `step` times its code. `codes` is a zlib stream in base64, prediction errors as in
    `packed`: a plane of n·v (columns) and r (rows) for each function.
    """
    table = lobe_table()
    _, by_r, by_cosine, *bends = HEADER.unpack_from(table)
    stored = np.frombuffer(table, "<f4", offset=HEADER.size).astype(np.float64)
    coefficients = stored.reshape(by_r + 3, by_cosine + 3, STORED)
    planes = np.moveaxis(coefficients[..., :FUNCTIONS], -1, 0)
    low = [float(plane.min()) for plane in planes]
    step = [float(np.ptp(plane)) / CODES for plane in planes]
    codes = deflated(
        np.rint((plane - least) / unit).astype(np.uint16)
        for plane, least, unit in zip(planes, low, step, strict=True)
    )
    axes = [(by_cosine, *bends[2:]), (by_r, *bends[:2])]
    return {"axes": axes, "low": low, "step": step, "codes": in_base64(codes)}
