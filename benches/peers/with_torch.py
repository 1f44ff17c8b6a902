"""PyTorch with automatic differentiation: two forms of the loss, each eager and compiled."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray

from pbrfit_evaluation.torch_loss import einsum_form, matrix_form
from peers.case import Case


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


EagerEinsum = partial(Torch, form=einsum_form, compiled=False)
EagerMatrix = partial(Torch, form=matrix_form, compiled=False)
CompiledEinsum = partial(Torch, form=einsum_form, compiled=True)
CompiledMatrix = partial(Torch, form=matrix_form, compiled=True)
