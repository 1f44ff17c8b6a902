"""An objective as a function that PyTorch differentiates."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from pbrfit import InputError, Objective
from pbrfit.synthetic import make_scene

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "pytorch.py"


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("mono_light", [False, True])
def test_its_gradient_takes_part_in_a_graph(dtype: torch.dtype, mono_light: bool) -> None:
    objective = Objective(make_scene("room", size=8, lights=2), mono_light=mono_light)
    x = torch.from_numpy(objective.start()).to(dtype).requires_grad_()
    value, gradient = objective.value_and_grad(x.detach().double().numpy())
    loss = objective.torch()(x)
    assert loss.dtype == dtype
    (3 * loss**2 + x.sum()).backward()
    digits = 1e-12 if dtype == torch.float64 else 1e-6
    np.testing.assert_allclose(loss.item(), value, rtol=digits)
    np.testing.assert_allclose(x.grad, 6 * value * gradient + 1, rtol=digits)
    with torch.no_grad():
        x[0] = 2.0
    with pytest.raises(InputError, match="albedo"):
        objective.torch()(x)


def test_the_example_lowers_the_loss() -> None:
    command = [sys.executable, str(EXAMPLE), "--steps=60"]
    said = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True).stdout
    first, *_, last = map(float, re.findall(r"loss (\S+)", said))
    assert last < first / 2
