"""A missing extra is one line with the command that installs it."""

from __future__ import annotations

import importlib.util

import pytest

from pbrfit._core import InputError
from pbrfit.acquire import weights
from pbrfit.acquire.generators import create


def test_a_missing_extra_is_named_with_its_command(monkeypatch: pytest.MonkeyPatch) -> None:
    weights.need("diffusion", "numpy", "PIL")  # which are there
    found = importlib.util.find_spec
    missing = ("torch", "diffusers", "transformers", "accelerate")
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name in missing else found(name)
    )
    expected = r"expected the Python package torch, found none: pip install 'pbrfit\[segment\]'$"
    with pytest.raises(InputError, match=expected):
        weights.need("segment", "numpy", "torch")
    with pytest.raises(InputError, match=r"pip install 'pbrfit\[diffusion\]'"):
        create("flux2-klein")


def test_versions_of_what_is_not_installed_are_left_out() -> None:
    assert set(weights.versions("numpy", "no-such-package")) == {"numpy"}
