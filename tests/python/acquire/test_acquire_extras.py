"""A missing extra is one line with the command that installs it."""

from __future__ import annotations

import importlib.util

import pytest

from pbrfit._core import InputError
from pbrfit.acquire import extras
from pbrfit.acquire.generators import create


def without(missing: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    """Let Python find all modules but these."""
    found = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name in missing else found(name)
    )


@pytest.mark.parametrize("extra", ["diffusion", "openai", "segment"])
def test_a_missing_extra_is_named_with_its_command(
    extra: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    without(("torch",), monkeypatch)
    expected = f"expected the Python package torch, found none: pip install 'pbrfit\\[{extra}\\]'$"
    with pytest.raises(InputError, match=expected):
        extras.need(extra, "numpy", "torch")


def test_what_is_there_is_not_asked_for() -> None:
    extras.need("diffusion", "numpy", "PIL")


def test_an_extra_that_there_is_none_of_is_a_mistake_of_ours() -> None:
    with pytest.raises(ValueError, match="extra: expected one of diffusion, openai, segment"):
        extras.need("difusion", "numpy")


def test_flux_without_diffusers_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    without(("torch", "diffusers", "transformers", "accelerate"), monkeypatch)
    with pytest.raises(InputError, match=r"pip install 'pbrfit\[diffusion\]'"):
        create("flux2-klein")


def test_versions_of_what_is_not_installed_are_left_out() -> None:
    assert set(extras.versions("numpy", "no-such-package")) == {"numpy"}
