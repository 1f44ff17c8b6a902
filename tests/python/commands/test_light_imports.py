"""What is heavy is imported where it is needed, and nowhere before."""

from __future__ import annotations

import subprocess
import sys

import pytest

import pbrfit
from pbrfit.commands import SUMMARIES

HEAVY = (
    "torch",
    "torchvision",
    "diffusers",
    "transformers",
    "accelerate",
    "huggingface_hub",
    "openai",
    "scipy",
    "matplotlib",
)


def heavy_after(statements: str, heavy: tuple[str, ...] = HEAVY) -> list[str]:
    """Which of `heavy` are imported by statements, in a Python of their own."""
    program = f"{statements}\nimport sys\nprint(*[m for m in {heavy} if m in sys.modules])"
    run = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    return run.stdout.splitlines()[-1].split()


def test_the_package_and_the_help_start_without_anything_that_takes_time() -> None:
    statements = "import pbrfit\nfrom pbrfit.cli import _parser\n_parser().format_help()"
    assert heavy_after(statements, ("numpy", "pbrfit._core", *HEAVY)) == []


def test_importing_the_package_imports_nothing_heavy() -> None:
    assert heavy_after("from pbrfit import *", (*HEAVY, "PIL", "importlib.metadata")) == []
    statements = "import pbrfit\npbrfit.decompose, pbrfit.Result"
    shown = ("tqdm", "matplotlib", "PIL", "pbrfit.report", "pbrfit.export")
    assert heavy_after(statements, shown) == []


def test_every_public_name_is_found_and_no_other() -> None:
    assert set(dir(pbrfit)) == {*pbrfit.__all__, "__version__", "kernel"}
    assert all(callable(getattr(pbrfit.kernel, name)) for name in pbrfit.kernel.__all__)
    assert all(getattr(pbrfit, name).__name__ == name for name in pbrfit.__all__)
    with pytest.raises(AttributeError, match="no attribute 'another'"):
        pbrfit.another  # type: ignore[attr-defined]  # noqa: B018 - what is tested


def test_commands_know_their_options_without_anything_heavy() -> None:
    statements = f"""
from contextlib import suppress
from pbrfit.cli import main
for command in {tuple(SUMMARIES)}:
    with suppress(SystemExit):
        main([command, "--help"])
"""
    assert heavy_after(statements) == []


def test_what_is_heavy_would_be_found() -> None:
    assert heavy_after("import scipy") == ["scipy"]
