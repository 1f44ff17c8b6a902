"""Depth for pictures that come without: by a network, from a file, or integrated from normals."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.acquire import marigold, weights
from pbrfit.acquire.normals import check_reducible
from pbrfit.acquire.padding import resized
from pbrfit.io.depth_files import read_depth
from pbrfit.model import geometry
from pbrfit.model.depth_normals import DepthKind
from pbrfit.scene.depth import (
    COMPARED_MAX,
    checked_depth,
    compared,
    every_few,
    median_angle,
    reduced,
    without_holes,
)
from pbrfit.scene.integration import depth_from_normals
from pbrfit.scene.reading import Surface
from pbrfit.values.arrays import Array, Codes, Floats
from pbrfit.values.checks import errors_about

MODEL, WHAT = "depth-anything/Depth-Anything-V2-Small-hf", "Depth Anything"
NETWORKS = ("depth-anything", "marigold")

RATIOS = (0.01, 100.0)
"""Least and largest ratio of the smallest value, with its offset, to the range of the values."""

STEPS = 33
"""Offsets that are tried, evenly by their logarithm, before the best is refined."""


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
    srgb8: Codes,
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
        Of the network: those of `by_depth_anything` or `marigold.depth_of`.
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
        answer, metric, more = by_depth_anything(srgb8, **options)
        if metric:
            found, remarks = without_holes(answer)[0], ["in metres, as the network has it"]
        else:
            normals = _normals(surface, source)
            found, *remarks = with_offset(answer, normals, surface.fov, disparity=True)
    else:
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


def _normals(surface: Surface, what: str) -> Array:
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
    with errors_about(path):
        kept, said = without_holes(stored, inverse=kind == "disparity")
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


def with_offset(
    relative: Floats, normals: Array, fov: float, *, disparity: bool = False
) -> tuple[NDArray[np.float32], str]:
    """Depth (H, W) with the offset by which its normals are nearest to given ones (H, W, 3).

    Some networks give depth, or its inverse, up to an unknown factor and an unknown offset:
    z = s (d + b), or 1/z = s (d + b). The factor changes no direction of a surface, but the offset
    does: the larger it is, beside the range of d, the flatter is the relief. So the offset is the
    one with the least median angle between the normals, over `RATIOS`.

    `relative` (H, W) is depth up to factor and offset, or with `disparity` its inverse. Normals are
    in camera space, NaN where unknown. Returns depth of median 1, NaN where `relative` is; and in
    words how well it is known. Raises InputError without perspective, where no normals tell an
    offset, or if no pixel has both.
    """
    from scipy.optimize import minimize_scalar

    if fov == 0:
        raise InputError(
            "relative depth: expected a field of view above 0, found an orthographic camera"
        )
    values = np.asarray(relative, np.float64)
    values = np.where(np.isfinite(values), values, np.nan)
    some = every_few(values.shape, COMPARED_MAX)
    few, wanted = values[some], normals[some]
    low, span = float(np.nanmin(values)), float(np.nanmax(values) - np.nanmin(values))
    if not span > 0:
        raise InputError("relative depth: expected different depths, found all equal")

    def distances(of: Array, log_ratio: float) -> Array:
        moved = of - low + span * np.exp(log_ratio)
        return np.asarray(1.0 / moved if disparity else moved)

    def angle(log_ratio: float) -> float:
        return median_angle(distances(few, log_ratio), wanted, fov)

    first, last = np.log(RATIOS).tolist()
    ratios = np.linspace(first, last, STEPS)
    with np.errstate(invalid="ignore"):
        tried = [angle(ratio) for ratio in ratios]
    if not np.isfinite(tried).all():
        raise InputError("relative depth: expected normals beside it, found none")
    best = int(np.argmin(tried))
    around = ratios[max(best - 1, 0)], ratios[min(best + 1, STEPS - 1)]
    refined = minimize_scalar(angle, bounds=around, method="bounded", options={"xatol": 1e-3})
    log_ratio = float(refined.x) if refined.fun < tried[best] else float(ratios[best])
    depth = distances(values, log_ratio)
    what = "inverse depth" if disparity else "depth"
    said = (
        f"the network gives {what} up to factor and offset: offset by the normals, factor unknown"
    )
    if best in (0, STEPS - 1):
        said += "; the offset is at the end of its range, so the normals hardly tell it"
    return (depth / np.nanmedian(depth)).astype(np.float32), said


def by_depth_anything(
    srgb8: Codes, *, model: str = MODEL, device: str = "auto"
) -> tuple[Array, bool, dict[str, Any]]:
    """Estimate depth of one picture (H, W, 3), sRGB, by Depth Anything V2 (Yang et al. 2024).

    Its metric checkpoints give distances along the axis, its others inverse depth up to a factor
    and an offset; which of both, a checkpoint's configuration says. `model` is a name on the
    Hugging Face Hub or a local folder, `device` as for `pbrfit.acquire.weights.placement`; always
    in float32. Returns (H, W); whether that is depth in metres; record: how it was made, as JSON.
    Raises InputError if a package or the weights are missing, or memory runs out.
    """
    weights.need("segment", "torch", "torchvision", "transformers")
    import torch
    from PIL import Image
    from transformers import AutoImageProcessor, AutoModelForDepthEstimation

    where = weights.placement(device, "float32", what=WHAT)
    loader = partial(AutoModelForDepthEstimation.from_pretrained, dtype=torch.float32)
    loaded = weights.load(WHAT, model, loader=loader, marker="config.json")
    processor = weights.load(
        WHAT, model, loader=AutoImageProcessor.from_pretrained, marker="preprocessor_config.json"
    ).network
    network = loaded.network
    with weights.memory_in_words(WHAT, "a smaller picture, --device cpu"), torch.inference_mode():
        network.to(where.device)
        inputs = processor(images=Image.fromarray(srgb8), return_tensors="pt").to(where.device)
        answer = network(**inputs).predicted_depth[0].cpu().numpy().astype(np.float64)
    metric = getattr(network.config, "depth_estimation_type", "relative") == "metric"
    height, width = srgb8.shape[:2]
    record = {
        "model": model,
        "revision": loaded.record["revision"],
        "metric": metric,
        "device": where.device,
        "packages": weights.versions("transformers", "torchvision", "torch"),
    }
    return resized(answer[..., None], (height, width))[..., 0].astype(np.float64), metric, record
