"""`weights.exr`: how much each sample of a scene folder counts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io import images
from pbrfit.io.quoting import listed
from pbrfit.io.resampling import averaged

WEIGHT_FILE = "weights.exr"

ALL = "Y"
"""Channel that holds for all pictures alike; a picture's own is NAME.Y."""


def read_weights(path: Path, names: Sequence[str]) -> NDArray[np.float32]:
    """Read weights.

    The file has a channel `Y`, or `NAME.Y` for each picture. Returns (H, W) for all pictures alike,
    or (N, H, W) in the order of `names`; as stored. Raises InputError if channels are missing, or
    the file has both kinds.
    """
    channels = images.read_channels(path)
    own = [name for name in names if f"{name}.{ALL}" in channels]
    if ALL in channels and not own:
        return channels[ALL]
    if ALL in channels:
        raise InputError(f"{path}: expected channel Y or {own[0]}.Y, found both")
    missing = [name for name in names if name not in own]
    if missing:
        raise InputError(
            f"{path}: expected channel Y, or NAME.Y for each picture, found no {missing[0]}.Y "
            f"among {listed(channels)}"
        )
    return np.stack([channels[f"{name}.{ALL}"] for name in names])


def write_weights(path: Path, weights: NDArray[np.floating[Any]], names: Sequence[str]) -> None:
    """Write weights (H, W) or (N, H, W): one channel where they are the same in all pictures."""
    if weights.ndim == 2 or all(np.array_equal(weights[0], own) for own in weights[1:]):
        images.write_exr(path, {ALL: weights if weights.ndim == 2 else weights[0]})
        return
    own = {f"{name}.{ALL}": one for name, one in zip(names, weights, strict=True)}
    images.write_exr(path, own)


def reduced(weights: NDArray[np.floating[Any]], size: tuple[int, int]) -> NDArray[np.float64]:
    """Weights (..., H, W) of samples that are averaged down to (height, width).

    A weight is the inverse of a variance. The mean of samples with variances 1/ω_i and shares s_i
    has the variance Σ s_i² / ω_i. With equal shares, 1/n, that is n^-1 times the mean of 1/ω_i,
    and only ratios of weights matter: the weight of the mean is the harmonic mean of the weights.
    It is 0 as soon as one of them is.
    """
    planes = weights.reshape(-1, *weights.shape[-2:])
    with np.errstate(divide="ignore"):
        # averaged() keeps an infinite variance to the pixels that it has a part in.
        small = [1.0 / averaged(1.0 / plane.astype(np.float64), size) for plane in planes]
    return np.stack(small).reshape(*weights.shape[:-2], *size)
