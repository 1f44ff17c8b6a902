"""Options of the commands that show a picture to a network."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pbrfit._core import InputError
from pbrfit.acquire.marigold import ENSEMBLE
from pbrfit.acquire.photo import shown_to_network
from pbrfit.acquire.weights import Device, Offload, Precision
from pbrfit.commands.arguments import Flag, add_flags, choice, positive, value, whole_number
from pbrfit.commands.scene_options import COLOR_SPACE
from pbrfit.values.arrays import Codes

Flags = Mapping[str, Flag]
"""Options by their names."""

SHOWN: Flags = {
    "picture": value(
        "NAME",
        str,
        "show this picture, named without suffix (default: the mean of all, as if all lamps were "
        "on at once)",
    ),
    "color_space": COLOR_SPACE,
}
"""Which picture is shown, and how pictures are read."""

SAMPLER: Flags = {
    "steps": value("N", positive, "of the sampler (default: the model's)"),
    "resolution": value(
        "PIXELS",
        whole_number,
        "longer side at which the network sees the picture, 0 = as it is (default: the model's)",
    ),
    "seed": value(
        None, whole_number, "of the first prediction, the next has one more (default: 0)"
    ),
}
"""How a diffusion model is asked."""

DEVICE: Flags = {"device": choice(Device, "where it computes (default: a GPU, else cpu)")}

PRECISION: Flags = {
    "dtype": choice(Precision, "of its numbers (default: float16 on a GPU, else float32)"),
    "offload": choice(Offload, "what waits outside the GPU's memory (default: none)"),
}


def ensemble(how: str) -> Flags:
    """How many predictions are made, and what becomes of them."""
    said = f"predictions that are {how} (default: {ENSEMBLE})"
    return {"ensemble": value("E", positive, said)}


def checkpoint(default: str) -> Flags:
    """Which weights are used."""
    said = f"another checkpoint, on the Hugging Face Hub or in a folder (default: {default})"
    return {"model": value("ID|FOLDER", str, said)}


def source(names: Sequence[str], said: str, prefixes: Sequence[str] = ()) -> Flag:
    """An option with one of some names, by default the first, PREFIX and a file, or a file."""
    forms = [*names, *(f"{prefix}FILE" for prefix in prefixes)]

    def read(text: str) -> str:
        if text in names:
            return text
        prefix = next((prefix for prefix in prefixes if text.startswith(prefix)), "")
        if not Path(text.removeprefix(prefix)).is_file():
            expected = f"expected {', '.join(forms)} or a file"
            raise argparse.ArgumentTypeError(f"{expected}, found {text!r}")
        return text

    return value("|".join([*forms, "FILE"]), read, said, default=names[0])


def add_source(parser: argparse.ArgumentParser, flag: Flag) -> None:
    """Add `--from`, which `source` makes."""
    add_flags(parser, **{"from": {**flag, "dest": "source"}})


def asked_for(options: argparse.Namespace, flags: Mapping[str, Flags], kind: str) -> dict[str, Any]:
    """Options of `--from` that were given, those that are not None.

    `flags` are options by the kinds of source that they are for. Raises InputError if an option was
    given that sources of this kind do not have: it would be ignored.
    """
    for name in (name for others in flags.values() for name in others):
        if name not in flags[kind] and getattr(options, name) is not None:
            raise InputError(
                f"--{name.replace('_', '-')}: has no meaning with --from {options.source}"
            )
    values = {name: getattr(options, name) for name in flags[kind]}
    return {name: value for name, value in values.items() if value is not None}


def shown(scene: Path, given: dict[str, Any]) -> tuple[Codes, str]:
    """What a network is shown of a scene, and what that is; takes the options `SHOWN` away."""
    return shown_to_network(scene, given.pop("picture", None), given.pop("color_space", None))
