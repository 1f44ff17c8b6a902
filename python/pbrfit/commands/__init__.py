"""The commands of `pbrfit`, a module each with `add_options(parser)` and `run(options)`.

`run` returns the exit code. A module is imported when its command is first asked to parse.
"""

from __future__ import annotations

import argparse
from functools import partial
from importlib import import_module

from pbrfit.commands.arguments import Subcommands

SUMMARIES = {
    "decompose": "fit materials and lights to scene folders",
    "relight": "show a result under other light",
    "report": "write a page about a result, to be looked at in a browser",
    "export": "write a result for Blender, Unreal, Unity and others",
    "generate": "make a scene folder of one photograph",
    "inspect": "show what a scene folder holds and what is assumed",
    "normals": "give normals to a folder of pictures",
    "depth": "give depth to a folder of pictures",
    "lights": "give known lamps to a folder of pictures",
    "segments": "give segments to a folder of pictures",
    "maps": "give estimates of materials to a folder of pictures",
    "synth": "render a synthetic scene folder with ground truth",
    "check-gradients": "compare the gradient with finite differences",
    "evaluate": "measure this package and write a report",
    "demo": "make a synthetic scene, decompose it, relight it, report",
    "completion": "print a script by which your shell completes all of these",
}


def add_commands(commands: Subcommands) -> None:
    """Add them all, each without its options."""
    for name, summary in SUMMARIES.items():
        description = f"{summary[0].upper()}{summary[1:]}."
        complete = partial(add_options_of, name)
        commands.add_parser(name, help=summary, description=description, complete=complete)


def add_options_of(name: str, parser: argparse.ArgumentParser) -> None:
    """Import a command and add its options."""
    command = import_module(f"{__name__}.{name.replace('-', '_')}")
    command.add_options(parser)
    if hasattr(command, "run"):  # suites of `evaluate` have functions of their own
        parser.set_defaults(command=command.run)
