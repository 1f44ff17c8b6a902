"""Packages that only some parts need, and how to get them."""

from __future__ import annotations

import importlib.util
from importlib import metadata

from pbrfit._core import InputError

EXTRAS = ("diffusion", "openai", "segment")
"""Sets of optional packages, as `pyproject.toml` names them."""


def need(extra: str, *modules: str) -> None:
    """Check that modules can be imported, without importing them, which may take seconds.

    Parameters
    ----------
    extra
        Which of `EXTRAS` brings them.
    modules
        Top-level names, as they are imported.

    Raises
    ------
    InputError
        If one is missing: one line with the command that installs it.
    """
    if extra not in EXTRAS:
        raise ValueError(f"extra: expected one of {', '.join(EXTRAS)}, found {extra!r}")
    missing = [name for name in modules if importlib.util.find_spec(name) is None]
    if missing:
        raise InputError(
            f"expected the Python package{'s' if len(missing) > 1 else ''} {', '.join(missing)}, "
            f"found none: {command(extra)}"
        )


def command(extra: str) -> str:
    """The command that installs an extra."""
    return f"pip install 'pbrfit[{extra}]'"


def versions(*packages: str) -> dict[str, str]:
    """Versions of installed packages, for records of how something was made."""
    found = {}
    for package in packages:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return found
