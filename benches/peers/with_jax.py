"""JAX, compiled by XLA: by automatic differentiation, and by hand in blocks."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from peers.by_hand import Constants, block_of, constants, ordered, unknowns
from peers.case import BAND_OF, DIELECTRIC_F0, DIFFUSE, Case, band_polynomials

ONE_HOT = np.eye(4, dtype=np.float32)[list(BAND_OF)]  # (16, 4)

BLOCK = 4096
"""Pixels; the fastest of 1024 to 16384."""


class Automatic:
    """The matrix form of the whole picture, differentiated automatically.

    A loop over channels and this order of the axes: a batch of W (16, P) takes 4 times as long.
    """

    platform = "cpu"

    def __init__(self, case: Case, threads: int) -> None:
        del threads  # XLA takes it from the environment when it starts
        jax.config.update("jax_platforms", self.platform)
        self._value_and_grad = jax.jit(jax.value_and_grad(_loss_of(case), argnums=(0, 1, 2, 3)))
        self._unknowns = [jnp.asarray(part) for part in case.unpack()]
        self._gradient: Any = None

    def evaluate(self) -> float:
        """The loss; the gradient is kept."""
        value, self._gradient = jax.block_until_ready(self._value_and_grad(*self._unknowns))
        return float(value)

    def gradient(self) -> NDArray[np.float64]:
        """Of the last evaluation, in the order of x."""
        return np.concatenate([np.asarray(part, np.float64).ravel() for part in self._gradient])


class OnGpu(Automatic):
    """The same on the GPU."""

    platform = "cuda"


def _loss_of(case: Case) -> Any:
    cosine = jnp.asarray(case.cosine)
    schlick = (1 - cosine) ** 5
    polynomials = band_polynomials().astype(np.float32)
    diffuse_basis = jnp.pad(case.diffuse_basis, ((0, 0), (0, 16 - DIFFUSE)))
    mirror_basis = jnp.asarray(case.mirror_basis)  # (P, 16)
    targets = jnp.asarray(case.images.transpose(2, 1, 0))  # (3, P, N)

    def loss(
        albedo: jax.Array, roughness: jax.Array, metallic: jax.Array, lights: jax.Array
    ) -> jax.Array:
        f0 = DIELECTRIC_F0 + metallic * (albedo - DIELECTRIC_F0)
        fresnel = f0 + (1 - f0) * schlick
        k = roughness**4 / 2
        ks = fresnel * cosine / (cosine * (1 - k) + k) / 4
        kd = (1 - fresnel) * (1 - metallic) * albedo / math.pi
        s = 2 * roughness - 1
        h = jnp.stack([jnp.polyval(p[::-1], s, unroll=32) for p in polynomials])
        specular_basis = (h.T @ ONE_HOT.T) * mirror_basis
        total = jnp.zeros(())
        for c in range(3):
            w = kd[c, :, None] * diffuse_basis + ks[c, :, None] * specular_basis
            total += jnp.mean((w @ lights[:, :, c].T - targets[c]) ** 2)
        return total / 3

    return loss


class ByHand:
    """Blocks with the gradient by hand, one after the other in compiled code, on a pool."""

    def __init__(self, case: Case, threads: int) -> None:
        jax.config.update("jax_platforms", "cpu")
        self._pool = ThreadPoolExecutor(threads)
        maps, lights = unknowns(case)
        self._lights = jnp.asarray(lights)
        self._shares = []
        size = min(BLOCK, case.pixels)
        whole = case.pixels // size * size
        for share in np.array_split(np.arange(whole // size), threads):
            if len(share):
                start, end = share[0] * size, (share[-1] + 1) * size
                self._shares.append(_stacked(maps, constants(case), start, end, size))
        if whole < case.pixels:
            self._shares.append(
                _stacked(maps, constants(case), whole, case.pixels, case.pixels - whole)
            )
        self._evaluate = jax.jit(_scan)
        self._scale = 2 / case.images.size
        self._found: list[Any] = []

    def evaluate(self) -> float:
        """The loss; the gradient is kept, a share each."""
        self._found = list(self._pool.map(self._share, self._shares))
        return sum(float(squares) for squares, *_ in self._found) * self._scale / 2

    def _share(self, share: tuple[Any, Any]) -> Any:
        return jax.block_until_ready(self._evaluate(*share, self._lights))

    def gradient(self) -> NDArray[np.float64]:
        """Of the last evaluation, in the order of x."""
        maps = np.concatenate(
            [np.asarray(of).transpose(1, 0, 2).reshape(5, -1) for _, of, _ in self._found], axis=1
        )
        lights = np.sum([np.asarray(lights) for *_, lights in self._found], axis=0)
        return ordered(maps, lights, self._scale)


def _stacked(maps: Any, given: Constants, start: int, end: int, size: int) -> tuple[Any, Any]:
    """Blocks of a share along a first axis."""

    def of(part: NDArray[np.float32]) -> jax.Array:
        blocks = part[..., start:end].reshape(*part.shape[:-1], -1, size)
        return jnp.asarray(np.ascontiguousarray(np.moveaxis(blocks, -2, 0)))

    return of(maps), Constants(*map(of, given))


def _scan(maps: Any, given: Constants, lights: Any) -> tuple[Any, Any, Any]:
    def step(sums: Any, block: Any) -> Any:
        squares, by_maps, by_lights = block_of(jnp, block[0], lights, block[1])
        return (sums[0] + squares, sums[1] + by_lights), by_maps

    start = (jnp.zeros(()), jnp.zeros_like(lights))
    (squares, by_lights), by_maps = jax.lax.scan(step, start, (maps, given))
    return squares, by_maps, by_lights
