"""`pbrfit completion`: a script by which a shell completes commands, options and their values.

It is made from the parsers themselves, so it knows what this version knows and nothing else.
"""

from __future__ import annotations

import argparse
import re
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, NoReturn

from pbrfit import commands
from pbrfit.commands.arguments import DONE

USE = """
how to use it:
  bash   eval "$(pbrfit completion bash)"                      in ~/.bashrc
  zsh    eval "$(pbrfit completion zsh)"                       in ~/.zshrc, after compinit
  fish   pbrfit completion fish > ~/.config/fish/completions/pbrfit.fish
"""

BRIEF = 60
"""Letters of a help that are shown beside an option: lists have a line each."""


@dataclass(frozen=True)
class Taken:
    """An option, or what stands without one."""

    names: tuple[str, ...]
    """Such as --out; none of a positional argument."""
    said: str
    """The beginning of its help."""
    choices: tuple[str, ...]
    """The words that it takes; none = others, or no value."""
    valued: bool
    """Whether a value follows."""
    files: bool
    """Whether the value may be a file or folder."""


@dataclass(frozen=True)
class Command:
    """A command or, with a space, a suite: "evaluate table1"."""

    name: str
    said: str
    taken: tuple[Taken, ...]

    @property
    def options(self) -> list[str]:
        """All that begins with a dash."""
        return [name for one in self.taken for name in one.names]

    @property
    def positional(self) -> Taken | None:
        """What stands without an option."""
        return next((one for one in self.taken if not one.names), None)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add its options."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = USE
    parser.add_argument("shell", metavar="bash|zsh|fish", choices=tuple(SCRIPTS), help="your shell")


def run(options: argparse.Namespace) -> int:
    """Print the script."""
    print(SCRIPTS[options.shell](known_commands()))
    return DONE


def known_commands() -> list[Command]:
    """All commands, and below `evaluate` its suites where they are installed."""
    found = []
    for name, said in commands.SUMMARIES.items():
        parser = _Bare(prog=f"pbrfit {name}")
        with suppress(_EndedError):  # `evaluate` without its distribution
            commands.add_options_of(name, parser)
        found.append(_command(name, said, parser))
        found += _below(name, parser)
    return found


class _EndedError(Exception):
    """A parser had enough."""


class _Bare(argparse.ArgumentParser):
    """A parser that is looked at and never parses."""

    def __init__(self, *, complete: Callable[[Any], None] | None = None, **arguments: Any) -> None:
        super().__init__(**arguments)
        self.complete = complete

    def exit(self, status: int = 0, message: str | None = None) -> NoReturn:
        raise _EndedError(status, message)


def _below(name: str, parser: argparse.ArgumentParser) -> Iterator[Command]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            said = {one.dest: one.help or "" for one in action._choices_actions}
            for suite, below in action.choices.items():
                if below.complete is not None:
                    below.complete(below)
                yield _command(f"{name} {suite}", said.get(suite, ""), below)


def _command(name: str, said: str, parser: argparse.ArgumentParser) -> Command:
    shown = (one for one in parser._actions if one.help != argparse.SUPPRESS)
    return Command(name, said, tuple(map(_taken, shown)))


def _taken(action: argparse.Action) -> Taken:
    choices, valued = tuple(map(str, action.choices or ())), action.nargs != 0
    metavar = action.metavar if isinstance(action.metavar, str) else ""
    if not choices and "|" in metavar:  # such as marigold|flat|FILE: the small ones are words
        choices = tuple(word for word in metavar.split("|") if word == word.lower())
    # Of metavars in large letters some are names of files, alone or behind a word.
    named = re.search(r"\b(FILE|FOLDER|DIR)\b", metavar) is not None
    files = valued and (action.type is Path or named)
    return Taken(tuple(action.option_strings), _brief(action.help or ""), choices, valued, files)


def _brief(said: str) -> str:
    """The beginning of a help, as much as stands beside a name in a list."""
    words = re.split(r"[;(]|\. ", " ".join(said.split()))[0].strip()
    return words if len(words) <= BRIEF else f"{words[:BRIEF].rpartition(' ')[0]} …"


# Bash


def _bash(known: Sequence[Command]) -> str:
    by_name = {one.name: one for one in known}
    tops = [one.name for one in known if " " not in one.name]
    values, options, positionals = [], [], []
    for one in known:
        for taken in one.taken:
            if taken.valued:
                values += [
                    f"        {shlex.quote(f'{one.name} {name}')}) {_bash_action(taken)};;"
                    for name in taken.names
                ]
        options.append(f"            {shlex.quote(one.name)}) words={_words(one.options)};;")
        taken = one.positional or Taken((), "", (), valued=False, files=False)
        positionals.append(f"        {shlex.quote(one.name)}) {_bash_action(taken)};;")
    nested = sorted({name.split()[0] for name in by_name if " " in name})
    lines = [
        f"# bash completion for pbrfit {version('pbrfit')}",
        "_pbrfit() {",
        "    local current=${COMP_WORDS[COMP_CWORD]} previous=${COMP_WORDS[COMP_CWORD-1]}",
        "    local command= words=",
        "    [[ $current == = ]] && current= || { [[ $previous == = ]] && previous="
        "${COMP_WORDS[COMP_CWORD-2]}; }",
        "    COMPREPLY=()",
        "    if ((COMP_CWORD == 1)); then",
        f'        COMPREPLY=($(compgen -W {_words([*tops, "--help", "--version"])} -- "$current"))',
        "        return",
        "    fi",
        "    command=${COMP_WORDS[1]}",
    ]
    if nested:
        lines += [
            f"    case $command in {'|'.join(nested)})",
            '        ((COMP_CWORD > 2)) && command+=" ${COMP_WORDS[2]}";;',
            "    esac",
        ]
    lines += [
        '    case "$command $previous" in',
        *values,
        "    esac",
        "    if [[ $current == -* ]]; then",
        '        case "$command" in',
        *options,
        "        esac",
        '        COMPREPLY=($(compgen -W "$words" -- "$current"))',
        "        return",
        "    fi",
        '    case "$command" in',
        *positionals,
        "    esac",
        "}",
        "# Files are completed by readline, where the function finds no word.",
        "complete -o default -F _pbrfit pbrfit",
    ]
    return "\n".join(lines)


