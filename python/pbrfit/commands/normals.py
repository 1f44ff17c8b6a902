"""`pbrfit normals`."""

from __future__ import annotations

import argparse
import dataclasses
import shlex
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.acquire.normals import HALF_WEIGHT, Normals, estimate, kind_of, marigold
from pbrfit.acquire.photo import shown_to_network
from pbrfit.commands import arguments as cli
from pbrfit.commands.network_options import (
    DEVICE,
    NORMAL_SOURCES,
    PRECISION,
    SHOWN,
    Flags,
    asked_for,
    checkpoint,
    normal_source,
)
from pbrfit.commands.scene_options import field_of_view
from pbrfit.model.depth_normals import DepthKind
from pbrfit.scene import completion
from pbrfit.scene import folder as scene_folder

FLAGS: dict[str, Flags] = {
    "marigold": {
        **SHOWN,
        "ensemble": cli.value(
            "E",
            cli.positive,
            "predictions that are averaged; from 3 on, what they differ by gives the weights "
            f"(default: {marigold.ENSEMBLE})",
        ),
        "steps": cli.value("N", cli.positive, "of the sampler (default: the model's)"),
        "resolution": cli.value(
            "PIXELS",
            cli.whole_number,
            "longer side at which the network sees the picture, 0 = as it is (default: the "
            "model's)",
        ),
        "seed": cli.value(
            None, cli.whole_number, "of the first prediction, the next has one more (default: 0)"
        ),
        **checkpoint(marigold.MODEL),
        **DEVICE,
        **PRECISION,
    },
    "depth": {
        "depth_kind": cli.choice(
            DepthKind,
            "what a number says, up to any factor: the distance along the optical axis, that along "
            "the pixel's ray, or the inverse of the first (default: z)",
        ),
        "fov": field_of_view(cli.number, "scene.toml, EXIF, else 60"),
        "view_width": cli.value(
            "WIDTH",
            cli.number,
            "what an orthographic camera sees from left to right, in units of the depth",
        ),
    },
    "file": {
        "convention": cli.choice(
            ("opengl", "directx"),
            "opengl: Y up; directx: Y down (default: scene.toml, else opengl)",
        ),
        "frame": cli.choice(
            ("camera", "tangent", "world"),
            "camera: X right, Z to the viewer; tangent: the texture of a flat card that faces the "
            "camera; world: turned by scene.toml's world_to_camera (default: scene.toml, else "
            "camera)",
        ),
    },
    "flat": {},
}
"""Options of each kind of source."""

TITLES = {
    "marigold": "--from marigold",
    "depth": "--from depth:FILE (EXR, PNG or TIFF of 16 bits, .npy)",
    "file": "--from FILE (EXR, PNG, TIFF, .npy)",
}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add its options."""
    parser.description = (
        "Give normals to a folder of pictures: normals.exr, in the convention that the folder's "
        "scene.toml states, and where some are uncertain or missing weights.exr, which says how "
        "much pixels count in a fit. marigold needs the extra packages pbrfit[diffusion]."
    )
    cli.add_scene(parser)
    parser.add_argument(
        "--from",
        dest="source",
        metavar=NORMAL_SOURCES,
        type=normal_source,
        default="marigold",
        help="marigold: a network's estimate; flat: every surface faces the camera; depth:FILE: "
        "from a depth map; FILE: normals that are there already",
    )
    cli.add_flags(parser, overwrite=cli.switch("replace existing normals and weights"))
    cli.add_quiet(parser, "no progress bar, no summary")
    for kind, title in TITLES.items():
        cli.add_flags(parser.add_argument_group(title), **FLAGS[kind])


def run(options: argparse.Namespace) -> int:
    """Write normals and weights, and say what they are like."""
    completion.check_normals_can_be_added(options.scene, overwrite=options.overwrite)
    found, said = _estimated(options)
    paths = completion.add_normals(
        options.scene,
        found.normals,
        uncertainty=found.uncertainty,
        weights=found.weights,
        overwrite=options.overwrite,
    )
    if not options.quiet:
        with cli.unread_is_no_failure():
            print(f"{paths[0]}: {said}")
            for line in _facts(found):
                print(f"  {line}")
            if len(paths) > 1:
                print(f"{paths[1]}: {_of_weights(found)}")
            scene = shlex.quote(str(options.scene))
            print(f"look at them: pbrfit inspect {scene} --preview normals_preview.png")
    return cli.DONE


def _estimated(options: argparse.Namespace) -> tuple[Normals, str]:
    """The normals, and where they come from in words."""
    kind = kind_of(options.source)
    given: dict[str, Any] = asked_for(options, FLAGS, kind, f"--from {options.source}")
    if kind == "marigold":
        space = given.pop("color_space", None)
        srgb8, what = shown_to_network(options.scene, given.pop("picture", None), space)
        total = given.get("ensemble", marigold.ENSEMBLE)
        with cli.progress_bar(total, quiet=options.quiet, unit="prediction") as bar:
            found = estimate(kind, srgb8, fov=0.0, progress=bar.update, **given)
        return found, f"{found.record['model']}, shown {what}"
    size = completion.picture_size(options.scene)
    blank: NDArray[np.uint8] = np.zeros((*size, 3), np.uint8)  # only its size matters
    if kind == "flat":
        return estimate(kind, blank, fov=0.0), "every surface faces the camera"
    path = options.source.removeprefix("depth:")
    if kind == "depth":
        fov = scene_folder.field_of_view(options.scene, given.pop("fov", None))
        found = estimate(options.source, blank, fov=fov, **given)
        return found, f"from the depth in {path}, field of view {fov:g} degrees"
    convention = scene_folder.read_settings(options.scene / "scene.toml").convention
    if "convention" in given:
        given["axes"] = given.pop("convention")
    convention = dataclasses.replace(convention, **given)
    found = estimate(path, blank, fov=0.0, convention=convention)
    return found, f"{path}, {convention}"


def _facts(found: Normals) -> list[str]:
    """What to know about the normals, in lines."""
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
    weights = found.weights
    assert weights is not None
    rule = f", 1/2 at {HALF_WEIGHT:g} degrees" if found.uncertainty is not None else ""
    return (
        f"weights of the pixels{rule}; median {np.median(weights):.2g}, mean {weights.mean():.2g}"
    )
