"""Depth for pictures that come without: by a network, from a file, or integrated from normals."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.acquire import marigold
from pbrfit.acquire.depth import depth_anything
from pbrfit.acquire.depth.offset import with_offset
from pbrfit.acquire.normals.files import check_reducible, check_source
from pbrfit.io.depth_files import read_depth
from pbrfit.model import geometry
from pbrfit.model.depth_normals import DepthKind
from pbrfit.scene.depth import checked_depth, compared, reduced, without_holes
from pbrfit.scene.integration import depth_from_normals
from pbrfit.scene.reading import Surface

NETWORKS = ("depth-anything", "marigold")


@dataclass(frozen=True, eq=False)
class Depth:
    """Depth of a picture, and how it came about."""

    depth: NDArray[np.float32]
    """(H, W) distances along the camera's axis; NaN where unknown."""
    remarks: tuple[str, ...] = ()
    """What is to be known about it, in words."""
    record: dict[str, Any] = field(default_factory=dict)
    """As JSON: ``source``, and what decided about the answer."""


def estimate(
    source: str,
    srgb8: NDArray[np.uint8],
    surface: Surface,
    *,
    depth_kind: DepthKind = "z",
    unit: float = 1.0,
    fuse: bool = False,
    **options: Any,
) -> Depth:
    """Find depth for a picture.

    Raises InputError or OSError, also where the normals show that it is inverse depth.

    Parameters
    ----------
    source
        "depth-anything" or "marigold"; "normals", which are integrated; or a file: EXR, .npy, or a
        grey PNG or TIFF, of the picture's size or larger in the same proportion, in any unit.
    srgb8
        (H, W, 3), sRGB: what a network is shown. Of the others only its size matters.
    surface
        Normals, field of view, mask and segments of the scene. Relative depth needs the normals: by
        them its unknown offset is found.
    depth_kind
        Of a file: "z", "ray" (distance along the pixel's ray) or "disparity" (inverse of z).
    unit
        Of a file: what its numbers are multiplied by, 0.001 for metres of millimetres.
    fuse
        Make the depth agree with the normals (`pbrfit.scene.integration`).
    options
        Of the network: those of `depth_anything.from_picture` or `marigold.depth_of`.
    """
    if source == "normals":
        found = depth_from_normals(
            _normals(surface, "normals"), surface.fov, surface.mask, surface.segments
        )
        said = "in a unit of its own: normals tell depth up to a factor"
        return Depth(found, (said,), {"source": source})
    if source == "marigold":
        relative, more = marigold.depth_of(srgb8, **options)
        found, *remarks = with_offset(relative, _normals(surface, source), surface.fov)
    elif source == "depth-anything":
        answer, metric, more = depth_anything.from_picture(srgb8, **options)
        if metric:
            found, remarks = without_holes(answer)[0], ["in metres, as the network has it"]
        else:
            normals = _normals(surface, source)
            found, *remarks = with_offset(answer, normals, surface.fov, disparity=True)
    else:
        check_source("depth", source, "depth-anything, marigold, normals or FILE")
        path, size = Path(source), (srgb8.shape[0], srgb8.shape[1])
        found, remarks = _of_file(path, size, surface.fov, depth_kind, unit)
        more = {"source": "file", "file": path.name, "kind": depth_kind}
    if surface.normals is not None:  # fused with them any map would agree
        checked_depth(found, surface.normals, surface.fov)
    if fuse:
        normals = _normals(surface, "fuse")
        found = depth_from_normals(
            normals, surface.fov, surface.mask, surface.segments, depth=found
        )
        remarks.append("fused with the normals")
    if surface.normals is not None:
        angle = compared(found, surface.normals, surface.fov)[0]
        if np.isfinite(angle):
            remarks.append(f"its normals {angle:.1f} degrees (median) from the scene's")
    return Depth(found, tuple(remarks), {"source": source, **more})


def _normals(surface: Surface, what: str) -> NDArray[np.float64]:
    if surface.normals is None:
        raise InputError(
            f"{what}: expected a scene with normals, found none; `pbrfit normals` makes them"
        )
    return surface.normals


def _of_file(
    path: Path, size: tuple[int, int], fov: float, kind: DepthKind, unit: float
) -> tuple[NDArray[np.float32], list[str]]:
    """Distances along the axis, at the size (height, width) of the pictures; and remarks."""
    stored, how = read_depth(path, unit)
    check_reducible(path, stored.shape, size)
    try:
        kept, said = without_holes(stored, inverse=kind == "disparity")
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    values = kept.astype(np.float64)
    if not (unit != 1 or np.nanmax(values) <= 1 or np.fmod(values[np.isfinite(values)], 1).any()):
        said.append("whole numbers, in the unit of the file; --unit mm makes metres of mm")
    said += how
    if kind == "disparity":
        values = 1.0 / values
    elif kind == "ray":
        height, width = stored.shape
        values = values * geometry.view_directions(height, width, fov)[..., 2]
    found = reduced(values, size) if stored.shape != size else values.astype(np.float32)
    return found, said
