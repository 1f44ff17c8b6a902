"""Options that say how a scene folder is read."""

from __future__ import annotations

import argparse
from typing import get_args

from pbrfit.batch.settings import Reading
from pbrfit.commands.arguments import code_range
from pbrfit.io.color import ColorSpace
from pbrfit.io.images import CODE_RANGE


def add_input(parser: argparse.ArgumentParser) -> None:
    """Add them; `reading` reads them."""
    parser.add_argument(
        "--fov",
        metavar="DEG",
        type=float,
        help="horizontal field of view, 0 = orthographic (default: scene.toml, EXIF, else 60)",
    )
    parser.add_argument(
        "--color-space",
        choices=get_args(ColorSpace),
        help="of all pictures (default: scene.toml, ICC profile, else sRGB for integer files and "
        "linear Rec.709 for float files)",
    )
    parser.add_argument(
        "--max-size",
        metavar="PIXELS",
        type=int,
        help="average larger pictures down to this longer side (default: as they are)",
    )
    parser.add_argument(
        "--code-range",
        metavar="LOW,HIGH",
        type=code_range,
        default=f"{CODE_RANGE[0]},{CODE_RANGE[1]}",
        help="leave out samples of integer pictures with a channel above HIGH, or with all below "
        "LOW, in 8-bit codes; 0,255 keeps all",
    )


def reading(options: argparse.Namespace) -> Reading:
    """How a scene folder is to be read."""
    return Reading(
        fov=options.fov,
        color_space=options.color_space,
        max_size=options.max_size,
        code_range=options.code_range,
    )
