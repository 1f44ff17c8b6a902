"""The command line: one command a verb. Nothing imports this file."""

from __future__ import annotations

import argparse
import difflib
import io
import logging
import os
import re
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any, NoReturn

from pbrfit import address_space
from pbrfit.commands import SUMMARIES, add_commands
from pbrfit.commands.arguments import DONE, INTERRUPTED, UNUSABLE, complain, in_one_line
from pbrfit.commands.messages import in_flags, unread
from pbrfit.values.quoting import visible

PRINTED_AT_ONCE = ("-h", "--help", "--version")
"""What needs neither a command nor the core, whose start takes longer than all the rest."""

START = """pbrfit PHOTOS               a folder of pictures of one view under different lights
pbrfit demo out             the same with a scene that is made up
pbrfit decompose --help     what can be set; pbrfit --help lists all commands"""

ALIKE = 0.7
"""Likeness of two names, as `difflib` has it from 0 to 1, from which on one may be a misspelling
of the other: of eight letters two may be wrong."""


def run() -> NoReturn:
    """Be the process of a command: it ends within a second of Ctrl-C, whatever it is doing."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # it was closed; a file would take its number
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w"))
    watched = len(sys.argv) > 1 and sys.argv[1] not in PRINTED_AT_ONCE
    try:
        if watched:
            address_space.check_limits()
            address_space.check_libraries()
            from pbrfit import ending

            ending.watch()
        sys.exit(main(watched=watched))
    except (MemoryError, OSError) as error:  # of `watch`: no thread can be started
        complain(in_one_line(error))
        sys.exit(UNUSABLE)
    except KeyboardInterrupt:  # while modules load
        complain("interrupted")
        sys.exit(INTERRUPTED)


def main(arguments: Sequence[str] | None = None, *, watched: bool = False) -> int:
    """Run a command; returns one of the exit codes that `commands.arguments` names.

    `watched` is True in a process that `ending.watch` was called in.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # a terminal that lacks a sign: no reason
    given = sys.argv[1:] if arguments is None else arguments
    if not given:
        print(START)
        return DONE
    path = Path(given[0])
    if path.exists() or path.name != given[0]:  # pictures in place of a command
        given = given if given[0] in SUMMARIES or given[0][:1] == "-" else ["decompose", *given]
    options = _parser().parse_args(given)
    from pbrfit import ending
    from pbrfit._core import InputError, last_word

    def end_with(message: str) -> None:
        """Complain, unless the watcher has said why."""
        if not watched or last_word():
            complain(message)

    unwinding = ending.unwinding_when_told(watched=watched)
    try:
        with _logging_to_stderr(quiet=getattr(options, "quiet", False)), unwinding:
            command: Callable[[argparse.Namespace], int] = options.command
            code = command(options)
            sys.stdout.flush()
            return code
    except BrokenPipeError:  # whoever read has read enough
        unread()
        return DONE
    except (InputError, OSError, MemoryError, RuntimeError) as error:
        line = in_one_line(error)
        if isinstance(error, RuntimeError) and line.startswith(type(error).__name__):
            raise  # nothing of the system's
        end_with(line)
        if isinstance(error, OSError):
            unread()
        return UNUSABLE
    except ArithmeticError as error:  # of numbers in the input that no check foresaw
        if sys.flags.dev_mode:
            raise
        place = traceback.extract_tb(error.__traceback__)[-1]
        what = in_one_line(error)
        end_with(
            f"expected numbers that can be computed with, found {what} in {place.name}, "
            f"{Path(place.filename).name}:{place.lineno}; PYTHONDEVMODE=1 shows the way "
            "there"
        )
        return UNUSABLE
    except KeyboardInterrupt as interrupt:
        end_with(str(interrupt) or ending.WORD)
        return INTERRUPTED
    except ending.Terminated:
        end_with(ending.WORD)
        raise


class _HelpFormatter(argparse.ArgumentDefaultsHelpFormatter):
    """Tells defaults, but not of switches and of options whose help says it in words."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        if action.default is None or action.default is False:
            return action.help
        return super()._get_help_string(action)


class _Parser(argparse.ArgumentParser):
    """Parser that complains in one line, with what was meant, and takes no shortened flags.

    `complete` adds its options when it is first asked to parse: those of one command of many.
    """

    def __init__(
        self, *, complete: Callable[[argparse.ArgumentParser], None] | None = None, **arguments: Any
    ) -> None:
        super().__init__(allow_abbrev=False, formatter_class=_HelpFormatter, **arguments)
        self._complete = complete
        # What begins as a negative number is a value and no option: `--light -40,30`.
        self._negative_number_matcher = re.compile(r"-\.?\d")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        if self._complete is not None:
            complete, self._complete = self._complete, None
            complete(self)
        self._check_options(sys.argv[1:] if args is None else args)
        return super().parse_known_args(args, namespace)

    def _check_options(self, arguments: Sequence[str]) -> None:
        """Complain of an unknown option before anything that it may have led to.

        A misspelt `--out` is told as that, and not as an `--out` that is missing.
        """
        known = self._option_string_actions
        for argument in arguments:
            name = argument.partition("=")[0]
            if argument == "--" or (self._subparsers is not None and name[:1] != "-"):
                return  # what follows are values, or belongs to a command
            if name[:1] == "-" and name not in known and not re.match(r"-$|-\.?\d|.* ", name):
                meant = _meant(f"--{name.lstrip('-')}", list(known))
                self.error(f"unrecognized option {name}{meant}")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            choices = [str(choice) for choice in action.choices]
            meant = _meant(str(value), choices) or f" (choose from {', '.join(choices)})"
            raise argparse.ArgumentError(action, f"invalid choice: {value!r}{meant}")

    def error(self, message: str) -> NoReturn:
        end = " " if message.endswith("?") else "; "
        self.exit(UNUSABLE, f"{self.prog}: {message}{end}see {self.prog} --help\n")


def _meant(found: str, known: Sequence[str]) -> str:
    """Say which of the known names may have been meant; empty where none is like it."""
    longer = [name for name in known if name.startswith(found)]
    close = longer or difflib.get_close_matches(found, known, n=1, cutoff=ALIKE)
    return f"; did you mean {close[0]}?" if close else ""


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="pbrfit",
        description="Recover physically based materials (albedo, roughness, metallic) and the "
        "lighting of each picture from several pictures of one view under different lights.",
        usage="%(prog)s [--version] COMMAND ...\n       %(prog)s PHOTOS ...   as decompose",
    )
    parser.add_argument("--version", action="version", version=f"pbrfit {version('pbrfit')}")
    commands = parser.add_subparsers(
        metavar="COMMAND", required=True, title="commands", prog=parser.prog
    )

    add_commands(commands)
    return parser


class _InFlags(logging.Formatter):
    """What the library says of its options, in flags; no name in it steers the terminal."""

    def format(self, record: logging.LogRecord) -> str:
        return visible(in_flags(super().format(record)))


@contextmanager
def _logging_to_stderr(*, quiet: bool) -> Iterator[None]:
    handler = logging.StreamHandler()
    handler.setFormatter(_InFlags("pbrfit: %(levelname)s: %(message)s"))
    handler.setLevel(logging.ERROR if quiet else logging.WARNING)
    logger = logging.getLogger("pbrfit")
    logger.addHandler(handler)
    logging.captureWarnings(True)  # what libraries warn of is said to programmers alone
    try:
        yield
    finally:
        logging.captureWarnings(False)
        logger.removeHandler(handler)


if __name__ == "__main__":
    run()
