"""Options, exit codes and manners that the commands share."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from pbrfit.commands.messages import complain as complain
from pbrfit.commands.messages import unread_is_no_failure as unread_is_no_failure
from pbrfit.commands.progress import progress_bar as progress_bar
from pbrfit.errors import in_one_line as in_one_line
from pbrfit.values.quoting import visible

if TYPE_CHECKING:
    from pbrfit.result.result import Result

Subcommands = Any
"""What `argparse.ArgumentParser.add_subparsers` returns, which has no public name."""

DONE, SOME_FAILED, UNUSABLE, NO_USABLE_MAP, INTERRUPTED = 0, 1, 2, 3, 130
"""Exit codes: done; some scenes failed; usage or input is wrong; `--strict` found none; Ctrl-C."""

Flag = dict[str, Any]
"""Arguments of `argparse.ArgumentParser.add_argument`, but for the name."""


def switch(said: str) -> Flag:
    """An option without a value; `said` is its help."""
    return {"action": "store_true", "help": said}


def value(metavar: str | None, kind: Callable[[str], Any], said: str, **more: Any) -> Flag:
    """An option with a value that `kind` reads."""
    return {"metavar": metavar, "type": kind, "help": said, **more}


def choice(values: Any, said: str, **more: Any) -> Flag:
    """An option with one of some values: a sequence of them, or a `Literal`."""
    return {"choices": get_args(values) or values, "help": said, **more}


class _ShortHelp(argparse.Action):
    """Shows the options named in `const`, and says how to see the others."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        more = [one for one in parser._actions if one.option_strings and one.dest not in self.const]
        for action in more:
            action.help = argparse.SUPPRESS
        parser.epilog = f"--help-all shows {len(more)} more options."
        parser.print_help()
        parser.exit()


def add_short_help(parser: argparse.ArgumentParser, shown: Sequence[str]) -> None:
    """Let `--help` show only some options, by their names, and `--help-all` every one."""
    group = parser.add_argument_group("help", conflict_handler="resolve")
    said, none = "show the most used options", argparse.SUPPRESS
    how: dict[str, Any] = {"nargs": 0, "const": (*shown, "help"), "default": none, "help": said}
    group.add_argument("-h", "--help", action=_ShortHelp, **how)
    group.add_argument("--help-all", action="help", help="show all options")


def add_flags(parser: Any, **flags: Flag) -> None:
    """Add options to a parser or to a group of one."""
    for name, arguments in flags.items():
        parser.add_argument(f"--{name.replace('_', '-')}", **arguments)


def add_scene(parser: argparse.ArgumentParser, *, pictures: bool = False) -> None:
    """Add the scene folder that a command reads, or where it reads `pictures` alone those."""
    if not pictures:
        parser.add_argument("scene", metavar="SCENE", type=Path, help="scene folder")
        return
    said = "scene folder, or the pictures of a scene"
    parser.add_argument("scene", metavar="SCENE", nargs="+", type=Path, help=said)


def scene_named(paths: Sequence[Path]) -> Path | tuple[Path, ...]:
    """What `Scene.load` takes of a folder, or of files that were named one by one."""
    return tuple(paths) if len(paths) > 1 or paths[0].is_file() else paths[0]


def tell(options: argparse.Namespace, lines: Iterable[str]) -> None:
    """Print what was done, if `--quiet` was not given; an output that is there is no failure."""
    if not options.quiet:
        with unread_is_no_failure():
            print(*map(visible, lines), sep="\n")


def refuse_idle(options: argparse.Namespace, checks: Iterable[tuple[str, bool, str]]) -> None:
    """Refuse options that would do nothing.

    Each check has the name of an option, whether it has an effect, and what it goes with. Raises
    InputError for the first that was given and has none.
    """
    from pbrfit._core import InputError  # here: the help needs no core

    for name, has_effect, said in checks:
        given = getattr(options, name)
        if given is not None and given is not False and not has_effect:
            raise InputError(f"--{name.replace('_', '-')}: goes with {said}")


def add_result(parser: argparse.ArgumentParser, metavar: str, what: str) -> None:
    """Add a result folder, and `--out` and `--overwrite` for what is made of it."""
    parser.add_argument("result", metavar="RESULT", type=Path, help="result folder")
    add_out(parser, what, metavar, required=True)


def read_result(options: argparse.Namespace) -> Result:
    """Read the result; InputError if what is made of it would be read as a part of its scene."""
    # Here: help needs neither.
    from pbrfit.result.result import Result
    from pbrfit.scene.folder import check_unread

    result = Result.load(options.result)
    check_unread([] if result.source is None else [result.source.path], [options.out])
    return result


def add_out(parser: Any, what: str, metavar: str = "DIR", *, required: bool = True) -> None:
    """Add `--out` and `--overwrite`."""
    replaced = "replace an earlier output that holds nothing else"
    add_flags(parser, out=value(metavar, Path, what, required=required), overwrite=switch(replaced))


def add_quiet(parser: Any, what: str = "no progress bar, no table, no warnings") -> None:
    """Add `--quiet`."""
    add_flags(parser, quiet=switch(what))


def add_jobs(parser: Any, what: str) -> None:
    """Add `--jobs`."""
    add_flags(parser, jobs=value("J", positive, what))


def add_cluster(parser: Any) -> None:
    """Add `--cluster`."""
    said = (
        "hand scenes to the workers of a dask scheduler, which share storage with this machine; "
        "--jobs limits how many at the same time; needs pip install 'pbrfit[cluster]'"
    )
    add_flags(parser, cluster=value("ADDRESS", str, said))


def add_threads(parser: Any) -> None:
    """Add `--threads`."""
    add_flags(parser, threads={**THREADS, "default": 0})


def whole_number(text: str, least: int = 0) -> int:
    """Read a number for `argparse` that fits everywhere."""
    with suppress(ValueError):
        if least <= (value := int(text)) < 2**31:
            return value
    raise argparse.ArgumentTypeError(f"expected {least} or more, found {text}")


def positive(text: str) -> int:
    """Read a whole number above 0 for `argparse`."""
    return whole_number(text, 1)


def number(text: str) -> float:
    """Read a finite number for `argparse`."""
    with suppress(ValueError):
        if math.isfinite(value := float(text)):
            return value
    raise argparse.ArgumentTypeError(f"expected a finite number, found {text!r}")


def numbers(form: str, kind: Callable[[str], Any] = number) -> Callable[[str], tuple[Any, ...]]:
    """Reader for `argparse` of as many numbers of a kind with commas between them as `form` has."""

    def read(text: str) -> tuple[Any, ...]:
        with suppress(ValueError, argparse.ArgumentTypeError):
            values = tuple(map(kind, text.split(",")))
            if len(values) == len(form.split(",")):
                return values
        what = "finite" if kind is number else "whole"
        raise argparse.ArgumentTypeError(f"expected {form}, {what} numbers, found {text!r}")

    return read


THREADS = value("T", whole_number, "0 = one for each processor; results do not depend on it")
"""`--threads`."""
