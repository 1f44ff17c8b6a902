"""Normals for pictures that come without: by a network, from a depth map, from a file, or flat."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.acquire import marigold
from pbrfit.acquire.normals import files
from pbrfit.io.normal_files import Convention
from pbrfit.model.depth_normals import FACING

DEPTH = "depth:"

HALF_WEIGHT = 5.0
"""Degrees of uncertainty at which a pixel counts half; `weights_of` says why."""


@dataclass(frozen=True, eq=False)
class Normals:
    """Normals of a picture, and how they came about."""

    normals: NDArray[np.float64]
    """(H, W, 3) unit vectors in camera space: X right, Y up, Z to the viewer."""
    uncertainty: NDArray[np.float64] | None = None
    """(H, W), degrees: how far single answers of an ensemble are off; None if nothing is known."""
    record: dict[str, Any] = field(default_factory=dict)
    """As JSON: ``source``, and what decided about the answer."""
    known: NDArray[np.bool_] | None = None
    """(H, W), where the source has a normal; elsewhere it faces the viewer. None = everywhere."""
    remarks: tuple[str, ...] = ()
    """How a file was read, where that is not as its kind suggests."""

    @property
    def weights(self) -> NDArray[np.float32] | None:
        """(H, W): how much the pixels should count; None if all the same."""
        return weights_of(self.uncertainty, self.known)


def estimate(
    source: str,
    srgb8: NDArray[np.uint8],
    *,
    fov: float,
    mask: NDArray[np.bool_] | None = None,
    **options: Any,
) -> Normals:
    """Find normals for a picture.

    Raises InputError or OSError in one line that names the file or option, what was expected and
    what was found.

    Parameters
    ----------
    source
        "marigold"; "flat", where every surface faces the viewer; "depth:FILE"; or a file with
        normals.
    srgb8
        (H, W, 3), sRGB: what a network is shown. Of the others only its size matters.
    fov
        Horizontal field of view in degrees, 0 = orthographic. For depth.
    mask
        (H, W), the pixels that matter; None = all. For messages alone.
    options
        Of the source: those of `marigold.normals_of`; ``depth_kind`` and ``view_width`` of a
        depth map, see `pbrfit.model.depth_normals`; ``convention``, a
        `pbrfit.io.normal_files.Convention`, of a file.
    """
    size = srgb8.shape[0], srgb8.shape[1]
    kind = kind_of(source)
    if kind == "flat":
        return Normals(np.broadcast_to(FACING, (*size, 3)).copy(), record={"source": kind})
    if kind == "marigold":
        normals, uncertainty, record = marigold.normals_of(srgb8, **options)
        return Normals(normals, uncertainty, {"source": kind, **record})
    path = Path(source.removeprefix(DEPTH))
    record = {"source": kind, "file": path.name}
    remarks: tuple[str, ...] = ()
    if kind == "depth":
        given = {"kind": options.get("depth_kind", "z")}
        if "view_width" in options:
            given["view_width"] = options["view_width"]
        normals, known = files.of_depth(path, size, fov=fov, **given)
        record |= {"fov": fov, **given}
    else:
        files.check_source("normals", source, "marigold, flat, depth:FILE or FILE")
        convention = options.get("convention", Convention())
        normals, known, remarks = files.from_normals(path, size, convention)
        record["convention"] = str(convention)
    if not (known if mask is None else known & mask).any():  # the fit would have no pixel
        raise InputError(f"{path}: expected normals of some pixel of the mask, found none")
    return Normals(normals, record=record, known=known, remarks=remarks)


def kind_of(source: str) -> str:
    """Which kind of source a text names: "marigold", "flat", "depth" or "file"."""
    if source in ("marigold", "flat"):
        return source
    return "depth" if source.startswith(DEPTH) else "file"


def weights_of(
    uncertainty: NDArray[np.floating[Any]] | None, known: NDArray[np.bool_] | None
) -> NDArray[np.float32] | None:
    """How much pixels count whose normals are uncertain: (H, W), or None if all the same.

    The weight of a sample is the inverse of its variance. A normal that is off by δ changes what a
    pixel shows by about κ I δ, where κ, the relative slope of shading by angle, is of the order of
    1. Beside that, samples have a variance ε² I² that does not come from normals: noise, and what
    the model does not hold, such as shadows. With δ of the size σ the variance is
    I² (ε² + κ² σ²), so

        ω = 1 / (1 + (σ/σ₀)²),     σ₀ = ε/κ,

    up to a factor, which does not matter. κ is 0.7 (RMS over the pixels of six furnished rooms, SH
    lights, normals off by 1 to 15 degrees; median 0.45), so `HALF_WEIGHT`, 5 degrees, stands for ε
    = 6 %. There, with normals off by 5 degrees on average and σ known, errors of relit pictures
    fell from 0.170 without weights to 0.118, 0.136 and 0.158 with σ₀ of 1.5, 5 and 20 degrees. An
    ensemble tells only a part of σ, which is why σ₀ is not smaller. `uncertainty` (H, W) is σ in
    degrees; where `known` (H, W) says that there is no normal at all, the weight is 0.
    """
    if known is not None and known.all():
        known = None
    if uncertainty is not None:
        weights = 1 / (1 + (np.asarray(uncertainty, np.float64) / HALF_WEIGHT) ** 2)
    elif known is not None:
        weights = np.ones(known.shape)
    else:
        return None
    if known is not None:
        weights[~known] = 0
    return weights.astype(np.float32)
