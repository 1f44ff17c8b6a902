"""The commands of `pbrfit`, a file each; what they work with is imported late."""

from __future__ import annotations

from pbrfit.commands import (
    check_gradients,
    decompose,
    demo,
    evaluate,
    export,
    generate,
    inspect,
    normals,
    relight,
    report,
    segments,
    synth,
)
from pbrfit.commands.arguments import Subcommands

COMMANDS = (
    decompose,
    relight,
    report,
    export,
    generate,
    inspect,
    normals,
    segments,
    synth,
    check_gradients,
    evaluate,
    demo,
)


def add_commands(commands: Subcommands) -> None:
    """Add them all."""
    for command in COMMANDS:
        command.add(commands)
