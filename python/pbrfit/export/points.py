"""The surface as a cloud of points: PLY, binary, little-endian."""

from __future__ import annotations

import numpy as np

from pbrfit._core import InputError
from pbrfit.io.color import encode_srgb
from pbrfit.model.geometry import positions
from pbrfit.result.result import Result

POINT = np.dtype(
    [
        *((name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")),
        *((name, "u1") for name in ("red", "green", "blue")),
        *((name, "<f4") for name in ("roughness", "metallic")),
    ]
)
"""A point: position and normal in camera space, albedo in sRGB, roughness, metallic."""

HOLDS = "points in camera space, in the unit of the depth, with normals and materials"


def ply(result: Result) -> bytes:
    """A PLY file with a point for each masked pixel that has depth; InputError if none has."""
    if result.depth is None:
        raise InputError(
            "format: expected a result with depth for ply, found one without; put depth.exr into "
            "the scene folder (`pbrfit depth`) and run pbrfit decompose"
        )
    there = result.mask & np.isfinite(result.depth)
    if not there.any():
        raise InputError("depth: expected some pixel of the mask to have it for ply, found none")
    points = np.zeros(np.count_nonzero(there), POINT)
    places = positions(result.depth, result.fov)[there]
    codes = np.rint(255 * encode_srgb(np.clip(result.albedo[there], 0, 1)))
    for i, (axis, color) in enumerate(zip("xyz", ("red", "green", "blue"), strict=True)):
        points[axis] = places[:, i]
        points[f"n{axis}"] = result.normals[there][:, i]
        points[color] = codes[:, i]
    points["roughness"] = result.roughness[there]
    points["metallic"] = result.metallic[there]
    kinds = {"<f4": "float", "|u1": "uchar"}
    properties = [f"property {kinds[POINT[name].str]} {name}" for name in POINT.names or ()]
    head = [
        "ply",
        "format binary_little_endian 1.0",
        "comment camera space: X right, Y up, Z to the viewer; the camera is the origin",
        f"element vertex {len(points)}",
        *properties,
        "end_header",
    ]
    return "\n".join([*head, ""]).encode() + points.tobytes()
