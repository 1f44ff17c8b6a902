"""The loss in PyTorch, to be differentiated automatically.

Only for those who have PyTorch: this module imports it, so import this module inside functions.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch

from pbrfit.model.lighting import BAND_OF
from pbrfit_evaluation.float32_model import DIELECTRIC_F0, DIFFUSE, View, band_polynomials


class Factors:
    """What any form of the loss needs: kd, ks (3, P) and the band weights (4, P)."""

    def __init__(self, view: View) -> None:
        self._cosine = torch.tensor(view.cosine)
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


def matrix_form(view: View) -> Callable[..., torch.Tensor]:
    """One weight matrix W (P, 16) a channel, I = W Lᵀ. A loop over channels beats one batch."""
    factors = Factors(view)
    diffuse_basis = torch.nn.functional.pad(torch.tensor(view.diffuse_basis), (0, 16 - DIFFUSE))
    mirror_basis = torch.tensor(view.mirror_basis)  # (P, 16)
    bands = one_hot()
    targets = torch.tensor(view.images.transpose(2, 1, 0).copy())  # (3, P, N)

    def loss(
        albedo: torch.Tensor, roughness: torch.Tensor, metallic: torch.Tensor, lights: torch.Tensor
    ) -> torch.Tensor:
        kd, ks, h = factors(albedo, roughness, metallic)
        specular_basis = (h.T @ bands.T) * mirror_basis
        total = torch.zeros(())
        for c in range(3):
            w = kd[c, :, None] * diffuse_basis + ks[c, :, None] * specular_basis
            total = total + torch.nn.functional.mse_loss(w @ lights[:, :, c].T, targets[c])
        return total / 3

    return loss


def one_hot() -> torch.Tensor:
    """(16, 4), takes bands to coefficients. Indexing in its place cripples eager gradients."""
    return torch.nn.functional.one_hot(torch.tensor(BAND_OF), 4).float()
