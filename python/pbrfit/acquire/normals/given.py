"""Normals from a file that somebody has, in any of the usual conventions."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.acquire.normals.maps import check_reducible, fit_to_size, read_npy
from pbrfit.io.normal_files import Convention, read_normals
from pbrfit.scene.arrays import MIN_NORMAL_LENGTH

Axes = Literal["opengl", "directx"]
Frame = Literal["camera", "tangent", "world"]

MAX_BEHIND = 0.01
"""Share of a tangent-space map that may point behind its surface, which none should."""


def from_file(
    path: Path, size: tuple[int, int], convention: Convention
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Normals of a file in camera space, at the size (height, width) of the pictures.

    Parameters
    ----------
    path
        EXR (X, Y, Z or R, G, B: the components), PNG or TIFF (n = 2v - 1), or .npy of shape
        (H, W, 3) or (3, H, W).
    size
        The map has this size, or is larger in the same proportion; then normals are averaged.
    convention
        How the file is written.

    Returns
    -------
    normals, known
        (H, W, 3) unit vectors, and (H, W): where the file has one. Elsewhere (zero, NaN) the
        normal faces the viewer.

    Raises
    ------
    InputError, OSError
        If the file holds no normals, those of another frame, or of another proportion.
    """
    for name, value, choices in (
        ("convention", convention.axes, get_args(Axes)),
        ("frame", convention.frame, get_args(Frame)),
    ):
        if value not in choices:
            raise InputError(f"{name}: expected one of {', '.join(choices)}, found {value!r}")
    stored = _stored(path)
    if stored.shape[:2] != size:
        check_reducible(path, stored.shape, size)  # before any work is done on it
    with np.errstate(over="ignore"):  # too long to have a length: not known
        length = np.linalg.norm(stored, axis=-1)
    known = np.isfinite(length) & (length >= MIN_NORMAL_LENGTH)
    if not known.any():
        raise InputError(f"{path}: expected unit vectors, found only zeros or NaN")
    if convention.frame == "tangent":
        behind = float(np.mean(stored[known][:, 2] < 0))
        if behind > MAX_BEHIND:
            raise InputError(
                f"{path}: expected tangent space, where Z is above 0, found {100 * behind:.0f} % "
                "below; is it camera space (--frame camera)?"
            )
    try:
        turned = convention.to_camera(np.where(known[..., None], stored, 0.0))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    facing = np.array([0.0, 0.0, 1.0])
    unit = turned / np.where(known, length, 1.0)[..., None]
    return fit_to_size(np.where(known[..., None], unit, facing), known, size, path)


def _stored(path: Path) -> NDArray[np.float64]:
    if path.suffix.lower() != ".npy":
        return read_normals(path)
    array = read_npy(path)
    if array.ndim == 4 and array.shape[0] == 1:
        array = array[0]
    if array.ndim == 3 and array.shape[-1] != 3 and array.shape[0] == 3:
        array = np.moveaxis(array, 0, -1)
    if array.ndim != 3 or array.shape[-1] != 3:
        raise InputError(f"{path}: expected normals (H, W, 3), found shape {array.shape}")
    return array
