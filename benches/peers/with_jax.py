"""JAX with automatic differentiation, compiled by XLA: two forms of the loss."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from peers.case import BAND_OF, DIELECTRIC_F0, DIFFUSE, Case, band_polynomials

ONE_HOT = np.eye(4, dtype=np.float32)[list(BAND_OF)]  # (16, 4)


class Jax:
    """The peer: `form` makes the loss from the constants."""

    def __init__(
        self, case: Case, threads: int, *, form: Callable[[Case], Callable[..., jax.Array]]
    ) -> None:
        del threads  # XLA takes it from the environment when it starts
        loss = form(case)
        self._value_and_grad = jax.jit(jax.value_and_grad(loss, argnums=(0, 1, 2, 3)))
        self._unknowns = [jnp.asarray(part) for part in case.unpack()]
        self._gradient: Any = None

    def evaluate(self) -> float:
        """The loss; the gradient is kept."""
        value, self._gradient = jax.block_until_ready(self._value_and_grad(*self._unknowns))
        return float(value)

    def gradient(self) -> NDArray[np.float64]:
        """Of the last evaluation, in the order of x."""
        return np.concatenate([np.asarray(part, np.float64).ravel() for part in self._gradient])


class Factors:
    """The part of the model that both forms share: kd, ks (3, P) and the band weights (4, P)."""

    def __init__(self, case: Case) -> None:
        self._cosine = jnp.asarray(case.cosine)
        self._schlick = (1 - self._cosine) ** 5
        self._polynomials = band_polynomials().astype(np.float32)

    def __call__(
        self, albedo: jax.Array, roughness: jax.Array, metallic: jax.Array
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        """From albedo (3, P), roughness and metallic (P,)."""
        f0 = DIELECTRIC_F0 + metallic * (albedo - DIELECTRIC_F0)
        fresnel = f0 + (1 - f0) * self._schlick
        k = roughness**4 / 2
        g1 = self._cosine / (self._cosine * (1 - k) + k)
        kd = (1 - fresnel) * (1 - metallic) * albedo / math.pi
        return kd, fresnel * g1 / 4, self._bands(2 * roughness - 1)

    def _bands(self, s: jax.Array) -> jax.Array:
        return jnp.stack([jnp.polyval(p[::-1], s, unroll=32) for p in self._polynomials])


def einsum_form(case: Case) -> Callable[..., jax.Array]:
    """As one reads it from the paper: a diffuse and a specular sum over coefficients a picture."""
    factors = Factors(case)
    diffuse_basis = jnp.asarray(case.diffuse_basis.T)  # (9, P)
    mirror_basis = jnp.asarray(case.mirror_basis.T)  # (16, P)
    targets = jnp.asarray(case.images.transpose(2, 0, 1))  # (3, N, P)

    def loss(
        albedo: jax.Array, roughness: jax.Array, metallic: jax.Array, lights: jax.Array
    ) -> jax.Array:
        kd, ks, h = factors(albedo, roughness, metallic)
        diffuse = jnp.einsum("kp,nkc->cnp", diffuse_basis, lights[:, :DIFFUSE])
        specular_basis = (ONE_HOT @ h) * mirror_basis
        specular = jnp.einsum("kp,nkc->cnp", specular_basis, lights)
        image = kd[:, None] * diffuse + ks[:, None] * specular
        return jnp.mean((image - targets) ** 2)

    return loss


def matrix_form(case: Case) -> Callable[..., jax.Array]:
    """One weight matrix W (P, 16) a channel, I = W Lᵀ.

    A loop over channels and this order of the axes: a batch of W (16, P) takes 4 times as long.
    """
    factors = Factors(case)
    diffuse_basis = jnp.pad(case.diffuse_basis, ((0, 0), (0, 16 - DIFFUSE)))
    mirror_basis = jnp.asarray(case.mirror_basis)  # (P, 16)
    targets = jnp.asarray(case.images.transpose(2, 1, 0))  # (3, P, N)

    def loss(
        albedo: jax.Array, roughness: jax.Array, metallic: jax.Array, lights: jax.Array
    ) -> jax.Array:
        kd, ks, h = factors(albedo, roughness, metallic)
        specular_basis = (h.T @ ONE_HOT.T) * mirror_basis
        total = jnp.zeros(())
        for c in range(3):
            w = kd[c, :, None] * diffuse_basis + ks[c, :, None] * specular_basis
            total += jnp.mean((w @ lights[:, :, c].T - targets[c]) ** 2)
        return total / 3

    return loss


JitEinsum = partial(Jax, form=einsum_form)
JitMatrix = partial(Jax, form=matrix_form)
