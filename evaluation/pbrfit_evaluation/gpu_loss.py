"""Loss and gradient in one kernel for a GPU, by hand in Triton: the fastest peer we know of.

For one channel, with W (16, B) of a block of pixels, lights L (N, 16) and targets T (N, B):

    e = L W − T        ∂/∂W = Lᵀ e        ∂/∂L = e Wᵀ        (of ½ Σ e²)

No intermediate leaves the chip: memory is read once, 4 (31 + 3 N) bytes a pixel, and the gradient
written once. A program takes every so-manieth block and keeps its sum of ∂/∂L in registers. Sums of
programs are added in a fixed order: the same bits each time.

PyTorch and Triton are imported here: import this module inside functions.
"""

# ruff: noqa: ANN001, ANN202, N803, PLR0913 — Triton reads these functions, Python does not

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
import triton
import triton.language as tl

from pbrfit_evaluation.float32_model import BAND_DEGREE, DIELECTRIC_F0, View, band_polynomials

BLOCK = 64
"""Pixels."""

PROGRAMS_PER_MULTIPROCESSOR = 8

WARPS = 8
"""Of a program."""

PRECISION = "ieee"
"""Of products: three by tensor cores, together as exact as float32."""


@triton.jit
def _channel(rho, target, light, diffuse, specular, mirror, h, dh, shared, f0_dielectric, PREC: tl.constexpr):  # type: ignore[no-untyped-def]  # fmt: skip  # noqa: E501
    """Σ e² and ∂ of one channel: by albedo, roughness, metallic, lights."""
    r3, x, g1, dg1, metallic, transmission = shared
    inv_pi = 0.3183098861837907
    f0 = f0_dielectric + metallic * (rho - f0_dielectric)
    fresnel = 1 - (1 - f0) * transmission
    dielectric = (1 - metallic) * inv_pi
    ks = fresnel * g1
    w = (ks[None, :] * specular) + ((1 - fresnel) * dielectric * rho)[None, :] * diffuse
    e = tl.dot(light, w, input_precision=PREC) - target
    by_light = tl.dot(e, tl.trans(w), input_precision=PREC)
    by_w = tl.dot(tl.trans(light), e, input_precision=PREC)
    by_kd = tl.sum(by_w * diffuse, 0)
    by_ks = tl.sum(by_w * specular, 0)
    by_h = tl.sum(by_w * mirror * dh, 0)
    transmitted = (1 - fresnel) * by_kd
    by_f0 = transmission * (g1 * by_ks - dielectric * rho * by_kd)
    by_rho = dielectric * transmitted + metallic * by_f0
    by_roughness = ks * by_h + fresnel * dg1 * by_ks
    by_metallic = (rho - f0_dielectric) * by_f0 - rho * transmitted * inv_pi
    return tl.sum(e * e, 0), by_rho, by_roughness, by_metallic, by_light


@triton.jit
def _horner(polynomials, band: tl.constexpr, s, TERMS: tl.constexpr):  # type: ignore[no-untyped-def]
    """h_l and dh_l/dr of one band."""
    value = tl.load(polynomials + band * TERMS + TERMS - 1) + s * 0
    slope = s * 0
    for j in tl.static_range(TERMS - 2, -1, -1):
        slope = slope * s + value
        value = value * s + tl.load(polynomials + band * TERMS + j)
    return value, 2 * slope


