"""The lobe functions of the principled model as the viewer gets them: a small spline, packed."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import lobe_functions
from pbrfit.report.viewer.maps import prediction_errors

Array = NDArray[np.float64]

NODES = 33
"""Of √(n·v) and of √r, evenly from 0 to 1. Between them the shader has a cubic spline."""

CODES = 65535
"""Largest code; 0 is a function's least coefficient."""


def data() -> dict[str, Any]:
    """What the page holds, as JSON: `nodes`, `low` and `step` of each function, and `codes`.

    A coefficient is `low` plus `step` times its code. `codes` is a zlib stream in base64, prediction
    errors as in `maps.packed`: of the 20 functions of n·v (a column) and r (a row), planes of NODES + 2
    coefficients each way, then of the mean albedo Ē(r), a column.
    """
    planes = [*_surfaces(), _means()[:, None]]
    low = [float(plane.min()) for plane in planes]
    step = [float(np.ptp(plane)) / CODES for plane in planes]
    deflate = zlib.compressobj(6, zlib.DEFLATED, zlib.MAX_WBITS, 9, zlib.Z_RLE)
    packed = b"".join(
        deflate.compress(prediction_errors(np.rint((plane - least) / unit).astype(np.uint16)))
        for plane, least, unit in zip(planes, low, step, strict=True)
    )
    return {
        "nodes": NODES,
        "low": low,
        "step": step,
        "codes": base64.b64encode(packed + deflate.flush()).decode("ascii"),
    }


def _surfaces() -> Array:
    """(20, NODES + 2, NODES + 2): of each function, by r and n·v."""
    squares = np.linspace(0, 1, NODES) ** 2
    r, cosine = (axis.reshape(-1) for axis in np.meshgrid(squares, squares, indexing="ij"))
    values = lobe_functions(r, cosine)[0][:, :20].T.reshape(20, NODES, NODES)
    spline = _spline()
    return np.asarray(spline @ values @ spline.T)


def _means() -> Array:
    """(NODES + 2,): of Ē by r."""
    r = np.linspace(0, 1, NODES) ** 2
    return np.asarray(_spline() @ lobe_functions(r, np.ones(NODES))[0][:, 20])


def _spline() -> Array:
    """(NODES + 2, NODES): from values at the nodes to coefficients of uniform cubic B-splines.

    The first two cells share one cubic, and so do the last two ("not a knot"): there the fourth
    difference of the coefficients is 0.
    """
    count = NODES + 2
    equations = np.zeros((count, count))
    for i in range(NODES):
        equations[i, i : i + 3] = (1 / 6, 4 / 6, 1 / 6)
    equations[-2, :5] = equations[-1, -5:] = (1, -4, 6, -4, 1)
    return np.linalg.inv(equations)[:, :NODES]
