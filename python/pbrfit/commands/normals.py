"""`pbrfit normals`."""

from __future__ import annotations

import argparse
from pathlib import Path

from pbrfit.arguments import DONE, Subcommands, add_command


def add(commands: Subcommands) -> None:
    """Add the command to `pbrfit`."""
    added = add_command(commands, "normals", _run, "give normals to a folder of pictures")
    added.add_argument("scene", metavar="SCENE", type=Path, help="scene folder")
    added.add_argument(
        "--from",
        dest="source",
        choices=("flat",),
        default="flat",
        help="flat: every surface faces the camera",
    )
    added.add_argument("--overwrite", action="store_true", help="replace existing normals")


def _run(options: argparse.Namespace) -> int:
    from pbrfit import scene_completion

    path = scene_completion.add_flat_normals(options.scene, overwrite=options.overwrite)
    print(f"{path}: every surface faces the camera")
    return DONE
