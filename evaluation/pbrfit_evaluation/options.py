"""Options that suites declare, and those that several share."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from pbrfit.commands.arguments import positive, whole_number
from pbrfit.model.reflection import MODELS, Model

Add = Callable[[argparse.ArgumentParser], object]
"""Adds an option to a parser."""

BOTH = "both"
"""Value of `--model` for every model, one after the other."""


def option(*flags: str, **settings: Any) -> Add:
    """One option as data; settings as of `argparse.ArgumentParser.add_argument`."""
    return lambda parser: parser.add_argument(*flags, **settings)


def count(flag: str, metavar: str, what: str, **settings: Any) -> Add:
    """A whole number above 0; without a default it is that of the suite's `effort`."""
    return option(flag, metavar=metavar, type=positive, help=what, **settings)


def several(
    flag: str,
    metavar: str,
    choices: Iterable[str],
    few: Iterable[str] = (),
    *,
    what: str = "only these",
    default: str = "all",
    **settings: Any,
) -> Add:
    """Some of several names, `default` in words; `few` are those of `--quick`."""
    names = tuple(choices)
    default += f", with --quick {', '.join(few)}" if few else ""
    told = f"{what} (default: {default}): {', '.join(names)}"
    return option(flag, metavar=metavar, nargs="+", choices=names, help=told, **settings)


def first_seed(of: str, untuned: int | None = None) -> Add:
    """`--first-seed`, that of the first `of`.

    The default is `untuned`, from which on no seed served to choose anything; without it, that of
    the suite's `effort`.
    """
    said = f"of the first {of}"
    if untuned is not None:
        said += " (default: %(default)s; nothing was tuned on seeds from there on)"
    return option("--first-seed", metavar="SEED", type=whole_number, default=untuned, help=said)


def model_option(what: str) -> Add:
    """`--model` of a suite that can do both; `models` reads it."""
    return option(
        "--model",
        choices=(*MODELS, BOTH),
        default=BOTH,
        help=f"what {what}, of `pbrfit decompose --model` (default: %(default)s)",
    )


def models(options: argparse.Namespace) -> tuple[Model, ...]:
    """Those that `--model` asks for."""
    return MODELS if options.model == BOTH else (options.model,)


def folders(what: str) -> Add:
    """`FOLDER ...`, for pictures that are on this machine."""
    return option("folders", metavar="FOLDER", nargs="*", type=Path, help=what)
