"""Maps of materials that a network, or any other tool, estimated: `estimates.exr`.

The file has the channels of `materials.exr`: albedo.R, G and B, linear Rec.709, roughness.Y and
metallic.Y, all in [0, 1]. Any of the three maps may be missing; NaN is unknown.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io import images
from pbrfit.io.checks import real_array
from pbrfit.io.quoting import listed
from pbrfit.io.resampling import averaged_channels
from pbrfit.model.materials import Materials

ESTIMATES_FILE = "estimates.exr"

CHANNELS = {"albedo": "RGB", "roughness": "Y", "metallic": "Y"}
"""Of each map."""


def of_maps(maps: Mapping[str, NDArray[Any]], size: tuple[int, int]) -> Materials:
    """Estimates of some maps by name, of (height, width): what is missing is unknown.

    Raises InputError if a map has another shape, no known value, or one outside of [0, 1].
    """
    planes = {}
    for name, channels in CHANNELS.items():
        shape = (*size, 3) if len(channels) == 3 else size
        plane = real_array(f"estimates: {name}", maps.get(name, np.full(shape, np.nan)), shape)
        if np.nanmin(plane, initial=0) < 0 or np.nanmax(plane, initial=0) > 1:
            found = f"{np.nanmin(plane):.3g} to {np.nanmax(plane):.3g}"
            raise InputError(f"estimates: expected {name} between 0 and 1, found {found}")
        planes[name] = plane.astype(np.float32)
    if not any(np.isfinite(plane).any() for plane in planes.values()):
        raise InputError("estimates: expected known values of some map, found none")
    return Materials(**planes)


def known_maps(estimates: Materials) -> dict[str, NDArray[Any]]:
    """Maps that have known values, by name."""
    maps = {name: getattr(estimates, name) for name in CHANNELS}
    return {name: plane for name, plane in maps.items() if np.isfinite(plane).any()}


def reduced(estimates: Materials, size: tuple[int, int]) -> Materials:
    """Averaged down to (height, width), unknown where a part of a new pixel is."""
    planes = [np.atleast_3d(getattr(estimates, name)) for name in CHANNELS]
    smaller = [averaged_channels(plane, size).astype(np.float32) for plane in planes]
    return Materials(smaller[0], smaller[1][..., 0], smaller[2][..., 0])


def write(path: Path, estimates: Materials) -> None:
    """Write the known maps."""
    maps = known_maps(estimates)
    channels = {
        f"{name}.{channel}": np.atleast_3d(plane)[..., i]
        for name, plane in maps.items()
        for i, channel in enumerate(CHANNELS[name])
    }
    images.write_exr(path, channels)


def read(path: Path) -> Materials:
    """Read `estimates.exr`, or any EXR file with such channels, as `of_maps`."""
    stored = images.read_channels(path)
    maps = {
        name: np.stack([stored[f"{name}.{channel}"] for channel in channels], axis=-1)
        for name, channels in CHANNELS.items()
        if f"{name}.{channels[0]}" in stored
    }
    if not maps:
        expected = "expected channels albedo.R, albedo.G, albedo.B, roughness.Y or metallic.Y"
        raise InputError(f"{path}: {expected}, found {listed(stored)}")
    maps = {name: plane if name == "albedo" else plane[..., 0] for name, plane in maps.items()}
    try:
        return of_maps(maps, next(iter(maps.values())).shape[:2])
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
