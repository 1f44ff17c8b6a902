"""Options of the commands that show a picture to a network."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

from pbrfit._core import InputError
from pbrfit.acquire.weights import Device, Offload, Precision
from pbrfit.commands.arguments import Subcommands
from pbrfit.io.color import ColorSpace

Group = Subcommands
"""An `argparse` group, or a parser."""


def source(names: Sequence[str], prefixes: Sequence[str] = ()) -> Callable[[str], str]:
    """Reader for `argparse` of one of some names, PREFIX and a file, or a file that is there."""

    def read(text: str) -> str:
        if text in names:
            return text
        prefix = next((prefix for prefix in prefixes if text.startswith(prefix)), "")
        if not Path(text.removeprefix(prefix)).is_file():
            choices = ", ".join([*names, *(f"{prefix}FILE" for prefix in prefixes)])
            raise argparse.ArgumentTypeError(f"expected {choices} or a file, found {text!r}")
        return text

    return read


def add_shown(group: Group) -> None:
    """Add which picture is shown, and how pictures are read."""
    group.add_argument(
        "--picture",
        metavar="NAME",
        help="show this picture, named without suffix (default: the mean of all, as if all lamps "
        "were on at once)",
    )
    group.add_argument(
        "--color-space",
        choices=get_args(ColorSpace),
        help="of all pictures (default: scene.toml, ICC profile, else sRGB for integer files and "
        "linear Rec.709 for float files)",
    )


def add_placement(group: Group, model: str, *, precision: bool = True) -> None:
    """Add which weights are used, and where they compute."""
    group.add_argument(
        "--model",
        metavar="ID|FOLDER",
        help=f"another checkpoint, on the Hugging Face Hub or in a folder (default: {model})",
    )
    group.add_argument(
        "--device", choices=get_args(Device), help="where it computes (default: a GPU, else cpu)"
    )
    if precision:
        group.add_argument(
            "--dtype",
            choices=get_args(Precision),
            help="of its numbers (default: float16 on a GPU, else float32)",
        )
        group.add_argument(
            "--offload",
            choices=get_args(Offload),
            help="what waits outside the GPU's memory (default: none)",
        )


def chosen(
    options: argparse.Namespace, names: Mapping[str, Sequence[str]], kind: str, flag: str
) -> dict[str, Any]:
    """Options that were given, all of them for a source of this kind.

    Parameters
    ----------
    options
        As parsed; what was not given is None.
    names
        Of options, by the kinds of source that they are for.
    kind
        Of the source that was asked for.
    flag
        That asked for it, with its value, for the message.

    Raises
    ------
    InputError
        If an option of another kind was given: it would be ignored.
    """
    of_kind = {name: getattr(options, name) for name in names[kind]}
    for others in names.values():
        for name in others:
            if name not in of_kind and getattr(options, name) is not None:
                option = f"--{name.replace('_', '-')}"
                raise InputError(f"{option}: has no meaning with {flag}")
    return {name: value for name, value in of_kind.items() if value is not None}
