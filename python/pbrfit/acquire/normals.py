"""Normals for pictures that come without: by a network, from a depth map, from a file, or flat.

Files have normals in any of the usual conventions, or depth. Depth up to an unknown factor is
enough, because scaling a scene about the camera turns no surface. Depth up to an unknown offset, as
some estimators give it ("relative depth"), is not.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.acquire import marigold
from pbrfit.io.depth_files import read_depth
from pbrfit.io.normal_files import MIN_NORMAL_LENGTH, Convention, read_normals
from pbrfit.io.resampling import averaged, averaged_channels, reduced_size
from pbrfit.model.depth_normals import FACING, DepthKind, from_depth
from pbrfit.scene.depth import without_holes
from pbrfit.values.arrays import Array, Codes, Mask
from pbrfit.values.checks import errors_about

log = logging.getLogger("pbrfit")

DEPTH = "depth:"

HALF_WEIGHT = 5.0
"""Degrees of uncertainty at which a pixel counts half; `Normals.weights` says why."""

BEHIND_SHARE_MAX = 0.01
"""Share of the pixels of a tangent-space map above which normals that point behind its surface say
that it is of another space."""

DIFFERENT_DEPTHS_MIN = 1024
"""Different depths in a map below which normals show steps, which is warned of."""


@dataclass(frozen=True, eq=False)
class Normals:
    """Normals of a picture, and how they came about."""

    normals: Array
    """(H, W, 3) unit vectors in camera space: X right, Y up, Z to the viewer."""
    uncertainty: Array | None = None
    """(H, W), degrees: how far single answers of an ensemble are off; None if nothing is known."""
    record: dict[str, Any] = field(default_factory=dict)
    """As JSON: ``source``, and what decided about the answer."""
    known: Mask | None = None
    """(H, W), where the source has a normal; elsewhere it faces the viewer. None = everywhere."""
    remarks: tuple[str, ...] = ()
    """How a file was read, where that is not as its kind suggests."""

    @property
    def weights(self) -> NDArray[np.float32] | None:
        """(H, W): how much pixels count whose normals are uncertain; None if all the same.

        The weight of a sample is the inverse of its variance. A normal that is off by δ changes
        what a pixel shows by about κ I δ, where κ, the relative slope of shading by angle, is of
        the order of 1. Beside that, samples have a variance ε² I² that does not come from normals:
        noise, and what the model does not hold, such as shadows. With δ of the size σ, the
        uncertainty, the variance is I² (ε² + κ² σ²), so

            ω = 1 / (1 + (σ/σ₀)²),     σ₀ = ε/κ,

        up to a factor, which does not matter. κ is 0.7 (RMS over the pixels of six furnished rooms,
        SH lights, normals off by 1 to 15 degrees; median 0.45), so `HALF_WEIGHT`, 5 degrees, stands
        for ε = 6 %. There, with normals off by 5 degrees on average and σ known, errors of relit
        pictures fell from 0.170 without weights to 0.118, 0.136 and 0.158 with σ₀ of 1.5, 5 and 20
        degrees. An ensemble tells only a part of σ, which is why σ₀ is not smaller. Where there is
        no normal at all, the weight is 0.
        """
        known = np.ones(self.normals.shape[:2], bool) if self.known is None else self.known
        if self.uncertainty is None and known.all():
            return None
        sigma = 0.0 if self.uncertainty is None else self.uncertainty
        return np.where(known, 1 / (1 + (sigma / HALF_WEIGHT) ** 2), 0).astype(np.float32)


def estimate(
    source: str, srgb8: Codes, *, fov: float, mask: Mask | None = None, **options: Any
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
        normals, known = of_depth(path, size, fov=fov, **given)
        record |= {"fov": fov, **given}
    else:
        convention = options.get("convention", Convention())
        normals, known, remarks = from_normals(path, size, convention)
        record["convention"] = str(convention)
    if not (known if mask is None else known & mask).any():  # the fit would have no pixel
        raise InputError(f"{path}: expected normals of some pixel of the mask, found none")
    return Normals(normals, record=record, known=known, remarks=remarks)


def kind_of(source: str) -> str:
    """Which kind of source a text names: "marigold", "flat", "depth" or "file"."""
    if source in ("marigold", "flat"):
        return source
    return "depth" if source.startswith(DEPTH) else "file"


def from_normals(
    path: Path, size: tuple[int, int], convention: Convention
) -> tuple[Array, Mask, tuple[str, ...]]:
    """Normals of a file in camera space, at the size (height, width) of the pictures.

    The file is one that `read_normals` reads. The map has the pictures' size, or is larger in the
    same proportion; then normals are averaged. Returns normals, known, said: (H, W, 3) unit
    vectors; (H, W), where the file has one, which elsewhere faces the viewer; and how the file was
    read, in words. Raises InputError or OSError if the file holds no normals, those of another
    frame, or of another proportion.
    """
    read = read_normals(path)
    stored = read.vectors
    check_reducible(path, stored.shape, size)
    length = np.linalg.norm(stored, axis=-1)
    known = np.isfinite(length)
    if not known.any():
        raise InputError(f"{path}: expected unit vectors, found no vector of a length near 1")
    if convention.frame == "tangent":
        behind = float(np.mean(stored[known][:, 2] < 0))
        if behind > BEHIND_SHARE_MAX:
            raise InputError(
                f"{path}: expected tangent space, where Z is above 0, found {100 * behind:.0f} % "
                "below; is it camera space (--frame camera)?"
            )
    with errors_about(path):
        turned = convention.to_camera(np.where(known[..., None], stored, 0.0))
    unit = turned / np.where(known, length, 1.0)[..., None]
    return *_at_size(np.where(known[..., None], unit, FACING), known, size), read.said


def of_depth(
    path: Path,
    size: tuple[int, int],
    *,
    fov: float,
    kind: DepthKind = "z",
    view_width: float | None = None,
) -> tuple[Array, Mask]:
    """Normals of a depth map in a file, at the size (height, width) of the pictures.

    The file is one that `read_depth` reads, of the pictures' size or larger in the same proportion;
    then normals are averaged. All else, and what is returned, is as for `from_depth`. Raises
    InputError or OSError if the file holds no depth, or of another proportion.
    """
    depth, _ = read_depth(path)
    check_reducible(path, depth.shape, size)
    with errors_about(path):
        if kind != "disparity":
            depth = np.where(np.isnan(without_holes(depth)[0]), np.nan, depth)
        normals, known = from_depth(depth, fov=fov, kind=kind, view_width=view_width)
    if not known.any():
        raise InputError(
            f"{path}: expected depths above 0, found none beside another; 0, infinite and NaN "
            "say that nothing was hit"
        )
    different = len(np.unique(depth[known]))
    if 1 < different < min(DIFFERENT_DEPTHS_MIN, depth.size // 8):
        log.warning(
            "%s: only %d different depths: normals will show steps; a float or 16-bit map that "
            "uses its range is better",
            path,
            different,
        )
    return _at_size(normals, known, size)


def _at_size(normals: Array, known: Mask, size: tuple[int, int]) -> tuple[Array, Mask]:
    """Unit normals averaged over the pixels of a smaller picture, and made unit again.

    What is not known, or cancels, faces the viewer. Also returns what is known at that size.
    """
    if known.shape == size:
        return normals, known
    small = averaged_channels(np.where(known[..., None], normals, 0.0), size)
    length = np.linalg.norm(small, axis=-1)
    # A pixel of which a part is known has a normal, if only that of the part.
    share = averaged(known, size)
    told = (share > 0.5) & (length >= MIN_NORMAL_LENGTH)
    length[~told] = 1.0
    return np.where(told[..., None], small / length[..., None], FACING), told


def check_reducible(path: Path, shape: tuple[int, ...], size: tuple[int, int]) -> None:
    """Check that a map of this shape becomes one of (height, width) by averaging.

    Raises InputError if it is smaller, or of another proportion; it names `path`.
    """
    height, width = size
    larger = shape[0] >= height and shape[1] >= width
    if not larger or reduced_size(shape, max(size)) != size:
        raise InputError(
            f"{path}: expected the pictures' size, {width} × {height} pixels, or a larger one in "
            f"the same proportion, found {shape[1]} × {shape[0]}"
        )
