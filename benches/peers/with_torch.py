"""PyTorch, compiled: by automatic differentiation, and by hand in blocks; and on a GPU."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray

from pbrfit_evaluation.torch_loss import matrix_form
from peers.by_hand import Constants, block_of, constants, ordered, unknowns
from peers.case import Case

BLOCK = 4096
"""Pixels; the fastest of 1024 to 16384."""


class Automatic:
    """The matrix form of the whole picture, differentiated automatically."""

    device = "cpu"

    def __init__(self, case: Case, threads: int) -> None:
        torch.set_num_threads(threads)
        torch.set_default_device(self.device)
        self._loss = torch.compile(matrix_form(case), dynamic=False)
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
            [unknown.grad.cpu().numpy().astype(np.float64).ravel() for unknown in self._unknowns]
        )


class OnGpu(Automatic):
    """The same on the GPU, where all stays."""

    device = "cuda"


class Kernel:
    """One kernel by hand, on the GPU."""

    def __init__(self, case: Case, threads: int) -> None:
        del threads
        from pbrfit_evaluation.gpu_loss import Kernel as Loss

        self._evaluate = Loss(case)
        self._unknowns = [torch.tensor(part, device="cuda") for part in unknowns(case)]
        self._found: list[torch.Tensor] = []

    def evaluate(self) -> float:
        """The loss; the gradient is kept on the GPU."""
        loss, *self._found = self._evaluate(*self._unknowns)
        return float(loss)

    def gradient(self) -> NDArray[np.float64]:
        """Of the last evaluation, in the order of x."""
        maps, lights = (part.cpu().numpy() for part in self._found)
        return ordered(maps, lights, 1.0)


class ByHand:
    """Blocks with the gradient by hand, compiled; on a pool of threads, or on torch's own."""

    def __init__(self, case: Case, threads: int, *, pool: bool) -> None:
        self._workers = threads if pool else 1
        torch.set_num_threads(1 if pool else threads)
        self._pool = ThreadPoolExecutor(self._workers)
        maps, lights = unknowns(case)
        self._lights = torch.from_numpy(lights)
        self._blocks = []
        for start in range(0, case.pixels, BLOCK):
            cut = np.s_[..., start : start + BLOCK]
            given = Constants(*(_own(part[cut]) for part in constants(case)))
            self._blocks.append((_own(maps[cut]), given))
        self._evaluate = torch.compile(partial(block_of, torch), dynamic=False)
        self._scale = 2 / case.images.size
        self._found: list[tuple[torch.Tensor, torch.Tensor, torch.Tensor]] = []

    def evaluate(self) -> float:
        """The loss; the gradient is kept, a block each."""
        shares = [self._blocks[i :: self._workers] for i in range(self._workers)]
        done = list(self._pool.map(self._share, shares))
        found = [None] * len(self._blocks)
        for i, share in enumerate(done):
            found[i :: self._workers] = share  # type: ignore[assignment]
        self._found = found  # type: ignore[assignment]
        return sum(float(squares) for squares, *_ in self._found) * self._scale / 2

    def _share(
        self, blocks: list[tuple[torch.Tensor, Constants]]
    ) -> list[tuple[torch.Tensor, torch.Tensor, torch.Tensor]]:
        with torch.no_grad():
            return [self._evaluate(maps, self._lights, given) for maps, given in blocks]

    def gradient(self) -> NDArray[np.float64]:
        """Of the last evaluation, in the order of x."""
        maps = np.concatenate([of_maps.numpy() for _, of_maps, _ in self._found], axis=1)
        lights = np.sum([lights.numpy() for *_, lights in self._found], axis=0)
        return ordered(maps, lights, self._scale)


def _own(part: NDArray[np.float32]) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(part))


OnPool = partial(ByHand, pool=True)
OnItsOwn = partial(ByHand, pool=False)
