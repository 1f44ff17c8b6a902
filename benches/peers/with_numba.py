# mypy: disable-error-code="import-not-found,untyped-decorator"
"""numba: loops over blocks of pixels, gradient by hand, compiled by LLVM with fast arithmetic.

Products are written so that pixels are the vector: four pictures, or all sixteen coefficients, use
each number that is loaded.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from peers.by_hand import constants, ordered, unknowns
from peers.case import BAND_OF, DIELECTRIC_F0, DIFFUSE, Case, band_polynomials

BLOCK = 256
"""Pixels; the fastest of 64 to 1024."""

BAND = np.array(BAND_OF)
F0 = np.float32(DIELECTRIC_F0)
INVERSE_PI = np.float32(1 / math.pi)


class ByHand:
    """The peer."""

    def __init__(self, case: Case, threads: int) -> None:
        self._threads = threads
        self._maps, self._lights = unknowns(case)
        self._given = constants(case)
        polynomials = band_polynomials().astype(np.float32)
        slopes = np.zeros_like(polynomials)
        slopes[:, :-1] = 2 * np.arange(1, polynomials.shape[1]) * polynomials[:, 1:]
        self._bands = np.concatenate([polynomials, slopes])
        self._scale = 2 / case.images.size
        self._by_maps = np.empty_like(self._maps)
        self._by_lights = np.empty(0)

    def evaluate(self) -> float:
        """The loss; the gradient is kept."""
        numba.set_num_threads(self._threads)
        squares, by_lights = _all(
            self._maps, self._lights, *self._given, self._bands, self._by_maps, self._threads
        )
        self._by_lights = by_lights.sum(axis=0)
        return float(squares.sum()) * self._scale / 2

    def gradient(self) -> NDArray[np.float64]:
        """Of the last evaluation, in the order of x."""
        return ordered(self._by_maps, self._by_lights, self._scale)


@njit(parallel=True, fastmath=True, cache=False)
def _all(  # type: ignore[no-untyped-def]
    maps, lights, diffuse, mirror, cosine, schlick, targets, bands, by_maps, shares
) -> Any:
    pixels = maps.shape[1]
    blocks = (pixels + BLOCK - 1) // BLOCK
    squares = np.zeros(shares)
    channels, pictures, coefficients = lights.shape
    by_lights = np.zeros((shares, channels, pictures, coefficients))
    for share in prange(shares):
        for block in range(share * blocks // shares, (share + 1) * blocks // shares):
            start, end = block * BLOCK, min((block + 1) * BLOCK, pixels)
            squares[share] += _block(
                maps[:, start:end],
                lights,
                diffuse[:, start:end],
                mirror[:, start:end],
                cosine[start:end],
                schlick[start:end],
                targets[:, :, start:end],
                bands,
                by_maps[:, start:end],
                by_lights[share],
            )
    return squares, by_lights


@njit(fastmath=True, cache=False)
def _block(  # type: ignore[no-untyped-def]
    maps, lights, diffuse, mirror, cosine, schlick, targets, bands, by_maps, by_lights
) -> Any:
    size, pictures = maps.shape[1], lights.shape[1]
    h = np.empty((8, size), np.float32)
    for l in range(8):
        for p in range(size):
            s = np.float32(2) * maps[3, p] - np.float32(1)
            value = bands[l, 16]
            for j in range(15, -1, -1):
                value = value * s + bands[l, j]
            h[l, p] = value
    specular = np.empty((16, size), np.float32)
    for k in range(16):
        for p in range(size):
            specular[k, p] = h[BAND[k], p] * mirror[k, p]
    g1 = np.empty(size, np.float32)
    dg1 = np.empty(size, np.float32)
    for p in range(size):
        r, x = maps[3, p], cosine[p]
        r3 = r * r * r
        k2 = np.float32(0.5) * r3 * r
        inverse = np.float32(1) / (x * (np.float32(1) - k2) + k2)
        g1[p] = np.float32(0.25) * x * inverse
        dg1[p] = np.float32(-0.5) * (x * (np.float32(1) - x)) * inverse * inverse * r3
        by_maps[3, p] = np.float32(0)
        by_maps[4, p] = np.float32(0)
    w = np.empty((16, size), np.float32)
    e = np.empty((pictures, size), np.float32)
    by_w = np.empty((16, size), np.float32)
    total = 0.0
    for c in range(3):
        for k in range(16):
            for p in range(size):
                rho, m = maps[c, p], maps[4, p]
                f0 = F0 + m * (rho - F0)
                fresnel = np.float32(1) - (np.float32(1) - f0) * (np.float32(1) - schlick[p])
                w[k, p] = fresnel * g1[p] * specular[k, p]
                if k < DIFFUSE:
                    kd = (np.float32(1) - fresnel) * (np.float32(1) - m) * INVERSE_PI * rho
                    w[k, p] += kd * diffuse[k, p]
        total += _residuals(lights[c], w, targets[c], e)
        _by_weights(lights[c], e, by_w)
        _by_lights(e, w, by_lights[c])
        for p in range(size):
            rho, m = maps[c, p], maps[4, p]
            transmission = np.float32(1) - schlick[p]
            dielectric = (np.float32(1) - m) * INVERSE_PI
            f0 = F0 + m * (rho - F0)
            fresnel = np.float32(1) - (np.float32(1) - f0) * transmission
            by_kd = np.float32(0)
            for k in range(DIFFUSE):
                by_kd += by_w[k, p] * diffuse[k, p]
            by_ks = np.float32(0)
            slope = np.float32(0)
            for k in range(16):
                product = by_w[k, p] * mirror[k, p]
                by_ks += h[BAND[k], p] * product
                slope += h[4 + BAND[k], p] * product
            transmitted = (np.float32(1) - fresnel) * by_kd
            by_f0 = transmission * (g1[p] * by_ks - dielectric * rho * by_kd)
            by_maps[c, p] = dielectric * transmitted + m * by_f0
            by_maps[3, p] += fresnel * (g1[p] * slope + dg1[p] * by_ks)
            by_maps[4, p] += (rho - F0) * by_f0 - rho * transmitted * INVERSE_PI
    return total


@njit(fastmath=True, cache=False)
def _residuals(lights, w, targets, e):  # type: ignore[no-untyped-def]
    """E = L W − T; returns Σ e²."""
    pictures, size = e.shape
    total = 0.0
    for n in range(pictures):
        l = lights[n]
        of_picture = np.float32(0)
        for p in range(size):
            value = -targets[n, p]
            for k in range(16):
                value += l[k] * w[k, p]
            e[n, p] = value
            of_picture += value * value
        total += float(of_picture)
    return total


@njit(fastmath=True, cache=False)
def _by_weights(lights, e, by_w):  # type: ignore[no-untyped-def]
    """∂/∂W = Lᵀ e."""
    pictures, size = e.shape
    for k in range(16):
        by_w[k] = np.float32(0)
    first = pictures % 4
    for k in range(16):
        for n in range(first):
            for p in range(size):
                by_w[k, p] += lights[n, k] * e[n, p]
        for n in range(first, pictures, 4):
            a, b = lights[n, k], lights[n + 1, k]
            c, d = lights[n + 2, k], lights[n + 3, k]
            for p in range(size):
                by_w[k, p] += a * e[n, p] + b * e[n + 1, p] + c * e[n + 2, p] + d * e[n + 3, p]


@njit(fastmath=True, cache=False)
def _by_lights(e, w, by_lights):  # type: ignore[no-untyped-def]
    """∂/∂L += e Wᵀ, four coefficients at a time."""
    pictures, size = e.shape
    for n in range(pictures):
        for k in range(0, 16, 4):
            a = b = c = d = np.float32(0)
            for p in range(size):
                a += e[n, p] * w[k, p]
                b += e[n, p] * w[k + 1, p]
                c += e[n, p] * w[k + 2, p]
                d += e[n, p] * w[k + 3, p]
            by_lights[n, k] += a
            by_lights[n, k + 1] += b
            by_lights[n, k + 2] += c
            by_lights[n, k + 3] += d
