"""`pbrfit maps`."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from pbrfit._core import InputError
from pbrfit.acquire import maps
from pbrfit.acquire.photo import shown_to_network
from pbrfit.commands import arguments as cli
from pbrfit.commands import network_options as network
from pbrfit.io.quoting import listed
from pbrfit.scene import completion
from pbrfit.scene.estimates import ESTIMATES_FILE, known_maps

MARIGOLD: network.Flags = {
    **network.SHOWN,
    "ensemble": cli.value(
        "E",
        cli.positive,
        f"predictions of marigold-iid that are combined (default: {maps.ENSEMBLE})",
    ),
    "steps": network.SAMPLER["steps"],
    "seed": network.SAMPLER["seed"],
    **network.checkpoint("the authors' own"),
    **network.DEVICE,
}
FLAGS = {
    "marigold-iid": MARIGOLD,
    "rgbx": {name: flag for name, flag in MARIGOLD.items() if name != "ensemble"},
    "file": {},
}
"""Options of each kind of source."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add its options."""
    parser.description = (
        "Give estimates of albedo, roughness and metallic to a folder of pictures: estimates.exr, "
        "which a fit takes as evidence beside the pictures. Networks need the extra packages "
        "pbrfit[diffusion]."
    )
    cli.add_scene(parser)
    said = (
        "marigold-iid, rgbx: a network's; FILE: maps of any tool, by their names, such as "
        "basecolor.png, roughness.png and metallic.png, or materials.exr (default: marigold-iid)"
    )
    parser.add_argument(
        "--from", dest="source", nargs="+", default=["marigold-iid"], metavar="SOURCE", help=said
    )
    cli.add_flags(parser, overwrite=cli.switch("replace existing estimates"))
    cli.add_quiet(parser, "no summary")
    cli.add_flags(parser.add_argument_group("--from marigold-iid or rgbx"), **MARIGOLD)


def run(options: argparse.Namespace) -> int:
    """Write `estimates.exr`."""
    source = options.source
    kind = source[0] if len(source) == 1 and source[0] in maps.NETWORKS else "file"
    paths = [] if kind in maps.NETWORKS else [Path(name) for name in source]
    for path in paths:
        if not path.is_file():
            expected = f"expected {listed(maps.NETWORKS)} or files"
            raise InputError(f"--from: {expected}, found {str(path)!r}")
    options.source = " ".join(source)
    completion.check_none(options.scene, [ESTIMATES_FILE], "estimates", overwrite=options.overwrite)
    given = network.asked_for(options, FLAGS, kind)
    if paths:
        found = maps.of_files(paths, completion.picture_size(options.scene))
    else:
        space = given.pop("color_space", None)
        shown, _ = shown_to_network(options.scene, given.pop("picture", None), space)
        found = maps.by_network(kind, shown, **given)
    path = completion.add_estimates(options.scene, found, overwrite=options.overwrite)
    means = [f"{name} {np.nanmean(of):.2f}" for name, of in known_maps(found).items()]
    cli.tell(options, [f"{path}: {', '.join(means)} in the mean"])
    return cli.DONE
