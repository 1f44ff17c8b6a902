"""The core's table of lobe functions, which the principled model needs, packed for the viewer."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np

from pbrfit._core import lobe_table
from pbrfit.report.html import in_base64
from pbrfit.report.viewer.maps import deflated

HEADER = struct.Struct("<8s2I4f")
STORED = 24
FUNCTIONS = 22

CODES = 65535
"""Largest code; 0 is a function's least coefficient."""


def data() -> dict[str, Any]:
    """What the page holds, as JSON: `axes`, `low`, `step` and `codes`.

    The functions are cubic B-splines over s(n·v) and t(r), w(1+c) x/(x+c) + (1−w) x with a c and w
    of their own (tools/lobe_table.py). `axes` are their numbers of cells, c and w. A coefficient is
    `low` plus `step` times its code. `codes` is a zlib stream in base64, prediction errors as in
    `maps.packed`: a plane of n·v (columns) and r (rows) for each function.
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
