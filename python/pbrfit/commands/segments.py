"""`pbrfit segments`."""

from __future__ import annotations

import argparse

import numpy as np

from pbrfit.acquire import segments
from pbrfit.commands import arguments as cli
from pbrfit.commands import network_options as network
from pbrfit.io import images
from pbrfit.scene import completion
from pbrfit.scene.folder import SEGMENT_FILE

SAM2: network.Flags = {
    **network.SHOWN,
    "points": cli.value(
        "N", cli.positive, "ask what lies at N × N points of the picture (default: 32)"
    ),
    "smallest": cli.value(
        "SHARE",
        cli.number,
        "drop segments of which less than this share of the picture shows (default: 0.0005)",
    ),
    **network.checkpoint(segments.MODEL),
    **network.DEVICE,
}
FLAGS = {"sam2": SAM2, "file": {}}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add its options."""
    parser.description = (
        "Give segments to a folder of pictures: segments.png. Of masks that overlap the smaller "
        "lies on top. sam2 needs the extra packages pbrfit[segment]."
    )
    cli.add_scene(parser)
    said = "sam2: a network's; FILE: a picture of ids, which may be larger"
    network.add_source(parser, network.source(("sam2",), said))
    cli.add_flags(parser, overwrite=cli.switch("replace existing segments"))
    cli.add_quiet(parser, "no summary")
    cli.add_flags(parser.add_argument_group("--from sam2"), **SAM2)


def run(options: argparse.Namespace) -> int:
    """Write `segments.png`."""
    completion.check_none(options.scene, [SEGMENT_FILE], "segments", overwrite=options.overwrite)
    kind = "sam2" if options.source == "sam2" else "file"
    given = network.asked_for(options, FLAGS, kind)
    if kind == "sam2":
        picture, _ = network.shown(options.scene, given)
    else:
        picture = np.zeros((*completion.picture_size(options.scene), 3), np.uint8)
    ids, record = segments.segment(options.source, picture, **given)
    path = completion.add_map(
        *(options.scene, "segments", [SEGMENT_FILE], ids),
        lambda path: images.write_png(path, ids, tag=None),
        overwrite=options.overwrite,
    )
    count = record["segments"]
    segmented = f"{count} segment{'s' if count != 1 else ''}"
    cli.tell(options, [f"{path}: {segmented}, {100 * np.mean(ids > 0):.0f} % of the picture"])
    return cli.DONE
