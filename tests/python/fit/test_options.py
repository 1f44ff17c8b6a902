"""Options of `decompose`: what is taken, and what is refused by name."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pbrfit
from pbrfit.synthetic import make_scene

SCENE = make_scene("room", size=8, lights=2, held_out=1)

UNUSABLE: dict[str, tuple[str, list[Any]]] = {
    "solver": ("one of gauss-newton, lbfgsb, found", ["auto", "adam", "LBFGSB", "", None, 3]),
    "robust": ("one of auto, none, found", ["l1", "huber", None, 1]),
    "refine_normals": ("one of off, auto, on, found", ["yes", "", "ON", None, True]),
    "iterations": ("", [4.5, -1]),
    "threads": ("", [-1, 10**20]),
    "time_limit": ("seconds, 0 or more", [float("inf"), -1.0]),
    "sh_order": ("", [1, 4, -2, 2.5, "2", "3", None]),
    "metallic": ("", [-0.1, 1.1, np.nan, "0", "free", True, [0.0, 0.0], 1j]),
}
"""What the message goes on with after "expected", and values."""


@pytest.mark.parametrize(
    ("name", "value"), [(name, value) for name, (_, values) in UNUSABLE.items() for value in values]
)
def test_unusable_options_are_named(name: str, value: Any) -> None:
    with pytest.raises(pbrfit.InputError, match=f"^{name}: expected {UNUSABLE[name][0]}"):
        pbrfit.decompose(SCENE, **{name: value})


def test_numpy_numbers_are_options(tmp_path: Path) -> None:
    numbers: dict[str, Any] = {
        "iterations": np.int64(3),
        "time_limit": np.float32(9),
        "sh_order": np.int64(2),
        "metallic": np.float32(0.5),
        "robust": "none",
    }
    result = pbrfit.decompose(SCENE, **numbers)
    result.save(tmp_path / "out")
    options = pbrfit.Result.load(tmp_path / "out").options
    assert options == result.options
    for name, value in numbers.items():
        assert getattr(options, name) == value
        assert type(getattr(result.options, name)) in (int, float, str)


def test_a_wrong_keyword_says_whose_it_is_and_help_has_each_option() -> None:
    with pytest.raises(TypeError, match=r"max_size is an option of Scene.load\(path, max_size="):
        pbrfit.decompose(SCENE, max_size=8)
    with pytest.raises(TypeError, match=r"expected options solver, .*, found 'max_sise'"):
        pbrfit.decompose(SCENE, max_sise=8)
    with pytest.raises(TypeError, match=r"Scene.load: expected options fov, .*, found 'solver'"):
        pbrfit.Scene.load("none", solver="lbfgsb")
    said = pbrfit.decompose.__doc__ or ""
    for one in dataclasses.fields(pbrfit.FitOptions):
        assert f"\n{one.name}\n    " in said
