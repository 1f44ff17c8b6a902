"""`Objective.value_and_grad(x, out=...)`: the gradient in memory that the caller owns."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pbrfit import InputError, Objective, Priors
from pbrfit.synthetic import make_scene


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"metallic": 0.0},
        {"mono_light": True},
        {"sh_order": 2},
        {"priors": Priors(cohesion=1.0)},
    ],
    ids=lambda options: next(iter(options), "all"),
)
def test_a_gradient_goes_where_it_is_asked_to(options: dict[str, Any]) -> None:
    """To the same bits, and every entry: what was there before does not matter."""
    objective = Objective(make_scene("room", size=12, lights=3, held_out=1, seed=2), **options)
    x = objective.start()
    loss, gradient = objective.value_and_grad(x)
    out = np.full(objective.size, np.nan)
    again, given = objective.value_and_grad(x, out=out)
    assert given is out
    assert again == loss
    np.testing.assert_array_equal(out, gradient)
    itself = x.copy()
    assert objective.value_and_grad(itself, out=itself)[0] == loss
    np.testing.assert_array_equal(itself, gradient)


@pytest.mark.parametrize("mono_light", [False, True])
def test_memory_that_cannot_take_a_gradient_is_refused(mono_light: bool) -> None:
    scene = make_scene("room", size=8, lights=3, held_out=1, seed=2)
    objective = Objective(scene, mono_light=mono_light)
    x, size = objective.start(), objective.size
    for out in (np.empty(size - 1), np.empty(size, np.float32), "here"):
        with pytest.raises(InputError, match="out: expected"):
            objective.value_and_grad(x, out=out)  # type: ignore[arg-type]
    fixed, pieces = np.empty(size), np.empty(2 * size)[::2]
    fixed.setflags(write=False)
    for out, expected in ((pieces, "numbers in one piece"), (fixed, "an array that may be")):
        if not mono_light:
            with pytest.raises(InputError, match=f"out: expected {expected}"):
                objective.value_and_grad(x, out=out)