def _bash_action(taken: Taken) -> str:
    """Complete a value and return."""
    words = ""
    if taken.choices:
        words = f'COMPREPLY=($(compgen -W {_words(taken.choices)} -- "$current")); '
    if not taken.files:  # bash 3 has no compopt, and then offers files
        words += "compopt +o default 2>/dev/null; "
    return f"{words}return"


def _words(words: Sequence[str]) -> str:
    return shlex.quote(" ".join(words))


# Zsh


def _zsh(known: Sequence[Command]) -> str:
    tops = [one for one in known if " " not in one.name]
    lines = [
        "#compdef pbrfit",
        f"# zsh completion for pbrfit {version('pbrfit')}",
        "_pbrfit() {",
        "    local -a commands",
        "    if (( CURRENT == 2 )); then",
        "        commands=(",
        *(f"            {shlex.quote(_zsh_pair(one.name, one.said))}" for one in tops),
        "        )",
        "        _describe command commands",
        "        _arguments '--help[show this help]' '--version[show the version]'",
        "        return",
        "    fi",
        "    shift words; (( CURRENT-- ))",
        "    case $words[1] in",
    ]
    for one in tops:
        below = [other for other in known if other.name.startswith(f"{one.name} ")]
        lines.append(f"        {one.name})")
        if below:
            lines += [
                "            if (( CURRENT == 2 )); then",
                "                commands=(",
                *(
                    "                    "
                    + shlex.quote(_zsh_pair(other.name.split()[1], other.said))
                    for other in below
                ),
                "                )",
                "                _describe suite commands",
                "                return",
                "            fi",
                "            shift words; (( CURRENT-- ))",
                "            case $words[1] in",
            ]
            for other in below:
                lines.append(f"                {other.name.split()[1]}) {_zsh_arguments(other)};;")
            lines.append("            esac;;")
        else:
            lines.append(f"            {_zsh_arguments(one)};;")
    lines += [
        "    esac",
        "}",
        'if [[ $funcstack[1] == _pbrfit ]]; then _pbrfit "$@"; else compdef _pbrfit pbrfit; fi',
    ]
    return "\n".join(lines)


def _zsh_pair(name: str, said: str) -> str:
    return f"{name}:{said}"


def _zsh_arguments(command: Command) -> str:
    parts = []
    for taken in command.taken:
        said = re.sub(r"([\[\]:\\])", r"\\\1", taken.said)
        value = f":{_zsh_values(taken)}" if taken.valued else ""
        if taken.names:
            parts += [
                shlex.quote(f"*{name}[{said}]{value and ':value' + value}") for name in taken.names
            ]
        else:
            parts.append(shlex.quote(f"*:{said}{value}"))
    return f"_arguments {' '.join(parts)}"


def _zsh_values(taken: Taken) -> str:
    words = " ".join(taken.choices)
    if taken.choices and taken.files:
        return f"{{compadd -- {words}; _files}}"
    return f"({words})" if taken.choices else "_files" if taken.files else " "


# Fish


def _fish(known: Sequence[Command]) -> str:
    nested = {one.name.split()[0] for one in known if " " in one.name}
    lines = [
        f"# fish completion for pbrfit {version('pbrfit')}",
        "complete -c pbrfit -f",
        "complete -c pbrfit -n __fish_use_subcommand -l help -d 'show this help'",
        "complete -c pbrfit -n __fish_use_subcommand -l version -d 'show the version'",
    ]
    for one in known:
        top, _, suite = one.name.partition(" ")
        there = f"__fish_seen_subcommand_from {top}"
        if suite:
            lines.append(_fish_line(f"{there}; and not {_seen(known, top)}", suite, one.said))
            there += f"; and __fish_seen_subcommand_from {suite}"
        else:
            lines.append(_fish_line("__fish_use_subcommand", top, one.said))
            if top in nested:
                continue
        for taken in one.taken:
            flags = " ".join(
                f"-l {name[2:]}" if name.startswith("--") else f"-s {name[1:]}"
                for name in taken.names
            )
            parts = ["complete -c pbrfit -n", shlex.quote(there), flags]
            if taken.valued:
                parts.append(("-r " if taken.names else "") + ("-F" if taken.files else "-f"))
                if taken.choices:
                    parts.append(f"-a {shlex.quote(' '.join(taken.choices))}")
            if taken.names:
                parts.append(f"-d {shlex.quote(taken.said)}")
            lines.append(" ".join(filter(None, parts)))
    return "\n".join(lines)


def _seen(known: Sequence[Command], top: str) -> str:
    suites = [one.name.split()[1] for one in known if one.name.startswith(f"{top} ")]
    return f"__fish_seen_subcommand_from {' '.join(suites)}"


def _fish_line(condition: str, word: str, said: str) -> str:
    return (
        f"complete -c pbrfit -n {shlex.quote(condition)} -a {shlex.quote(word)} "
        f"-d {shlex.quote(said)}"
    )


SCRIPTS: Mapping[str, Callable[[Sequence[Command]], str]] = {
    "bash": _bash,
    "zsh": _zsh,
    "fish": _fish,
}
