"""`weights.exr`: how much each value of a scene folder's pictures counts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io import images
from pbrfit.io.quoting import listed
from pbrfit.io.resampling import averaged_channels

WEIGHT_FILE = "weights.exr"

ALL = "Y"
"""Channel of the file that holds for all pictures alike; a picture's own is NAME.Y."""

COLORS = "R", "G", "B"
"""Channels where those of a picture have weights of their own: NAME.R, NAME.G and NAME.B."""


def read_weights(path: Path, names: Sequence[str]) -> NDArray[np.float32]:
    """Read weights.

    The file has a channel `Y`; or for each picture `NAME.Y`, or `NAME.R`, `NAME.G` and `NAME.B`.
    Returns (H, W, 1) for all pictures alike, (N, H, W, 1) in the order of `names`, or (N, H, W, 3)
    where some picture has colours; as stored. Raises InputError if channels are missing, or the
    file has more than one kind for a picture.
    """
    channels = images.read_channels(path)
    found = {name: _own(path, channels, name) for name in names}
    own = {name: weights for name, weights in found.items() if weights is not None}
    if ALL in channels:
        if own:
            raise InputError(f"{path}: expected channel Y or those of {min(own)}, found both")
        return channels[ALL][..., None]
    missing = [name for name in names if name not in own]
    if missing:
        raise InputError(
            f"{path}: expected channel Y, or NAME.Y, or NAME.R, NAME.G and NAME.B, for each "
            f"picture, found none of {missing[0]} among {listed(channels)}"
        )
    colors = max(weights.shape[-1] for weights in own.values())
    return np.stack(
        [np.broadcast_to(weights, (*weights.shape[:2], colors)) for weights in own.values()]
    )


def _own(
    path: Path, channels: Mapping[str, NDArray[np.float32]], name: str
) -> NDArray[np.float32] | None:
    """(H, W, 1) or (H, W, 3) of a picture; None where it has none of its own."""
    every = [f"{name}.{ALL}", *(f"{name}.{color}" for color in COLORS)]
    found = [channel for channel in every if channel in channels]
    if found not in ([], every[:1], every[1:]):
        raise InputError(
            f"{path}: expected {name}.Y, or {name}.R, {name}.G and {name}.B, found {listed(found)}"
        )
    return np.stack([channels[channel] for channel in found], axis=-1) if found else None


def write_weights(path: Path, weights: NDArray[np.floating[Any]], names: Sequence[str]) -> None:
    """Write weights (H, W), (N, H, W) or (N, H, W, 3): what is alike is there once."""
    if weights.ndim < 4:
        weights = weights[..., None]
    if weights.ndim == 3:
        weights = weights[None]
    grey = [not np.ptp(own, axis=-1).any() for own in weights]
    alike = all(grey) and all(np.array_equal(weights[0, ..., 0], own[..., 0]) for own in weights)
    if alike:
        images.write_exr(path, {ALL: weights[0, ..., 0]})
        return
    channels: dict[str, NDArray[np.floating[Any]]] = {}
    for name, own, is_grey in zip(names, weights, grey, strict=True):
        kinds = (ALL,) if is_grey else COLORS
        channels |= {f"{name}.{kind}": own[..., c] for c, kind in enumerate(kinds)}
    images.write_exr(path, channels)


def reduced(weights: NDArray[np.floating[Any]], size: tuple[int, int]) -> NDArray[np.float64]:
    """Weights (..., H, W, C) of samples that are averaged down to (height, width).

    A weight is the inverse of a variance. The mean of samples with variances 1/ω_i and shares s_i
    has the variance Σ s_i² / ω_i. With equal shares, 1/n, that is n^-1 times the mean of 1/ω_i,
    and only ratios of weights matter: the weight of the mean is the harmonic mean of the weights.
    It is 0 as soon as one of them is.
    """
    every = weights.reshape(-1, *weights.shape[-3:])
    with np.errstate(divide="ignore"):
        # An infinite variance stays in the pixels that it has a part in.
        small = [1.0 / averaged_channels(1.0 / one.astype(np.float64), size) for one in every]
    return np.reshape(small, (*weights.shape[:-3], *size, weights.shape[-1]))
