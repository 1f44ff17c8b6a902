"""`pbrfit inspect`."""

from __future__ import annotations

import argparse
from pathlib import Path

from pbrfit.commands import arguments as cli
from pbrfit.commands.scene_options import add_input, reading
from pbrfit.io import images
from pbrfit.io.output import check_free_file, new_file
from pbrfit.report import inspection
from pbrfit.result import preview
from pbrfit.scene.folder import check_unread, locate
from pbrfit.scene.reading import load
from pbrfit.scene.scene import Scene
from pbrfit.values.quoting import visible

LOOK_SIDE = 512
"""Longer side in pixels at which larger pictures are looked at."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add its options."""
    cli.add_scene(parser, pictures=True)
    said = "write a contact sheet, PNG: pictures with histograms, normals, which face the camera"
    replaced = cli.switch("replace an existing preview")
    cli.add_flags(parser, preview=cli.value("FILE", Path, said), overwrite=replaced)
    add_input(parser)


def run(options: argparse.Namespace) -> int:
    """Print what a scene folder holds."""
    cli.refuse_idle(options, [("overwrite", options.preview is not None, "--preview")])
    files = locate(cli.scene_named(options.scene))
    if options.preview is not None:
        check_free_file(options.preview, overwrite=options.overwrite)
        check_unread([files.folder], [options.preview])
    scene = load(files, Scene, reading(options), look=LOOK_SIDE)
    for topic, fact in inspection.facts(scene):
        print(visible(f"{topic:<17} {fact}"))
    if options.preview is not None:
        with new_file(options.preview, overwrite=options.overwrite) as path:
            images.write_png(path, preview.contact_sheet(scene), tag="srgb")
        print(f"{'preview':<17} {options.preview}")
    return cli.DONE
