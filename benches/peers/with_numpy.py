"""numpy with the gradient by hand, as in `by_hand`: blocks on a pool, one BLAS thread each."""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from peers.case import BANDS, DIELECTRIC_F0, DIFFUSE, Case, Float32, band_polynomials

FIRST_OF_BAND = [band.start for band in BANDS]


BLOCK = 8192
"""Pixels; the fastest of 1024 to 32768."""


class Blocks:
    """The peer."""

    def __init__(self, case: Case, threads: int) -> None:
        self._albedo, self._roughness, self._metallic, lights = case.unpack()
        self._lights = np.ascontiguousarray(lights.transpose(2, 0, 1))
        self._targets = np.ascontiguousarray(case.images.transpose(2, 0, 1))
        self._diffuse = np.ascontiguousarray(case.diffuse_basis.T)
        self._mirror = np.ascontiguousarray(case.mirror_basis.T)
        self._cosine = case.cosine
        self._schlick = (1 - case.cosine) ** 5
        polynomials = band_polynomials()
        slopes = np.zeros_like(polynomials)
        slopes[:, :-1] = 2 * np.arange(1, polynomials.shape[1]) * polynomials[:, 1:]
        self._bands = np.concatenate([polynomials, slopes]).astype(np.float32)
        self._pixels = case.pixels
        self._scale = 2 / case.images.size
        self._maps = np.empty((5, case.pixels), dtype=np.float32)
        self._by_lights = np.empty(0)
        self._workers = threads
        self._pool = ThreadPoolExecutor(self._workers)
        self._blas = ThreadpoolController()

    def evaluate(self) -> float:
        """The loss; the gradient is kept."""
        blocks = [
            slice(start, min(start + BLOCK, self._pixels))
            for start in range(0, self._pixels, BLOCK)
        ]
        shares = [blocks[i :: self._workers] for i in range(self._workers)]
        with self._blas.limit(limits=1):
            parts = list(self._pool.map(self._share, shares))
        self._by_lights = self._scale * np.sum([by_lights for _, by_lights in parts], axis=0)
        return sum(squares for squares, _ in parts) * self._scale / 2

    def gradient(self) -> NDArray[np.float64]:
        """Of the last evaluation, in the order of x."""
        return np.concatenate([self._maps.ravel(), self._by_lights.transpose(1, 2, 0).ravel()])

    def _share(self, blocks: list[slice]) -> tuple[float, NDArray[np.float64]]:
        squares, by_lights = 0.0, np.zeros(self._lights.shape)
        for block in blocks:
            squares += self._block(block, by_lights)
        return squares, by_lights

    def _block(self, block: slice, by_lights: NDArray[np.float64]) -> float:
        r, m, x = self._roughness[block], self._metallic[block], self._cosine[block]
        diffuse, mirror = self._diffuse[:, block], self._mirror[:, block]
        h, dh = self._band_weights(r)
        specular_basis = np.empty_like(mirror)
        for l, band in enumerate(BANDS):
            np.multiply(h[l], mirror[band], out=specular_basis[band])
        r3 = r * r * r
        k = 0.5 * (r3 * r)
        inverse = 1 / (x * (1 - k) + k)
        g1 = 0.25 * (x * inverse)
        dg1 = -0.5 * (x * (1 - x)) * (inverse * inverse) * r3
        transmission = 1 - self._schlick[block]
        dielectric = (1 - m) * np.float32(1 / math.pi)
        by_roughness, by_metallic = np.zeros_like(r), np.zeros_like(r)
        squares = 0.0
        for c in range(3):
            rho = self._albedo[c, block]
            f0 = DIELECTRIC_F0 + m * (rho - DIELECTRIC_F0)
            fresnel = 1 - (1 - f0) * transmission
            ks = fresnel * g1
            kd = (1 - fresnel) * dielectric * rho
            w = ks * specular_basis
            w[:DIFFUSE] += kd * diffuse
            e = self._lights[c] @ w
            e -= self._targets[c, :, block]
            squares += float(np.vdot(e, e))
            by_lights[c] += e @ w.T
            by_w = self._lights[c].T @ e

            by_kd = np.einsum("kp,kp->p", by_w[:DIFFUSE], diffuse)
            by_w *= mirror
            sums = np.add.reduceat(by_w, FIRST_OF_BAND, axis=0)
            by_ks = np.einsum("lp,lp->p", h, sums)
            by_roughness += ks * np.einsum("lp,lp->p", dh, sums) + fresnel * dg1 * by_ks
            transmitted = (1 - fresnel) * by_kd
            by_f0 = transmission * (g1 * by_ks - dielectric * rho * by_kd)
            self._maps[c, block] = self._scale * (dielectric * transmitted + m * by_f0)
            by_metallic += (rho - DIELECTRIC_F0) * by_f0 - rho * transmitted * (1 / math.pi)
        self._maps[3, block] = self._scale * by_roughness
        self._maps[4, block] = self._scale * by_metallic
        return squares

    def _band_weights(self, r: Float32) -> tuple[Float32, Float32]:
        """h_l and dh_l/dr, (4, P) each."""
        powers = np.empty((self._bands.shape[1], len(r)), dtype=np.float32)
        powers[0] = 1
        powers[1] = 2 * r - 1
        for j in range(2, len(powers)):
            np.multiply(powers[j - 1], powers[1], out=powers[j])
        both = self._bands @ powers
        return both[:4], both[4:]
