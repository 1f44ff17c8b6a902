"""Normals of a scene folder as files: found, read, turned into camera space, written.

Camera space has X right, Y up and Z towards the viewer. What a file means is said by its
`Convention`; of a scene folder's own file that is `scene.toml`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io import images
from pbrfit.io.input_files import there
from pbrfit.io.quoting import listed

NORMAL_FILES = ("normals.exr", "normals.png")

UNCERTAINTY = "uncertainty.Y"
"""Channel of `normals.exr`: how far off each normal may be, in degrees, where somebody said so;
`Scene.normal_sigma` says what it means."""


@dataclass(frozen=True)
class Convention:
    """How normals are written down."""

    axes: str = "opengl"
    """Either "opengl" (Y up) or "directx" (Y down)."""
    frame: str = "camera"
    """One of "camera", "world" and "tangent", that of a flat card which is parallel to the picture:
    its X and Y run along the picture's sides, and (0, 0, 1) faces the viewer."""
    world_to_camera: NDArray[np.float64] | None = None
    """(3, 3) rotation, needed when the frame is "world": n_camera = R n_world."""

    def to_camera(self, normals: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """(..., 3) normals of this convention in camera space."""
        turned = np.asarray(normals * self._signs(), np.float64)
        return turned if self.frame != "world" else turned @ self._rotation().T

    def from_camera(self, normals: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """(..., 3) normals of camera space in this convention: undoes `to_camera`."""
        turned = normals if self.frame != "world" else normals @ self._rotation()
        return np.asarray(turned * self._signs(), np.float64)

    def _signs(self) -> NDArray[np.float64]:
        return np.array([1.0, -1.0 if self.axes == "directx" else 1.0, 1.0])

    def _rotation(self) -> NDArray[np.float64]:
        if self.world_to_camera is None:
            raise InputError(
                "expected world_to_camera, a 3 × 3 rotation, beside "
                'normals_frame = "world"; found none'
            )
        return self.world_to_camera

    def __str__(self) -> str:
        return f"{self.axes} axes, {self.frame} space"


def find_normals(folder: Path) -> list[Path]:
    """The files with normals that a scene folder has."""
    return [path for name in NORMAL_FILES if there(path := folder / name)]


def read_normals(path: Path) -> NDArray[np.float64]:
    """Read a normal map: EXR channels as they are, or a PNG whose values v mean n = 2v - 1.

    Returns (H, W, 3), in whatever frame and of whatever length the file holds. Raises InputError if
    the file has other channels.
    """
    if path.suffix.lower() == ".exr":
        channels = images.read_channels(path)
        triple = next(
            (
                [f"{prefix}{name}" for name in names]
                for names in ("XYZ", "RGB", "xyz")
                for prefix in ("", "normal.", "normals.", "Normal.", "N.")
                if all(f"{prefix}{name}" in channels for name in names)
            ),
            None,
        )
        if triple is None:
            raise InputError(
                f"{path}: expected channels X, Y, Z (or R, G, B, or normal.X ...), "
                f"found {listed(channels)}"
            )
        return np.stack([channels[name] for name in triple], axis=-1).astype(np.float64)
    data = images.read_data(path)
    if data.shape[-1] < 3:
        raise InputError(f"{path}: expected three channels, found {data.shape[-1]}")
    return 2.0 * data[..., :3] - 1.0


def read_uncertainty(path: Path) -> NDArray[np.float32] | None:
    """(H, W), degrees: `UNCERTAINTY` of a file with normals as it is stored; None if it has none.

    Raises InputError or OSError if the file cannot be read.
    """
    return images.read_channels(path).get(UNCERTAINTY) if path.suffix.lower() == ".exr" else None


def write_normals(
    path: Path,
    normals: NDArray[np.floating[Any]],
    uncertainty: NDArray[np.floating[Any]] | None = None,
) -> None:
    """Write `normals.exr`: channels X, Y, Z, and `UNCERTAINTY` if there is one.

    Normals (H, W, 3) stand in the file as they are, uncertainty (H, W) is in degrees.
    """
    channels = {name: normals[..., i] for i, name in enumerate("XYZ")}
    if uncertainty is not None:
        channels[UNCERTAINTY] = uncertainty
    images.write_exr(path, channels)
