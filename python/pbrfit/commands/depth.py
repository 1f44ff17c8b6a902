"""`pbrfit depth`."""

from __future__ import annotations

import argparse
import shlex

import numpy as np

from pbrfit.acquire.depth import MODEL, estimate
from pbrfit.acquire.marigold import DEPTH_MODEL, ENSEMBLE
from pbrfit.commands import arguments as cli
from pbrfit.commands import network_options as network
from pbrfit.commands.scene_options import DEPTH_KIND, field_of_view
from pbrfit.io import images
from pbrfit.io.depth_files import DEPTH_FILES, METRES
from pbrfit.scene import completion
from pbrfit.scene.depth import in_words
from pbrfit.scene.options import ReadOptions
from pbrfit.scene.reading import read_surface
from pbrfit.values.arrays import Codes


def _unit(text: str) -> float:
    return METRES.get(text) or cli.number(text)


MARIGOLD: network.Flags = {
    **network.SHOWN,
    **network.ensemble("averaged"),
    **network.SAMPLER,
    **network.checkpoint(f"{DEPTH_MODEL}, or {MODEL}"),
    **network.DEVICE,
    **network.PRECISION,
}

FLAGS: dict[str, network.Flags] = {
    "marigold": MARIGOLD,
    "depth-anything": {name: MARIGOLD[name] for name in (*network.SHOWN, "model", *network.DEVICE)},
    "normals": {},
    "file": {
        "depth_kind": DEPTH_KIND,
        "unit": cli.value("U", _unit, "m, cm or mm, or the metres that 1 is (default: as stored)"),
    },
}
"""Options of each kind of source."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add its options."""
    parser.description = (
        "Give depth to a folder of pictures: depth.exr, distances along the camera's axis. Depth "
        "that a network gives up to an offset is fixed by the scene's normals. marigold needs the "
        "extra packages pbrfit[diffusion], depth-anything pbrfit[segment]."
    )
    cli.add_scene(parser)
    said = (
        "marigold, depth-anything: a network's estimate; normals: their integral; FILE: a map that "
        "is there already (EXR, .npy, PNG or TIFF), in any unit"
    )
    network.add_source(parser, network.source(("marigold", "depth-anything", "normals"), said))
    cli.add_flags(
        parser,
        fov=field_of_view(cli.number, "scene.toml, EXIF, else 60"),
        fuse=cli.switch("make the depth agree with the scene's normals, which removes its noise"),
        overwrite=cli.switch("replace existing depth"),
    )
    cli.add_quiet(parser, "no progress bar, no summary")
    cli.add_flags(
        parser.add_argument_group("--from marigold; depth-anything has some of them"), **MARIGOLD
    )
    cli.add_flags(parser.add_argument_group("--from FILE"), **FLAGS["file"])


def run(options: argparse.Namespace) -> int:
    """Write depth, and say what it is like."""
    completion.check_none(options.scene, DEPTH_FILES, "depth", overwrite=options.overwrite)
    surface = read_surface(options.scene, ReadOptions(fov=options.fov))
    kind = options.source if options.source in FLAGS else "file"
    given = network.asked_for(options, FLAGS, kind)
    shown: Codes = np.zeros((*surface.size, 3), np.uint8)  # only its size matters
    if kind in ("marigold", "depth-anything"):
        shown, _ = network.shown(options.scene, given)
    if kind == "marigold":
        total = given.get("ensemble", ENSEMBLE)
        with cli.progress_bar(total, quiet=options.quiet, unit="prediction") as bar:
            found = estimate(kind, shown, surface, fuse=options.fuse, progress=bar.update, **given)
    else:
        found = estimate(options.source, shown, surface, fuse=options.fuse, **given)
    path = completion.add_map(
        *(options.scene, "depth", DEPTH_FILES, found.depth),
        lambda path: images.write_exr(path, {"Z": found.depth}),
        overwrite=options.overwrite,
    )
    lines = [f"{path}: {in_words(found.depth)}", *(f"  {remark}" for remark in found.remarks)]
    cli.tell(options, [*lines, f"look at it: pbrfit inspect {shlex.quote(str(options.scene))}"])
    return cli.DONE
