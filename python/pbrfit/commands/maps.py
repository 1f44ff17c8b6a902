"""`pbrfit maps`."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from pbrfit._core import InputError
from pbrfit.acquire import maps
from pbrfit.acquire.marigold import MATERIALS_MODEL
from pbrfit.commands import arguments as cli
from pbrfit.commands import network_options as network
from pbrfit.model.estimates import ESTIMATES_FILE, known_maps, write
from pbrfit.scene import completion

MARIGOLD: network.Flags = {
    **network.SHOWN,
    **network.ensemble("combined"),
    "steps": network.SAMPLER["steps"],
    "seed": network.SAMPLER["seed"],
    **network.checkpoint(MATERIALS_MODEL),
    **network.DEVICE,
}
FLAGS = {"marigold-iid": MARIGOLD, "file": {}}
"""Options of each kind of source."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add its options."""
    parser.description = (
        "Give albedo, roughness and metallic that another tool estimated to a folder of pictures: "
        "estimates.exr, which a fit takes as evidence beside the pictures. marigold-iid needs the "
        "extra packages pbrfit[diffusion]."
    )
    cli.add_scene(parser)
    said = (
        "marigold-iid: a network's; FILE: maps of any tool by their names, such as basecolor.png "
        "roughness.png metallic.png, or a materials.exr (default: marigold-iid)"
    )
    source = cli.value("SOURCE", str, said, dest="source", nargs="+")
    cli.add_flags(parser, **{"from": source})
    cli.add_flags(parser, overwrite=cli.switch("replace existing estimates"))
    cli.add_quiet(parser, "no summary")
    cli.add_flags(parser.add_argument_group("--from marigold-iid"), **MARIGOLD)


def run(options: argparse.Namespace) -> int:
    """Write `estimates.exr`."""
    paths = options.source or ["marigold-iid"]
    options.source = " ".join(paths)
    kind = "marigold-iid" if options.source == "marigold-iid" else "file"
    for path in paths if kind == "file" else []:
        if not Path(path).is_file():
            raise InputError(f"--from: expected marigold-iid or files, found {path!r}")
    completion.check_none(options.scene, [ESTIMATES_FILE], "estimates", overwrite=options.overwrite)
    given = network.asked_for(options, FLAGS, kind)
    if kind == "file":
        found = maps.of_files([*map(Path, paths)], completion.picture_size(options.scene))
    else:
        shown, _ = network.shown(options.scene, given)
        found = maps.by_marigold(shown, **given)
    path = completion.add_map(
        *(options.scene, "estimates", [ESTIMATES_FILE], found.roughness),
        lambda path: write(path, found),
        overwrite=options.overwrite,
    )
    means = [f"{name} {np.nanmean(of):.2f}" for name, of in known_maps(found).items()]
    cli.tell(options, [f"{path}: {', '.join(means)} in the mean"])
    return cli.DONE
