"""`pbrfit synth`, and the options of synthetic scenes."""

from __future__ import annotations

import argparse
from pathlib import Path

from pbrfit import synthetic
from pbrfit.commands.arguments import DONE, add_flags, choice, switch, value, whole_number
from pbrfit.commands.fit_options import MODEL_OF_PICTURES, add_option
from pbrfit.io.output import check_free
from pbrfit.model.reflection import DEFAULT_MODEL
from pbrfit.scene.folder import SCENE_FOLDER
from pbrfit.scene.scene import Scene
from pbrfit.synthetic.scenes import ADDED_KINDS, KINDS


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add its options."""
    parser.add_argument("out", metavar="DIR", type=Path, help="scene folder to write")
    add_synthetic(parser)
    add_option(parser, "model", MODEL_OF_PICTURES, DEFAULT_MODEL)
    add_option(parser, "sh_order", "of the lights")
    add_flags(parser, overwrite=switch("replace an existing folder"))


def add_synthetic(parser: argparse.ArgumentParser) -> None:
    """Add what says which scene is made; `make_scene` reads it, `--model` and `--sh-order`."""
    add_flags(
        parser,
        scene=choice(
            (*KINDS, *ADDED_KINDS),
            "kind of scene: plain pieces; a grid of spheres; patterned pieces; a room with "
            "furniture; that room with fine textures and relief",
            dest="kind",
            default="room",
        ),
        textures=value(
            "DIR",
            Path,
            "with --scene detailed: maps NAME_albedo, NAME_roughness, NAME_metallic, NAME_normal "
            "(default: procedural detail)",
        ),
        size=value("PIXELS", int, "side of a picture", default=128),
        lights=value("N", int, "number of pictures", default=16),
        noise=value("S", float, "Gaussian; mean radiance is 0.4", default=0.0),
        seed=value(None, whole_number, "of scene, lights and noise", default=0),
    )


def make_scene(options: argparse.Namespace) -> Scene:
    """Make the scene."""
    names = ("size", "lights", "sh_order", "noise", "seed", "model", "textures")
    return synthetic.make_scene(options.kind, **{name: getattr(options, name) for name in names})


def run(options: argparse.Namespace) -> int:
    """Write the scene folder."""
    check_free(options.out, overwrite=options.overwrite, form=SCENE_FOLDER)
    make_scene(options).save(options.out, overwrite=options.overwrite)
    print(f"{options.out}: {options.kind}, {options.lights} pictures and ground truth")
    return DONE
