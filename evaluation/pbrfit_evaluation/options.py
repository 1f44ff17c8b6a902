"""Settings of suites: what each is with `--quick` and without, and its option."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from pbrfit.commands import arguments
from pbrfit.commands.arguments import Flag, choice, positive, value, whole_number
from pbrfit.model.reflection import MODELS, Model

BOTH = "both"
"""Value of `--model` for every model, one after the other."""


@dataclass(frozen=True)
class Setting:
    """A size, a count, or whatever else a suite depends on."""

    full: Any
    quick: Any
    """`full` and `quick`: without `--quick` and with it."""
    flag: Flag | None = None
    """The option, without a default of its own; None = there is none."""
    name: str = ""
    """Of the option, where it is not that of the setting."""


def fixed(full: Any, flag: Flag) -> Setting:
    """One that `--quick` does not change."""
    said = f"{flag['help']} (default: {full})" if full not in (None, False) else flag["help"]
    return Setting(full, full, {**flag, "help": said})


def count(metavar: str, what: str, full: int, quick: int | None = None) -> Setting:
    """A whole number above 0."""
    quick = full if quick is None else quick
    less = f", with --quick {quick}" if quick != full else ""
    return Setting(full, quick, value(metavar, positive, f"{what} (default: {full}{less})"))


def several(
    metavar: str,
    choices: Iterable[str],
    few: Iterable[str] = (),
    *,
    default: Iterable[str] = (),
    what: str = "only these",
    name: str = "",
) -> Setting:
    """Some of several names, all by default; `few` are those of `--quick`."""
    names = tuple(choices)
    full = tuple(default) or names
    quick = tuple(few) or full
    told = ", ".join(full) if full != names else "all"
    told += f", with --quick {', '.join(quick)}" if quick != full else ""
    flag = choice(names, f"{what} (default: {told}): {', '.join(names)}", metavar=metavar)
    return Setting(full, quick, {**flag, "nargs": "+"}, name)


def first_seed(of: str, untuned: int) -> Setting:
    """That of the first `of`; no seed from there on served to choose anything."""
    said = f"of the first {of}; nothing was tuned on seeds from the default on"
    return fixed(untuned, value("SEED", whole_number, said))


threads = Setting(0, 0, arguments.THREADS)
"""`run` gets as many as are asked for."""


def models(options: argparse.Namespace) -> tuple[Model, ...]:
    """Those that `--model` asks for."""
    return MODELS if options.model == BOTH else (options.model,)
