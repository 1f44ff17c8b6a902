"""`pbrfit inspect`."""

from __future__ import annotations

import argparse
from pathlib import Path

from pbrfit.commands.arguments import DONE, add_flags, add_scene, value
from pbrfit.commands.scene_options import add_input, reading
from pbrfit.io import images
from pbrfit.io.output import new_file
from pbrfit.io.quoting import visible
from pbrfit.report import inspection
from pbrfit.result import preview


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add its options."""
    add_scene(parser)
    said = (
        "write a PNG with a picture, the normals, which of them face the camera, and how far off "
        "they may be, where the scene says it"
    )
    add_flags(parser, preview=value("FILE", Path, said))
    add_input(parser)


def run(options: argparse.Namespace) -> int:
    """Print what a scene folder holds."""
    scene = reading(options).load(options.scene)
    for topic, fact in inspection.facts(scene):
        print(visible(f"{topic:<17} {fact}"))
    if options.preview is not None:
        with new_file(options.preview, overwrite=True) as path:
            images.write_png(path, preview.normals_preview(scene), tag="srgb")
        print(f"{'preview':<17} {options.preview}")
    return DONE