@triton.jit
def _kernel(maps, diffuses, mirrors, cosines, targets, lights, polynomials, by_maps, by_lights, squares, pixels, pictures, f0, TERMS: tl.constexpr, ROWS: tl.constexpr, BLOCK: tl.constexpr, PREC: tl.constexpr, ROUNDS: tl.constexpr):  # type: ignore[no-untyped-def]  # fmt: skip  # noqa: E501
    """One program: every so-manieth block."""
    program, programs = tl.program_id(0), tl.num_programs(0)
    k, n = tl.arange(0, 16), tl.arange(0, ROWS)
    at = n[:, None] * 16 + k[None, :]
    row = (n < pictures)[:, None]
    light0 = tl.load(lights + at, mask=row, other=0.0)
    light1 = tl.load(lights + pictures * 16 + at, mask=row, other=0.0)
    light2 = tl.load(lights + pictures * 32 + at, mask=row, other=0.0)
    sum0 = tl.zeros((ROWS, 16), tl.float32)
    sum1 = tl.zeros((ROWS, 16), tl.float32)
    sum2 = tl.zeros((ROWS, 16), tl.float32)
    total = tl.zeros((BLOCK,), tl.float32)
    for turn in range(ROUNDS):
        p = (turn * programs + program) * BLOCK + tl.arange(0, BLOCK)
        inside = p < pixels
        r = tl.load(maps + 3 * pixels + p, mask=inside, other=0.5)
        metallic = tl.load(maps + 4 * pixels + p, mask=inside, other=0.0)
        x = tl.load(cosines + p, mask=inside, other=1.0)
        place = k[:, None] * pixels + p[None, :]
        mirror = tl.load(mirrors + place, mask=inside[None, :], other=0.0)
        matt = (k < 9)[:, None] & inside[None, :]
        diffuse = tl.load(diffuses + place, mask=matt, other=0.0)
        s = 2 * r - 1
        h0, dh0 = _horner(polynomials, 0, s, TERMS)
        h1, dh1 = _horner(polynomials, 1, s, TERMS)
        h2, dh2 = _horner(polynomials, 2, s, TERMS)
        h3, dh3 = _horner(polynomials, 3, s, TERMS)
        first, second, third = (k < 1)[:, None], (k < 4)[:, None], (k < 9)[:, None]
        h = tl.where(second, tl.where(first, h0[None, :], h1[None, :]),
                     tl.where(third, h2[None, :], h3[None, :]))  # fmt: skip
        dh = tl.where(second, tl.where(first, dh0[None, :], dh1[None, :]),
                      tl.where(third, dh2[None, :], dh3[None, :]))  # fmt: skip
        specular = h * mirror
        r3 = r * r * r
        half = 0.5 * r3 * r
        inverse = 1 / (x * (1 - half) + half)
        schlick = (1 - x) * (1 - x)
        transmission = 1 - schlick * schlick * (1 - x)
        g1 = 0.25 * x * inverse
        dg1 = -0.5 * x * (1 - x) * inverse * inverse * r3
        shared = r3, x, g1, dg1, metallic, transmission
        sample = n[:, None] * pixels + p[None, :]
        known = row & inside[None, :]
        rho = tl.load(maps + p, mask=inside, other=0.0)
        target = tl.load(targets + sample, mask=known, other=0.0)
        e2, by_rho, by_r, by_m, by_light = _channel(
            rho, target, light0, diffuse, specular, mirror, h, dh, shared, f0, PREC
        )
        sum0 += by_light
        total += e2
        tl.store(by_maps + p, by_rho, mask=inside)
        rho = tl.load(maps + pixels + p, mask=inside, other=0.0)
        target = tl.load(targets + pictures * pixels + sample, mask=known, other=0.0)
        e2, by_rho, more_r, more_m, by_light = _channel(
            rho, target, light1, diffuse, specular, mirror, h, dh, shared, f0, PREC
        )
        sum1 += by_light
        total += e2
        by_r += more_r
        by_m += more_m
        tl.store(by_maps + pixels + p, by_rho, mask=inside)
        rho = tl.load(maps + 2 * pixels + p, mask=inside, other=0.0)
        target = tl.load(targets + 2 * pictures * pixels + sample, mask=known, other=0.0)
        e2, by_rho, more_r, more_m, by_light = _channel(
            rho, target, light2, diffuse, specular, mirror, h, dh, shared, f0, PREC
        )
        sum2 += by_light
        total += e2
        tl.store(by_maps + 2 * pixels + p, by_rho, mask=inside)
        tl.store(by_maps + 3 * pixels + p, by_r + more_r, mask=inside)
        tl.store(by_maps + 4 * pixels + p, by_m + more_m, mask=inside)
    out = by_lights + program * (3 * pictures * 16) + at
    tl.store(out, sum0, mask=row)
    tl.store(out + pictures * 16, sum1, mask=row)
    tl.store(out + pictures * 32, sum2, mask=row)
    tl.store(squares + program, tl.sum(total, 0))


class Kernel:
    """The loss of a view, mean of e² over samples, on a device of PyTorch's."""

    def __init__(self, view: View, device: str = "cuda") -> None:
        def there(part: Any) -> torch.Tensor:
            return torch.tensor(np.ascontiguousarray(part, np.float32), device=device)

        self._constants = (
            there(view.diffuse_basis.T),
            there(view.mirror_basis.T),
            there(view.cosine),
            there(view.images.transpose(2, 0, 1)),
        )
        self._polynomials = there(band_polynomials())
        self._pixels, self._pictures = view.pixels, len(view.images)
        self._samples = view.images.size
        blocks = programs = math.ceil(view.pixels / BLOCK)
        if device == "cuda":
            units = torch.cuda.get_device_properties(0).multi_processor_count
            programs = min(programs, PROGRAMS_PER_MULTIPROCESSOR * units)
        self._rounds = math.ceil(blocks / programs)
        empty = torch.empty((programs, 3, self._pictures, 16), device=device)
        self._by_lights, self._squares = empty, torch.empty(programs, device=device)

    def __call__(
        self, maps: torch.Tensor, lights: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Loss, and its gradients by maps (5, P) and lights (3, N, 16)."""
        by_maps = torch.empty_like(maps)
        _kernel[(len(self._squares),)](
            maps,
            *self._constants,
            lights,
            self._polynomials,
            by_maps,
            self._by_lights,
            self._squares,
            self._pixels,
            self._pictures,
            DIELECTRIC_F0,
            TERMS=BAND_DEGREE + 1,
            ROWS=max(16, triton.next_power_of_2(self._pictures)),
            BLOCK=BLOCK,
            PREC=PRECISION,
            ROUNDS=self._rounds,
            num_warps=WARPS,
        )
        scale = 2 / self._samples
        by_lights = self._by_lights.sum(0)
        return self._squares.sum() * (scale / 2), by_maps.mul_(scale), by_lights.mul_(scale)
