"""Errors between maps or pictures: pure functions on arrays.

NaN pixels, which are the ones outside the mask, never enter.
"""

from __future__ import annotations

import math

import numpy as np

from pbrfit._core import InputError
from pbrfit.io.color import over_channels
from pbrfit.values.arrays import Array, Floats, Mask
from pbrfit.values.checks import reals

PROTOCOL = (
    "pbrfit-1: RMSE over valid pixels and channels, linear values; "
    "recon with the samples' weights; relight under true lights"
)


def rmse(found: Floats, true: Floats, weights: Floats | None = None) -> float:
    """Root mean square difference over the entries that are NaN in neither array.

    Weights are how much each entry counts, 0 or more, of a shape that broadcasts to theirs; None =
    all the same. Entries of weight 0 never enter, whatever they are. Raises ValueError if the
    shapes differ, or no entry is left that is NaN in neither array and has a weight.
    """
    found, true = reals("found", found), reals("true", true)
    if found.shape != true.shape:
        raise ValueError(f"rmse: expected equal shapes, found {found.shape} and {true.shape}")
    if not found.ndim:  # of single numbers numpy makes no arrays
        found, true = found[None], true[None]
    used = np.isnan(found)
    used |= np.isnan(true)
    np.logical_not(used, out=used)
    if weights is not None:
        weights = reals("weights", weights)
        try:
            weights = np.broadcast_to(weights, found.shape)
        except ValueError:
            expected = f"a shape that broadcasts to {found.shape}"
            raise InputError(f"weights: expected {expected}, found {weights.shape}") from None
        used &= weights > 0
        weights = weights[used].astype(np.float64)
        with np.errstate(over="ignore"):
            if not np.isfinite(weights.sum()):
                raise InputError("weights: expected finite ones of finite sum, found others")
    with np.errstate(over="ignore", invalid="ignore"):  # infinite, or of two infinite numbers
        difference = np.subtract(found, true, dtype=np.float64)
    # A selection takes longer than all else.
    difference = difference.ravel() if used.all() else difference[used]
    if not difference.size:
        raise ValueError("rmse: expected at least one entry that is NaN in neither array")
    largest = float(max(difference.max(), -difference.min()))
    if largest == 0.0:
        return 0.0
    if not math.isfinite(largest):
        return math.inf
    # Divided by the largest, because squares of large radiance overflow.
    difference /= largest
    np.square(difference, out=difference)
    return largest * math.sqrt(float(np.average(difference, weights=weights)))


def scaled_per_channel(found: Floats, true: Floats) -> Array:
    """`found` times the factor per channel (last axis) that brings it closest to `true`.

    Pictures with noise hardly tell that factor of albedo and light.
    """
    found, true = reals("found", found), reals("true", true)
    if found.shape != true.shape or not found.ndim:
        raise ValueError(
            f"scaled_per_channel: expected equal shapes, found {found.shape} and {true.shape}"
        )
    axes = tuple(range(found.ndim - 1))
    both = np.isfinite(found) & np.isfinite(true)
    f = np.where(both, found, 0.0).astype(np.float64)
    t = np.where(both, true, 0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        square, mixed = np.sum(f * f, axis=axes), np.sum(f * t, axis=axes)
        # What cannot be squared in float64 stays as it is.
        sound = (square > 0) & np.isfinite(square) & np.isfinite(mixed)
        factor = np.divide(mixed, square, out=np.ones_like(square), where=sound)
        return np.asarray(found * factor)


def scaled_rmse(found: Floats, true: Floats) -> float:
    """`rmse` after the best factor per channel."""
    return rmse(scaled_per_channel(found, true), true)


def white_of(radiance: Floats) -> float:
    """What to show as white: the 98th percentile of the entries that are not NaN; 1 if not above 0.

    Of the true picture, so that both of a pair are exposed alike.
    """
    bright = float(np.nanpercentile(radiance, 98))
    return bright if bright > 0 else 1.0


def stops(white: float) -> float:
    """Exposure, to a tenth of a stop, that shows radiance `white`, above 0, as white."""
    return round(0.0 - math.log2(white), 1)


def showable(picture: Floats, mask: Mask, weights: Floats | None = None) -> tuple[Floats, float]:
    """What can be shown of a picture (H, W, 3), and its white.

    Values that took no part in a fit, outside the mask or of weight (H, W, 3) 0, may be anything:
    they do not decide about the exposure, and pixels are NaN where they are not finite.
    """
    counted = mask[..., None] if weights is None else mask[..., None] & (weights > 0)
    white = white_of(np.where(counted, picture, np.nan))
    finite = over_channels(np.logical_and, np.isfinite(picture))
    return np.where(finite[..., None], picture, np.nan), white
