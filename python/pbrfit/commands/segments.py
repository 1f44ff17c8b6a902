"""`pbrfit segments`."""

from __future__ import annotations

import argparse
from pathlib import Path

from pbrfit.commands.arguments import (
    DONE,
    Subcommands,
    add_command,
    number,
    positive,
    unread_is_no_failure,
)
from pbrfit.commands.network_options import add_placement, add_shown, chosen, source

OPTIONS = {
    "sam2": ("model", "device", "points", "smallest", "picture", "color_space"),
    "file": (),
}
"""Which options each kind of source has."""


def add(commands: Subcommands) -> None:
    """Add the command to `pbrfit`."""
    added = add_command(
        commands,
        "segments",
        _run,
        "give segments to a folder of pictures",
        "Give segments to a folder of pictures: segments.png. Of masks that overlap the smaller "
        "lies on top. sam2 needs the extra packages pbrfit[segment].",
    )
    added.add_argument("scene", metavar="SCENE", type=Path, help="scene folder")
    added.add_argument(
        "--from",
        dest="source",
        metavar="sam2|FILE",
        type=source(("sam2",)),
        default="sam2",
        help="sam2: a network's; FILE: a picture of ids, which may be larger",
    )
    added.add_argument("--overwrite", action="store_true", help="replace existing segments")
    added.add_argument("--quiet", action="store_true", help="no summary")
    network = added.add_argument_group("--from sam2")
    add_shown(network)
    network.add_argument(
        "--points",
        metavar="N",
        type=positive,
        help="ask what lies at N × N points of the picture (default: 32)",
    )
    network.add_argument(
        "--smallest",
        metavar="SHARE",
        type=number,
        help="drop segments of which less than this share of the picture shows (default: 0.0005)",
    )
    add_placement(network, "facebook/sam2.1-hiera-large", precision=False)


def _run(options: argparse.Namespace) -> int:
    import numpy as np

    from pbrfit.acquire.scene_picture import shown
    from pbrfit.acquire.segments import segment
    from pbrfit.scene import completion as scene_completion
    from pbrfit.scene import folder as scene_folder

    scene_completion.check_no_segments(options.scene, overwrite=options.overwrite)
    kind = "sam2" if options.source == "sam2" else "file"
    given = chosen(options, OPTIONS, kind, f"--from {options.source}")
    if kind == "sam2":
        settings = scene_folder.read_settings(options.scene / "scene.toml")
        space = given.pop("color_space", None) or settings.color_space
        picture = shown(options.scene, given.pop("picture", None), space).srgb8
    else:
        picture = np.zeros((*scene_completion.picture_size(options.scene), 3), np.uint8)
    ids, record = segment(options.source, picture, **given)
    path = scene_completion.add_segments(options.scene, ids, overwrite=options.overwrite)
    if not options.quiet:
        count = record["segments"]
        with unread_is_no_failure():
            print(
                f"{path}: {count} segment{'s' if count != 1 else ''}, "
                f"{100 * np.mean(ids > 0):.0f} % of the picture"
            )
    return DONE
