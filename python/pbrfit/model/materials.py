"""Material maps, and `materials.exr`, the one format for them everywhere."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io import images
from pbrfit.values.quoting import listed

CHANNELS = ("albedo.R", "albedo.G", "albedo.B", "roughness.Y", "metallic.Y")
"""What EXR files call the planes of materials, in the order of `Materials.planes`."""


@dataclass(frozen=True)
class Materials:
    """Material maps of one view; pixels outside the mask are NaN in all three.

    Attributes
    ----------
    albedo
        (H, W, 3), base colour, linear Rec.709, in [0, 1]; of a metal it is F0.
    roughness
        (H, W), perceptual roughness r in [0, 1]; the GGX width is alpha = r².
    metallic
        (H, W), in [0, 1].
    """

    albedo: NDArray[np.floating[Any]]
    roughness: NDArray[np.floating[Any]]
    metallic: NDArray[np.floating[Any]]

    def __repr__(self) -> str:
        """In a line, without the maps."""
        return f"Materials({self.roughness.shape[1]} × {self.roughness.shape[0]})"

    @property
    def planes(self) -> NDArray[Any]:
        """(H, W, 5): albedo, roughness and metallic."""
        return np.dstack([self.albedo, self.roughness, self.metallic])

    @classmethod
    def of_planes(cls, planes: NDArray[Any]) -> Materials:
        """Undo `planes`."""
        return cls(planes[..., :3], planes[..., 3], planes[..., 4])

    def each(self, change: Callable[[NDArray[Any]], NDArray[Any]]) -> Materials:
        """What a function makes of each of the maps."""
        return Materials(*map(change, (self.albedo, self.roughness, self.metallic)))

    def within(self, valid: NDArray[np.bool_]) -> Materials:
        """Clipped to [0, 1], in float64, NaN outside of `valid` (H, W)."""

        def kept(plane: NDArray[Any]) -> NDArray[np.float64]:
            where = valid if plane.ndim == 2 else valid[..., None]
            return np.where(where, np.clip(plane.astype(np.float64), 0, 1), np.nan)

        return self.each(kept)


def write_materials(
    path: Path,
    materials: Materials,
    normals: NDArray[Any],
    mask: NDArray[np.bool_],
    more: Mapping[str, NDArray[Any]] | None = None,
    whole: Mapping[str, NDArray[Any]] | None = None,
) -> None:
    """Write `materials.exr`: linear float32 layers albedo, roughness, metallic, normal and mask.

    `more` are further maps (H, W) by channel name; `whole` are such that hold outside the mask,
    too.

    Of all others, pixels outside the mask take the values of the nearest pixel inside, so that no
    file holds NaN and filters at the border do no harm; `mask.Y` says which are real.
    """
    nearest = nearest_inside(mask)
    layers = {
        **dict(zip(CHANNELS, np.moveaxis(materials.planes, -1, 0), strict=True)),
        **{f"normal.{name}": normals[..., c] for c, name in enumerate("XYZ")},
        **(more or {}),
    }
    channels = {name: layer[nearest].astype(np.float32) for name, layer in layers.items()}
    channels |= {name: layer.astype(np.float32) for name, layer in (whole or {}).items()}
    channels["mask.Y"] = mask.astype(np.float32)
    images.write_exr(path, channels)


def nearest_inside(mask: NDArray[np.bool_]) -> tuple[Any, ...]:
    """Index of a map (H, W, ...) that gives pixels outside the mask what the nearest inside has.

    With a mask of no pixel at all it leaves maps as they are.
    """
    if mask.all() or not mask.any():
        return (slice(None), slice(None))
    from scipy.ndimage import distance_transform_edt

    return tuple(distance_transform_edt(~mask, return_distances=False, return_indices=True))


def read_materials(
    path: Path,
) -> tuple[Materials, NDArray[np.float64], NDArray[np.bool_]]:
    """Read `materials.exr`: materials, normals (NaN outside the mask) and mask."""
    return of_channels(images.read_channels(path), path)


def of_channels(
    channels: Mapping[str, NDArray[np.float32]], path: Path
) -> tuple[Materials, NDArray[np.float64], NDArray[np.bool_]]:
    """As `read_materials`, of a file's channels; InputError, which names `path`, if some lack."""

    def layer(name: str, parts: str) -> NDArray[np.float64]:
        missing = [f"{name}.{part}" for part in parts if f"{name}.{part}" not in channels]
        if missing:
            raise InputError(f"{path}: expected channel {missing[0]}, found {listed(channels)}")
        return np.stack([channels[f"{name}.{part}"] for part in parts], axis=-1).astype(np.float64)

    mask = layer("mask", "Y")[..., 0] > 0.5
    outside = ~mask[..., None]
    albedo, roughness, metallic, normals = (
        np.where(outside, np.nan, layer(name, parts))
        for name, parts in (
            ("albedo", "RGB"),
            ("roughness", "Y"),
            ("metallic", "Y"),
            ("normal", "XYZ"),
        )
    )
    return Materials(albedo, roughness[..., 0], metallic[..., 0]), normals, mask
