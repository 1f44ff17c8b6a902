"""Maps of materials that a network, or any other tool, estimated: `estimates.exr`.

The file has `CHANNELS`, or some of them, linear, in [0, 1]; NaN is unknown.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io import images
from pbrfit.io.resampling import averaged_channels
from pbrfit.model.materials import CHANNELS, Materials
from pbrfit.values.checks import errors_about, real_array
from pbrfit.values.quoting import listed

ESTIMATES_FILE = "estimates.exr"


def of_maps(maps: Mapping[str, NDArray[Any]], size: tuple[int, int]) -> Materials:
    """Estimates of some maps by name, of (height, width): what is missing is unknown.

    Raises InputError if a map has another shape, no known value, or one outside of [0, 1].
    """
    planes = {}
    for name, shape in (("albedo", (*size, 3)), ("roughness", size), ("metallic", size)):
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
    return {name: plane for name, plane in vars(estimates).items() if np.isfinite(plane).any()}


def reduced(estimates: Materials, size: tuple[int, int]) -> Materials:
    """Averaged down to (height, width), unknown where a part of a new pixel is."""
    averaged = averaged_channels(estimates.planes, size).astype(np.float32)
    return Materials.of_planes(averaged)


def write(path: Path, estimates: Materials) -> None:
    """Write the channels that have known values."""
    channels = zip(CHANNELS, np.moveaxis(estimates.planes, -1, 0), strict=True)
    images.write_exr(path, {name: of for name, of in channels if np.isfinite(of).any()})


def read(path: Path) -> Materials:
    """Read `estimates.exr`, or any EXR file with such channels, as `of_maps`."""
    stored = images.read_channels(path)
    known = [stored[name] for name in CHANNELS if name in stored]
    if not known:
        raise InputError(f"{path}: expected some of {listed(CHANNELS)}, found {listed(stored)}")
    unknown = np.full_like(known[0], np.nan)
    planes = np.stack([stored.get(name, unknown) for name in CHANNELS], axis=-1)
    with errors_about(path):
        return of_maps(vars(Materials.of_planes(planes)), unknown.shape)
