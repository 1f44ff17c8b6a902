"""`pbrfit inspect`."""

from __future__ import annotations

import argparse
from pathlib import Path

from pbrfit.commands.arguments import DONE, Subcommands, add_command
from pbrfit.commands.scene_options import add_input, load


def add(commands: Subcommands) -> None:
    """Add the command to `pbrfit`."""
    added = add_command(
        commands, "inspect", _run, "show what a scene folder holds and what is assumed"
    )
    added.add_argument("scene", metavar="SCENE", type=Path, help="scene folder")
    added.add_argument(
        "--preview",
        metavar="FILE",
        type=Path,
        help="write a PNG with a picture, the normals, which of them face the camera, and how far "
        "off they may be, where the scene says it",
    )
    add_input(added)


def _run(options: argparse.Namespace) -> int:
    from pbrfit.io import images
    from pbrfit.report import inspection
    from pbrfit.result import preview

    scene = load(options.scene, options)
    for topic, fact in inspection.facts(scene):
        print(f"{topic:<18}{fact}")
    if options.preview is not None:
        images.write_png(options.preview, preview.normals_preview(scene), tag="srgb")
        print(f"{'preview':<18}{options.preview}")
    return DONE
