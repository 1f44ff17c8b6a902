"""Who takes part."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from peers.case import Case


class Peer(Protocol):
    """A way to the loss and its gradient, with the unknowns in its own form."""

    def evaluate(self) -> float:
        """The loss. Returns when the gradient is there too."""

    def gradient(self) -> NDArray[np.float64]:
        """Of the last evaluation, in the order of the case's x."""


@dataclass(frozen=True)
class Entry:
    """A peer by name: nothing of it is imported before `load`."""

    name: str
    package: str
    module: str
    attribute: str

    def load(self) -> Callable[[Case, int], Peer]:
        """What makes the peer of a case and a number of threads."""
        maker: Callable[[Case, int], Peer] = getattr(import_module(self.module), self.attribute)
        return maker


OURS = "pbrfit"

ROSTER = tuple(
    Entry(*row)
    for row in (
        (OURS, "pbrfit", "peers.ours", "Ours"),
        ("numpy, blocks by hand", "numpy", "peers.with_numpy", "Blocks"),
        ("numba, blocks by hand", "numba", "peers.with_numba", "ByHand"),
        ("torch.compile, automatic", "torch", "peers.with_torch", "Automatic"),
        ("torch.compile, blocks by hand", "torch", "peers.with_torch", "OnItsOwn"),
        ("the same on a pool", "torch", "peers.with_torch", "OnPool"),
        ("jax.jit, automatic", "jax", "peers.with_jax", "Automatic"),
        ("jax.jit, blocks by hand", "jax", "peers.with_jax", "ByHand"),
        ("torch.compile, automatic, on the GPU", "torch", "peers.with_torch", "OnGpu"),
        ("jax.jit, automatic, on the GPU", "jax", "peers.with_jax", "OnGpu"),
        ("a CUDA kernel by hand, on the GPU", "torch", "peers.with_torch", "Kernel"),
    )
)
