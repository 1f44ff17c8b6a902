"""Random pixels among surroundings that are made up: rows near those of the open sky, and what they
bring of each picture; and what a slow model in numpy says of them.

    w_ck = Σ_s f_cs T_sk        I_cn = Σ_k w_ck L_nkc + Σ_s f_cs B_snc

with factors f of the matt part and of the rows of the lobe, which depend on the material.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

import reference
from pbrfit import _core
from random_pixels import Array, Example, Kind

STEP = 1e-100
"""Of complex steps: derivatives to all digits."""
UNIFORM = 2 * math.sqrt(math.pi)
GLASS = 0.04
ROWS = {"paper": 5, "principled": 11}
"""The matt part's and the lobe's."""
NOTHING = np.empty((0, 3, 3), np.float32)
"""Triangles of the open sky."""


@dataclass(frozen=True)
class Surroundings(Kind):
    """Which model, and whether surroundings also bring light."""

    model: str = "paper"
    bounce: bool = True


def open_rows(normals: Array, views: Array, model: str) -> NDArray[np.float32]:
    """(P, R, 16) of the open sky."""
    core = _core.Surroundings(NOTHING, np.empty(0, np.uint8))
    seeds = np.arange(len(normals), dtype=np.uint64)
    rows, brought = core.transfer(
        np.zeros_like(normals), normals, views, seeds, rays=1, model=model
    )
    assert brought is None
    return rows


def factors(cosine: Array, albedo: Any, r: Any, metallic: Any, model: str) -> Any:
    """(P, C, R) of materials, albedo (P, C); holds for complex ones."""
    cosine = np.maximum(cosine, reference.CLAMP)
    m = metallic[:, None]
    if model == "paper":
        f0 = GLASS * (1 - m) + m * albedo
        fresnel = f0 + (1 - f0) * (1 - cosine[:, None]) ** 5
        matt = (1 - fresnel) * (1 - m) * albedo / math.pi
        shadowed = fresnel * reference.smith_g1(cosine, r)[:, None] / 4
        return np.concatenate(
            [matt[..., None], shadowed[..., None] * reference._bands(r)[:, None]], axis=-1
        )
    values, by_roughness, _ = _core.lobe_functions(np.real(r).copy(), cosine)
    lobe = values + 1j * np.imag(r)[:, None] * by_roughness
    a, b, mean, glass = lobe[:, :10], lobe[:, 10:20], lobe[:, 20], lobe[:, 21]
    reflected = UNIFORM * (a[:, 0] + b[:, 0])[:, None]

    def scattered(f0: Any) -> Any:
        fresnel = f0 + (1 - f0) / 21
        several = fresnel * mean[:, None] / (1 - fresnel * (1 - mean[:, None]))
        return 1 + several * (1 - reflected) / reflected

    dielectric = glass[:, None] * scattered(GLASS)
    kept = 1 - UNIFORM * dielectric * (GLASS * a[:, :1] + b[:, :1])
    matt = (1 - m) * kept * albedo / math.pi
    base = (1 - m) * GLASS * dielectric + m * albedo * scattered(albedo)
    grazing = (1 - m) * dielectric + m * scattered(albedo)
    rows = base[..., None] * a[:, None] + grazing[..., None] * b[:, None]
    return np.concatenate([matt[..., None], rows], axis=-1)


class Among(Example):
    """Pixels of an `Example` among surroundings."""

    kind: Any

    @cached_property
    def rows(self) -> NDArray[np.float32]:
        """(P, R, 16)"""
        rng = np.random.default_rng(17)
        rows = open_rows(self.given, self.views, self.kind.model)
        return (rows + 0.1 * rng.normal(size=rows.shape)).astype(np.float32)

    @cached_property
    def bounced(self) -> NDArray[np.float32] | None:
        """(P, R, N, C)"""
        if not self.kind.bounce:
            return None
        rng = np.random.default_rng(18)
        shape = self.pixels, ROWS[self.kind.model], self.pictures, self.kind.channels
        return rng.uniform(0, 0.3, shape).astype(np.float32)

    def _factors(self, values: Any, pixels: Any = slice(None)) -> Any:
        """(P, C, R) of values (P, C + 2)."""
        c = self.kind.channels
        cosine = np.sum(self.given[pixels] * self.views[pixels], axis=-1)
        return factors(cosine, values[:, :c], values[:, c], values[:, c + 1], self.kind.model)

    def _shown(self, of_factors: Array, pixels: Any = slice(None)) -> Array:
        """(P, N, C): radiance by factors, or its slopes by theirs."""
        rows = self.rows[pixels, :, : self.kind.coefficients].astype(float)
        shown = np.einsum("pcs,psk,nkc->pnc", of_factors, rows, self.lights, optimize=True)
        if self.bounced is not None:
            shown = shown + np.einsum("pcs,psnc->pnc", of_factors, self.bounced[pixels])
        return np.asarray(shown)

    def radiance(
        self, values: Array, normals: Array | None = None, pixels: Any = slice(None)
    ) -> Array:
        """(P, N, C) by the slow model."""
        assert normals is None or np.array_equal(normals, self.given[pixels])
        return self._shown(np.real(self._factors(values, pixels)), pixels)

    def slopes(self) -> tuple[Array, Array]:
        """As of `Example`, by the slow model."""
        c = self.kind.channels
        steps = [np.zeros(c + 2, complex) for _ in range(3)]
        steps[0][:c] = steps[1][c] = steps[2][c + 1] = 1j * STEP
        moved = [self._shown(np.imag(self._factors(self.truth + step)) / STEP) for step in steps]
        rows = self.rows[..., : self.kind.coefficients].astype(float)
        by_light = np.einsum("pcs,psk->pck", np.real(self._factors(self.truth)), rows)
        return np.stack(moved, axis=-1), np.asarray(by_light)

    def given_bounced(self) -> NDArray[np.float32] | None:
        """(P, R, N·C), as the core takes it."""
        if self.bounced is None:
            return None
        return self.bounced.reshape(*self.bounced.shape[:2], -1)

    def problem(self, threads: int = 1, **options: Any) -> _core.Problem:
        """As of `Example`, with the tables."""
        given = {"model": self.kind.model, "transfer": self.rows, "bounced": self.given_bounced()}
        return super().problem(threads, **(given | options))
