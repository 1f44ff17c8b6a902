"""How alike two pictures look: PSNR and SSIM. NaN pixels never enter."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.io.checks import reals
from pbrfit.result.metrics import rmse


def psnr(found: NDArray[np.floating[Any]], true: NDArray[np.floating[Any]]) -> float:
    """Peak signal-to-noise ratio in dB, 20 log10(1 / RMSE), of values with a range of 1.

    Infinite where both are equal. Raises ValueError as `rmse`.
    """
    error = rmse(found, true)
    return -20 * math.log10(error) if error > 0 else math.inf


SSIM_SIGMA = 1.5
SSIM_RADIUS = 5
SSIM_CONSTANTS = (0.01**2, 0.03**2)


def ssim(found: NDArray[np.floating[Any]], true: NDArray[np.floating[Any]]) -> float:
    """Structural similarity (Wang et al. 2004) of pictures (H, W) or (H, W, C) with a range of 1.

    Means, variances and the covariance are taken in a Gaussian window, sigma 1.5 and 11 pixels
    wide; the index

        (2 μx μy + c1)(2 σxy + c2) / ((μx² + μy² + c1)(σx² + σy² + c2)),  c = 0.01², 0.03²,

    is averaged over pixels and channels. Where the window reaches over the border or over pixels
    that are NaN in either picture, its weights are those of the other pixels, made to sum to 1.
    Raises ValueError if the shapes differ or are not those of pictures, or no pixel is left.
    """
    from scipy.ndimage import correlate1d

    found, true = reals("found", found), reals("true", true)
    if found.shape != true.shape or found.ndim not in (2, 3):
        raise ValueError(
            f"ssim: expected two pictures of one shape, found {found.shape} and {true.shape}"
        )
    x, y = (np.array(a, np.float64).reshape(*a.shape[:2], -1) for a in (found, true))
    valid: NDArray[np.bool_] = np.asarray(~(np.isnan(x) | np.isnan(y)).any(axis=-1))
    if not valid.any() or not x.size:
        raise ValueError("ssim: expected at least one pixel that is NaN in neither picture")
    offsets = np.arange(-SSIM_RADIUS, SSIM_RADIUS + 1)
    kernel = np.exp(-0.5 * (offsets / SSIM_SIGMA) ** 2)

    def window(values: NDArray[np.float64]) -> NDArray[np.float64]:
        along = correlate1d(values, kernel, axis=0, mode="constant")
        return np.asarray(correlate1d(along, kernel, axis=1, mode="constant"))[valid]

    x[~valid] = y[~valid] = 0.0
    weight = window(valid[..., None].astype(np.float64))
    with np.errstate(over="ignore", invalid="ignore"):
        mx, my = window(x) / weight, window(y) / weight
        vx = window(x * x) / weight - mx * mx
        vy = window(y * y) / weight - my * my
        cov = window(x * y) / weight - mx * my
        c1, c2 = SSIM_CONSTANTS
        index = (2 * mx * my + c1) * (2 * cov + c2)
        index /= (mx * mx + my * my + c1) * (vx + vy + c2)
        mean = float(index.mean())
    if not math.isfinite(mean):
        raise ValueError("ssim: expected pictures with a range of 1, found infinite or huge values")
    return mean
