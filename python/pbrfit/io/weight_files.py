"""`weights.exr`: how much each value of a scene folder's pictures counts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pbrfit.io import images
from pbrfit.io.input_files import unexpected
from pbrfit.io.resampling import averaged_channels
from pbrfit.values.arrays import Array, Floats
from pbrfit.values.quoting import listed

WEIGHT_FILE = "weights.exr"

ALL = "Y"
"""Channel of the file that holds for all pictures alike; a picture's own is NAME.Y."""

COLORS = "R", "G", "B"
"""Channels where those of a picture have weights of their own: NAME.R, NAME.G and NAME.B."""


def read_weights(path: Path, names: Sequence[str]) -> NDArray[np.float32]:
    """Read weights from channels as of `ALL` and `COLORS`.

    Returns (H, W, 1) for all pictures alike, (N, H, W, 1) in the order of `names`, or (N, H, W, 3)
    where some picture has colours; as stored. InputError if a picture has channels of no one kind.
    """
    channels = images.read_channels(path)
    own = []
    for name in names:
        every = [f"{name}.{kind}" for kind in (ALL, *COLORS)]
        found = [channel for channel in (ALL, *every) if channel in channels]
        if found not in ([ALL], every[:1], every[1:]):
            expected = f"channel Y, or {name}.Y, or {name}.R, {name}.G and {name}.B"
            others = f"none of them among {listed(channels)}"
            raise unexpected(path, expected, listed(found) or others)
        own.append([channels[channel] for channel in found])
    if ALL in channels:
        return channels[ALL][..., None]
    colors = max(map(len, own))
    return np.stack([np.stack(of * (colors // len(of)), axis=-1) for of in own])


def write_weights(path: Path, weights: Floats, names: Sequence[str]) -> None:
    """Write weights (H, W), (N, H, W) or (N, H, W, 3): what is alike is there once."""
    if weights.ndim < 4:
        weights = weights[..., None]
    weights = weights.reshape(-1, *weights.shape[-3:])
    if (weights == weights[0, ..., :1]).all():
        images.write_exr(path, {ALL: weights[0, ..., 0]})
        return
    channels: dict[str, Floats] = {}
    for name, own in zip(names, weights, strict=True):
        kinds = COLORS if np.ptp(own, axis=-1).any() else (ALL,)
        channels |= {f"{name}.{kind}": own[..., c] for c, kind in enumerate(kinds)}
    images.write_exr(path, channels)


def reduced(weights: Floats, size: tuple[int, int]) -> Array:
    """Weights (..., H, W, C) of samples that are averaged down to (height, width).

    A weight is the inverse of a variance. The mean of samples with variances 1/ω_i and shares s_i
    has the variance Σ s_i² / ω_i. With equal shares, 1/n, that is n^-1 times the mean of 1/ω_i,
    and only ratios count: the weight of the mean is the harmonic mean of weights, 0 if one is.
    """
    every = weights.reshape(-1, *weights.shape[-3:])
    with np.errstate(divide="ignore"):
        # An infinite variance stays in the pixels that it has a part in.
        small = [1.0 / averaged_channels(1.0 / one.astype(np.float64), size) for one in every]
    return np.reshape(small, (*weights.shape[:-3], *size, weights.shape[-1]))
