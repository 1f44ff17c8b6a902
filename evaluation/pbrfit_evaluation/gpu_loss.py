"""Loss and gradient in one CUDA kernel by hand, the fastest peer we know of.

A thread is a pixel. For one channel, with its weights w (16), lights L (N, 16), targets t (N):

    e = L w − t        ∂/∂w = Lᵀ e        ∂/∂L = Σ e wᵀ over pixels        (of ½ Σ e²)

e and w of a block's pixels meet in shared memory, where each thread sums 4 × 4 entries of ∂/∂L over
an eighth of the pixels. Nothing else leaves the registers: memory is read once, 4 (31 + 3 N) bytes
a pixel, and the gradient written once. A block takes every so-manieth 128 pixels. Sums of blocks
are added in a fixed order, so that the bits are the same each time.

PyTorch holds the arrays; CuPy, which is imported where the kernel is made, compiles it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from pbrfit_evaluation.float32_model import (
    BAND_DEGREE,
    DIELECTRIC_F0,
    Float32,
    View,
    band_polynomials,
)

SOURCE = Path(__file__).with_name("gpu_loss.cu")

PIXELS = 128
"""Of a block, as in the source."""

BLOCKS_PER_MULTIPROCESSOR = 3
"""So many have room there for their registers."""


class Kernel:
    """The loss of a view, mean of e² over samples, on the GPU."""

    def __init__(self, view: View) -> None:
        import cupy  # type: ignore[import-not-found, unused-ignore]

        scale = 2 / view.images.size
        rows = ",".join(
            "{" + ",".join(f"{c:.9e}f" for c in row) + "}" for row in band_polynomials()
        )
        head = (
            f"constexpr int PICTURES = {len(view.images)}, TERMS = {BAND_DEGREE + 1};\n"
            f"constexpr float F0 = {DIELECTRIC_F0}f, SCALE = {scale:.9e}f;\n"
            f"constexpr float POLYNOMIALS[4][TERMS] = {{{rows}}};\n"
        )
        source = head + SOURCE.read_text(encoding="utf-8")
        self._kernel = cupy.RawKernel(source, "loss", options=("--std=c++17",))
        self._pixels = np.int32(view.pixels)
        self._constants = (
            _there(view.diffuse_basis.T),
            _there(view.mirror_basis.T),
            _there(view.cosine),
            _there(view.images.transpose(2, 0, 1)),
        )
        most = torch.cuda.get_device_properties(0).multi_processor_count * BLOCKS_PER_MULTIPROCESSOR
        self._blocks = min(-(-view.pixels // PIXELS), most)
        shape = (self._blocks, 3, len(view.images), 16)
        self._by_lights = torch.empty(shape, device="cuda")
        self._losses = torch.empty(self._blocks, device="cuda")

    def __call__(
        self, maps: torch.Tensor, lights: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Loss, and its gradients by maps (5, P) and lights (3, N, 16), both in one piece."""
        by_maps = torch.empty_like(maps)
        given = (maps, *self._constants, lights, by_maps, self._by_lights, self._losses)
        places = (part.data_ptr() for part in given)
        self._kernel((self._blocks,), (PIXELS,), (*places, self._pixels))
        return self._losses.sum(), by_maps, self._by_lights.sum(0)


def _there(part: Float32) -> torch.Tensor:
    return torch.tensor(np.ascontiguousarray(part, np.float32), device="cuda")
