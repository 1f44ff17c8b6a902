"""PyTorch with automatic differentiation: two forms of the loss, each eager and compiled."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray

from peers.case import BAND_OF, DIELECTRIC_F0, DIFFUSE, Case, band_polynomials


class Torch:
    """The peer: `form` makes the loss from the constants, `compiled` sends it through inductor."""

    def __init__(
        self,
        case: Case,
        threads: int,
        *,
        form: Callable[[Case], Callable[..., torch.Tensor]],
        compiled: bool,
    ) -> None:
        torch.set_num_threads(threads)
        loss = form(case)
        self._loss = torch.compile(loss, dynamic=False) if compiled else loss
        self._unknowns = [torch.tensor(part, requires_grad=True) for part in case.unpack()]

    def evaluate(self) -> float:
        """The loss; the gradient is kept in the tensors."""
        for unknown in self._unknowns:
            unknown.grad = None
        loss = self._loss(*self._unknowns)
        loss.backward()
        return float(loss.detach())

    def gradient(self) -> NDArray[np.float64]:
        """Of the last evaluation, in the order of x."""
        return np.concatenate(
            [unknown.grad.numpy().astype(np.float64).ravel() for unknown in self._unknowns]
        )


class Factors:
    """The part of the model that both forms share: kd, ks (3, P) and the band weights (4, P)."""

    def __init__(self, case: Case) -> None:
        self._cosine = torch.tensor(case.cosine)
        self._schlick = (1 - self._cosine) ** 5
        self._polynomials = torch.tensor(band_polynomials(), dtype=torch.float32)

    def __call__(
        self, albedo: torch.Tensor, roughness: torch.Tensor, metallic: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """From albedo (3, P), roughness and metallic (P,)."""
        f0 = DIELECTRIC_F0 + metallic * (albedo - DIELECTRIC_F0)
        fresnel = f0 + (1 - f0) * self._schlick
        k = roughness**4 / 2
        g1 = self._cosine / (self._cosine * (1 - k) + k)
        kd = (1 - fresnel) * (1 - metallic) * albedo / math.pi
        return kd, fresnel * g1 / 4, self._polynomials @ self._powers(2 * roughness - 1)

    def _powers(self, s: torch.Tensor) -> torch.Tensor:
        powers = [torch.ones_like(s), s]
        for j in range(2, self._polynomials.shape[1]):
            powers.append(powers[j // 2] * powers[j - j // 2])
        return torch.stack(powers)


def einsum_form(case: Case) -> Callable[..., torch.Tensor]:
    """As one reads it from the paper: a diffuse and a specular sum over coefficients a picture."""
    factors = Factors(case)
    diffuse_basis = torch.tensor(case.diffuse_basis)
    mirror_basis = torch.tensor(case.mirror_basis)
    one_hot = torch.nn.functional.one_hot(torch.tensor(BAND_OF), 4).float()  # (16, 4)
    targets = torch.tensor(case.images.transpose(1, 0, 2).copy())  # (P, N, 3)

    def loss(
        albedo: torch.Tensor, roughness: torch.Tensor, metallic: torch.Tensor, lights: torch.Tensor
    ) -> torch.Tensor:
        kd, ks, h = factors(albedo, roughness, metallic)
        diffuse = torch.einsum("pk,nkc->pnc", diffuse_basis, lights[:, :DIFFUSE])
        specular_basis = torch.einsum("lp,kl->pk", h, one_hot) * mirror_basis
        specular = torch.einsum("pk,nkc->pnc", specular_basis, lights)
        image = kd.T[:, None] * diffuse + ks.T[:, None] * specular
        return torch.mean((image - targets) ** 2)

    return loss


def matrix_form(case: Case) -> Callable[..., torch.Tensor]:
    """One matrix W a channel that takes lights to pixels: three products in all."""
    factors = Factors(case)
    diffuse_basis = torch.nn.functional.pad(
        torch.tensor(case.diffuse_basis.T.copy()), (0, 0, 0, 16 - DIFFUSE)
    )
    mirror_basis = torch.tensor(case.mirror_basis.T.copy())  # (16, P)
    one_hot = torch.nn.functional.one_hot(torch.tensor(BAND_OF), 4).float()  # (16, 4)
    targets = torch.tensor(case.images.transpose(2, 0, 1).copy())  # (3, N, P)

    def loss(
        albedo: torch.Tensor, roughness: torch.Tensor, metallic: torch.Tensor, lights: torch.Tensor
    ) -> torch.Tensor:
        kd, ks, h = factors(albedo, roughness, metallic)
        specular_basis = (one_hot @ h) * mirror_basis
        w = kd[:, None] * diffuse_basis + ks[:, None] * specular_basis  # (3, 16, P)
        image = torch.bmm(lights.permute(2, 0, 1), w)
        return torch.nn.functional.mse_loss(image, targets)

    return loss


EagerEinsum = partial(Torch, form=einsum_form, compiled=False)
EagerMatrix = partial(Torch, form=matrix_form, compiled=False)
CompiledEinsum = partial(Torch, form=einsum_form, compiled=True)
CompiledMatrix = partial(Torch, form=matrix_form, compiled=True)
