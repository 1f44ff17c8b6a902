"""Options that say how a scene folder is read."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from pbrfit.acquire.chart import read_chart
from pbrfit.commands import arguments as cli
from pbrfit.io.color import ColorSpace
from pbrfit.io.images import Orientation
from pbrfit.model.depth_normals import DepthKind
from pbrfit.scene.options import Alpha, ReadOptions

COLOR_SPACE = cli.choice(
    ColorSpace,
    "of all pictures (default: scene.toml, ICC profile, else sRGB for integer files and linear "
    "Rec.709 for float files)",
)

DEPTH_KIND = cli.choice(
    DepthKind,
    "what a number says, up to any factor: the distance along the optical axis, that along the "
    "pixel's ray, or the inverse of the first (default: z)",
)


STORED: dict[str, cli.Flag] = {
    "orientation": cli.choice(
        Orientation, "turn pictures as EXIF says, or leave them (default: scene.toml, else exif)"
    ),
    "layer": cli.value("NAME", str, "of EXR pictures (default: scene.toml, else told by names)"),
}
"""How pictures lie in their files."""


def field_of_view(kind: Callable[[str], float], otherwise: str) -> cli.Flag:
    """`--fov`, and where it comes from without it."""
    return cli.value(
        "DEG", kind, f"horizontal field of view, 0 = orthographic (default: {otherwise})"
    )


def add_input(parser: Any) -> None:
    """Add them; `reading` reads them."""
    cli.add_flags(
        parser,
        fov=field_of_view(float, "scene.toml, EXIF, else fitted"),
        color_space=COLOR_SPACE,
        max_size=cli.value(
            "PIXELS", int, "average larger pictures down to this longer side (default: as they are)"
        ),
        code_range=cli.value(
            "LOW,HIGH",
            cli.numbers("LOW,HIGH", cli.whole_number),
            "values of integer pictures above HIGH or below LOW, in 8-bit codes, only bound the "
            "radiance (default: 1,250 for JPEG, else all but 0 and the maximum; 0,255: none)",
        ),
        **STORED,
        alpha=cli.choice(
            Alpha,
            "leave out pixels of less than half in any picture, or none (default: scene.toml, else "
            "mask)",
        ),
        chart=cli.value(
            "FILE",
            Path,
            "picture of a ColorChecker by the same camera: corrects colours and exposure of all",
        ),
        chart_corners=cli.value(
            "X,Y,...",
            cli.numbers("X,Y,X,Y,X,Y,X,Y"),
            "in pixels the outer corners of its dark skin, bluish green, black and white patch "
            "(default: found with pbrfit[chart])",
        ),
        crop=cli.value(
            "X,Y,W,H",
            cli.numbers("X,Y,W,H", cli.whole_number),
            "use this part of the upright pictures and maps, in pixels (default: scene.toml, else "
            "all)",
        ),
    )


def reading(options: argparse.Namespace) -> ReadOptions:
    """How a scene is to be read; says how well a chart's colours are explained."""
    response = getattr(options, "response", None)
    decoded: ColorSpace | None = response if response in ("srgb", "linear") else None
    given: dict[str, Any]
    given = {one.name: getattr(options, one.name, None) for one in fields(ReadOptions)}
    found = ReadOptions(**{**given, "color_space": options.color_space or decoded})
    cli.refuse_idle(options, [("chart_corners", options.chart is not None, "--chart")])
    if options.chart is None:
        return found
    picture = found.picture(options.chart)
    corners = None if options.chart_corners is None else np.reshape(options.chart_corners, (4, 2))
    matrix, said = read_chart(options.chart, picture, corners)
    if not getattr(options, "quiet", False):
        cli.complain(f"{options.chart}: {said}")
    return replace(found, color_matrix=tuple(map(tuple, matrix.tolist())))
