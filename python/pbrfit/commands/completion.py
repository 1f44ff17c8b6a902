"""`pbrfit completion`: a script by which a shell completes commands, options and their values.

It is made from the parsers themselves, by shtab.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from contextlib import redirect_stderr, suppress
from pathlib import Path
from typing import Any

from pbrfit import commands
from pbrfit.commands.arguments import DONE

SHELLS = ("bash", "zsh", "fish")

USE = """
how to use it:
  bash   eval "$(pbrfit completion bash)"                      in ~/.bashrc
  zsh    eval "$(pbrfit completion zsh)"                       in ~/.zshrc, after compinit
  fish   pbrfit completion fish > ~/.config/fish/completions/pbrfit.fish
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add its options."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = USE
    parser.add_argument("shell", metavar="|".join(SHELLS), choices=SHELLS, help="your shell")


def run(options: argparse.Namespace) -> int:
    """Print the script."""
    import shtab  # nothing else needs it

    parser = whole_parser()
    for action in _actions(parser):
        metavar = action.metavar if isinstance(action.metavar, str) else ""
        if action.type is Path or re.search(r"\b(FILE|FOLDER|DIR)\b", metavar):
            action.complete = shtab.FILE  # type: ignore[attr-defined]  # by which shtab knows it
    print(shtab.complete(parser, options.shell))
    return DONE


def whole_parser() -> argparse.ArgumentParser:
    """All commands with their options, and below `evaluate` its suites where they are installed."""
    parser = _Whole(prog="pbrfit")
    below = parser.add_subparsers()
    for name, said in commands.SUMMARIES.items():
        of_command = below.add_parser(name, help=said)
        with suppress(SystemExit), redirect_stderr(None):  # `evaluate` without its distribution
            commands.add_options_of(name, of_command)
        for suite in subcommands(of_command).values():
            if suite.complete is not None:
                suite.complete(suite)
    return parser


def subcommands(parser: argparse.ArgumentParser) -> dict[str, Any]:
    """The parsers below one, by name."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}


def _actions(parser: argparse.ArgumentParser) -> list[argparse.Action]:
    return [*parser._actions, *(one for of in subcommands(parser).values() for one in _actions(of))]


class _Whole(argparse.ArgumentParser):
    """A parser that is looked at and never parses."""

    def __init__(self, *, complete: Callable[[Any], None] | None = None, **arguments: Any) -> None:
        super().__init__(**arguments)
        self.complete = complete
