"""`pbrfit normals`."""

from __future__ import annotations

import argparse
import dataclasses
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pbrfit.commands.arguments import (
    DONE,
    Subcommands,
    add_command,
    number,
    positive,
    progress_bar,
    unread_is_no_failure,
    whole_number,
)
from pbrfit.commands.network_options import add_placement, add_shown, chosen, source

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from pbrfit.acquire.normals import Normals

AXES = ("opengl", "directx")
FRAMES = ("camera", "tangent", "world")
DEPTH_KINDS = ("z", "ray", "disparity")

NETWORK = ("model", "device", "dtype", "offload", "ensemble", "steps", "resolution", "seed")
OPTIONS = {
    "marigold": (*NETWORK, "picture", "color_space"),
    "flat": (),
    "depth": ("fov", "depth_kind", "view_width"),
    "file": ("convention", "frame"),
}
"""Which options each kind of source has."""


def add(commands: Subcommands) -> None:
    """Add the command to `pbrfit`."""
    added = add_command(
        commands,
        "normals",
        _run,
        "give normals to a folder of pictures",
        "Give normals to a folder of pictures: normals.exr, in the convention that the folder's "
        "scene.toml states, and where some are uncertain or missing weights.exr, which says how "
        "much pixels count in a fit. marigold needs the extra packages pbrfit[diffusion].",
    )
    added.add_argument("scene", metavar="SCENE", type=Path, help="scene folder")
    added.add_argument(
        "--from",
        dest="source",
        metavar="marigold|flat|depth:FILE|FILE",
        type=source(("marigold", "flat"), ("depth:",)),
        default="marigold",
        help="marigold: a network's estimate; flat: every surface faces the camera; depth:FILE: "
        "from a depth map; FILE: normals that are there already",
    )
    added.add_argument(
        "--overwrite", action="store_true", help="replace existing normals and weights"
    )
    added.add_argument("--quiet", action="store_true", help="no progress bar, no summary")

    network = added.add_argument_group("--from marigold")
    add_shown(network)
    network.add_argument(
        "--ensemble",
        metavar="E",
        type=positive,
        help="predictions that are averaged; from 3 on, what they differ by gives the weights "
        "(default: 5)",
    )
    network.add_argument(
        "--steps", metavar="N", type=positive, help="of the sampler (default: the model's)"
    )
    network.add_argument(
        "--resolution",
        metavar="PIXELS",
        type=whole_number,
        help="longer side at which the network sees the picture, 0 = as it is (default: the "
        "model's)",
    )
    network.add_argument(
        "--seed",
        type=whole_number,
        help="of the first prediction, the next has one more (default: 0)",
    )
    add_placement(network, "prs-eth/marigold-normals-v1-1")

    depth = added.add_argument_group("--from depth:FILE (EXR, PNG or TIFF of 16 bits, .npy)")
    depth.add_argument(
        "--depth-kind",
        choices=DEPTH_KINDS,
        help="what a number says, up to any factor: the distance along the optical axis, that "
        "along the pixel's ray, or the inverse of the first (default: z)",
    )
    depth.add_argument(
        "--fov",
        metavar="DEG",
        type=number,
        help="horizontal field of view, 0 = orthographic (default: scene.toml, EXIF, else 60)",
    )
    depth.add_argument(
        "--view-width",
        metavar="WIDTH",
        type=number,
        help="what an orthographic camera sees from left to right, in units of the depth",
    )

    file = added.add_argument_group("--from FILE (EXR, PNG, TIFF, .npy)")
    file.add_argument(
        "--convention",
        choices=AXES,
        help="opengl: Y up; directx: Y down (default: scene.toml, else opengl)",
    )
    file.add_argument(
        "--frame",
        choices=FRAMES,
        help="camera: X right, Z to the viewer; tangent: the texture of a flat card that faces "
        "the camera; world: turned by scene.toml's world_to_camera (default: scene.toml, else "
        "camera)",
    )


