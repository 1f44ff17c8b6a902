"""`pbrfit synth`, and the options of synthetic scenes."""

from __future__ import annotations

import argparse
from pathlib import Path

from pbrfit import synthetic
from pbrfit.commands.arguments import DONE, whole_number
from pbrfit.commands.fit_options import MODEL_OF_PICTURES, add_option
from pbrfit.io.output import check_free
from pbrfit.model.reflection import DEFAULT_MODEL
from pbrfit.scene.folder import CONTAINS
from pbrfit.scene.scene import Scene
from pbrfit.synthetic.scenes import ADDED_KINDS, KINDS


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add its options."""
    parser.add_argument("out", metavar="DIR", type=Path, help="scene folder to write")
    add_synthetic(parser)
    add_option(parser, "model", MODEL_OF_PICTURES, DEFAULT_MODEL)
    add_option(parser, "sh_order", "of the lights")
    parser.add_argument("--overwrite", action="store_true", help="replace an existing folder")


def add_synthetic(
    parser: argparse.ArgumentParser, what_seed: str = "of scene, lights and noise"
) -> None:
    """Add what says which scene is made; `make_scene` reads it, `--model` and `--sh-order`."""
    parser.add_argument(
        "--scene",
        dest="kind",
        choices=(*KINDS, *ADDED_KINDS),
        default="room",
        help="kind of scene: plain pieces; a grid of spheres; patterned pieces; a room with "
        "furniture; that room with fine textures and relief",
    )
    parser.add_argument(
        "--textures",
        metavar="DIR",
        type=Path,
        help="with --scene detailed: maps NAME_albedo, NAME_roughness, NAME_metallic, NAME_normal "
        "(default: procedural detail)",
    )
    parser.add_argument("--size", metavar="PIXELS", type=int, default=128, help="side of a picture")
    parser.add_argument("--lights", metavar="N", type=int, default=16, help="number of pictures")
    parser.add_argument(
        "--noise", metavar="S", type=float, default=0.0, help="Gaussian; mean radiance is 0.4"
    )
    parser.add_argument("--seed", type=whole_number, default=0, help=what_seed)


def make_scene(options: argparse.Namespace) -> Scene:
    """Make the scene."""
    names = ("size", "lights", "sh_order", "noise", "seed", "model", "textures")
    return synthetic.make_scene(options.kind, **{name: getattr(options, name) for name in names})


def run(options: argparse.Namespace) -> int:
    """Write the scene folder."""
    check_free(options.out, overwrite=options.overwrite, contains=CONTAINS)
    make_scene(options).save(options.out, overwrite=options.overwrite)
    print(f"{options.out}: {options.kind}, {options.lights} pictures and ground truth")
    return DONE