def _run(options: argparse.Namespace) -> int:
    from pbrfit.scene import completion as scene_completion

    scene_completion.check_normals_can_be_added(options.scene, overwrite=options.overwrite)
    kind = _kind(options.source)
    given = chosen(options, OPTIONS, kind, f"--from {options.source}")
    found, said = _estimated(options, kind, given)
    paths = scene_completion.add_normals(
        options.scene,
        found.normals,
        uncertainty=found.uncertainty,
        weights=found.weights,
        overwrite=options.overwrite,
    )
    if not options.quiet:
        with unread_is_no_failure():
            print(f"{paths[0]}: {said}")
            for line in _facts(found):
                print(f"  {line}")
            if len(paths) > 1:
                print(f"{paths[1]}: {_of_weights(found)}")
            scene = shlex.quote(str(options.scene))
            print(f"look at them: pbrfit inspect {scene} --preview normals_preview.png")
    return DONE


def _kind(source: str) -> str:
    if source in OPTIONS:
        return source
    return "depth" if source.startswith("depth:") else "file"


def _estimated(
    options: argparse.Namespace, kind: str, given: dict[str, Any]
) -> tuple[Normals, str]:
    """The normals, and where they come from in words."""
    import numpy as np

    from pbrfit.acquire.normals import estimate
    from pbrfit.acquire.scene_picture import shown
    from pbrfit.scene import completion as scene_completion
    from pbrfit.scene import folder as scene_folder

    size = scene_completion.picture_size(options.scene)
    blank: NDArray[np.uint8] = np.zeros((*size, 3), np.uint8)  # only its size matters
    settings = scene_folder.read_settings(options.scene / "scene.toml")
    if kind == "flat":
        return estimate("flat", blank, fov=0.0), "every surface faces the camera"
    if kind == "marigold":
        picture = given.pop("picture", None)
        space = given.pop("color_space", None) or settings.color_space
        seen = shown(options.scene, picture, space)
        with progress_bar(given.get("ensemble", 5), quiet=options.quiet, unit="prediction") as bar:
            found = estimate("marigold", seen.srgb8, fov=0.0, progress=bar.update, **given)
        return found, f"{found.record['model']}, shown {seen.what}"
    path = options.source.removeprefix("depth:")
    if kind == "depth":
        fov = scene_folder.field_of_view(options.scene, given.pop("fov", None))
        kinds = {"kind": given["depth_kind"]} if "depth_kind" in given else {}
        width = {"view_width": given["view_width"]} if "view_width" in given else {}
        found = estimate(options.source, blank, fov=fov, **kinds, **width)
        return found, f"from the depth in {path}, field of view {fov:g} degrees"
    convention = dataclasses.replace(
        settings.convention,
        **{"axes": given["convention"]} if "convention" in given else {},
        **{"frame": given["frame"]} if "frame" in given else {},
    )
    found = estimate(path, blank, fov=0.0, convention=convention)
    return found, f"{path}, {convention}"


def _facts(found: Normals) -> list[str]:
    """What to know about the normals, in lines."""
    import numpy as np

    tilt = np.degrees(np.arccos(np.clip(found.normals[..., 2], -1, 1)))
    lines = [
        f"turned away from the optical axis by {np.median(tilt):.0f} degrees (median), "
        f"{np.percentile(tilt, 95):.0f} (95 %)"
    ]
    if found.uncertainty is not None:
        middle, high = np.percentile(found.uncertainty, [50, 95])
        lines.append(f"uncertain by {middle:.1f} degrees (median), {high:.1f} (95 %)")
    if found.known is not None and not found.known.all():
        lines.append(
            f"{100 * np.mean(~found.known):.2g} % of the pixels have none: they face the camera "
            "and have weight 0"
        )
    return lines


def _of_weights(found: Normals) -> str:
    import numpy as np

    from pbrfit.acquire.normals import HALF_WEIGHT

    weights = found.weights
    assert weights is not None
    rule = f", 1/2 at {HALF_WEIGHT:g} degrees" if found.uncertainty is not None else ""
    return (
        f"weights of the pixels{rule}; median {np.median(weights):.2g}, mean {weights.mean():.2g}"
    )
