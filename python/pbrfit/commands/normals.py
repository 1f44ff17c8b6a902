"""`pbrfit normals`."""

from __future__ import annotations

import argparse
import re
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np

from pbrfit._core import InputError
from pbrfit.acquire.marigold import ENSEMBLE, NORMALS_MODEL
from pbrfit.acquire.normals import HALF_WEIGHT, Normals, estimate, kind_of
from pbrfit.commands import arguments as cli
from pbrfit.commands import network_options as network
from pbrfit.commands.progress import fit_steps
from pbrfit.commands.scene_options import DEPTH_KIND, STORED, field_of_view
from pbrfit.fit.lamps.estimator import normals_from_pictures
from pbrfit.model.materials import nearest_inside
from pbrfit.scene import completion, known_lamps, reading
from pbrfit.scene import folder as scene_folder
from pbrfit.scene.arrays import SHAPE_PICTURES_MIN
from pbrfit.scene.options import ReadOptions
from pbrfit.scene.scene import Scene
from pbrfit.values.arrays import Codes
from pbrfit.values.checks import errors_about

FLAGS: dict[str, network.Flags] = {
    "marigold": {
        **network.SHOWN,
        **network.ensemble("averaged; from 3 on, what they differ by gives the weights"),
        **network.SAMPLER,
        **network.checkpoint(NORMALS_MODEL),
        **network.DEVICE,
        **network.PRECISION,
    },
    "depth": {
        "depth_kind": DEPTH_KIND,
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
            "opengl: Y up; directx: Y down (default: by FILE's name, else scene.toml, else opengl)",
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

OF_PICTURES: network.Flags = {"threads": cli.THREADS, **STORED}
FLAGS["pictures"] = {
    **OF_PICTURES,
    "color_space": FLAGS["marigold"]["color_space"],
    "fov": FLAGS["depth"]["fov"],
}

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
        "much pixels count in a fit. pictures writes height.exr, too: height towards the viewer in "
        "pixels. marigold needs the extra packages pbrfit[diffusion]."
    )
    cli.add_scene(parser)
    said = (
        "marigold: a network's estimate; pictures: from three or more pictures under lamps; flat: "
        "every surface faces the camera; depth:FILE: from a depth map; FILE: normals that are "
        "there already"
    )
    network.add_source(parser, network.source(("marigold", "pictures", "flat"), said, ("depth:",)))
    cli.add_flags(parser, overwrite=cli.switch("replace existing normals and weights"))
    cli.add_quiet(parser, "no progress bar, no summary")
    for kind, title in TITLES.items():
        cli.add_flags(parser.add_argument_group(title), **FLAGS[kind])
    title = "--from pictures, beside --color-space and --fov"
    cli.add_flags(parser.add_argument_group(title), **OF_PICTURES)


def run(options: argparse.Namespace) -> int:
    """Write normals and weights, and say what they are like."""
    if options.source == "pictures":
        return _run_pictures(options)
    completion.check_normals_can_be_added(options.scene, overwrite=options.overwrite)
    found, said = _estimated(options)
    paths = completion.add_normals(
        options.scene,
        found.normals,
        uncertainty=found.uncertainty,
        weights=found.weights,
        overwrite=options.overwrite,
    )
    lines = [f"{paths[0]}: {said}", *(f"  {line}" for line in _facts(found))]
    rule = f", 1/2 at {HALF_WEIGHT:g} degrees" if found.uncertainty is not None else ""
    lines += [f"{path}: weights of the pixels{rule}" for path in paths[1:]]
    cli.tell(options, [*lines, _look_at(options.scene)])
    return cli.DONE


def _run_pictures(options: argparse.Namespace) -> int:
    """The same, of normals that pictures under lamps tell."""
    folder, overwrite = options.scene, options.overwrite
    completion.check_normals_can_be_added(folder, overwrite=overwrite, height=True)
    given = network.asked_for(options, FLAGS, "pictures")
    threads = given.pop("threads", 0)
    if (count := len(scene_folder.locate(folder).pictures)) < SHAPE_PICTURES_MIN:
        raise InputError(
            f"{folder}: expected {SHAPE_PICTURES_MIN} or more pictures under different lamps, "
            f"found {count}"
        )
    scene = reading.load(folder, Scene, ReadOptions(**given), pictures_alone=True)
    with errors_about(folder), fit_steps(quiet=options.quiet) as show:
        found = normals_from_pictures(scene, threads=threads, progress=show)
    normals, sigma, height, lamps, left_open = found
    inside = nearest_inside(scene.valid)
    paths = completion.add_normals(
        folder,
        normals[inside],
        uncertainty=sigma[inside],
        height=height,
        overwrite=overwrite,
    )
    low, high = np.nanpercentile(height, [0, 100])
    facts = _facts(Normals(normals[scene.valid], sigma[scene.valid]))
    facts += [known_lamps.in_words(lamps), *(f"not determined: {words}" for words in left_open)]
    lines = [f"{paths[0]}: from {count} pictures under lamps", *(f"  {one}" for one in facts)]
    lines.append(f"{paths[1]}: from {low:.3g} to {high:.3g} pixels")
    cli.tell(options, [*lines, _look_at(folder)])
    return cli.DONE


def _look_at(scene: Path) -> str:
    command = f"pbrfit inspect {shlex.quote(str(scene))} --preview normals_preview.png"
    return f"look at them: {command}"


def _estimated(options: argparse.Namespace) -> tuple[Normals, str]:
    """The normals, and where they come from in words."""
    kind, scene = kind_of(options.source), options.scene
    given = network.asked_for(options, FLAGS, kind)
    if kind == "marigold":
        srgb8, what = network.shown(scene, given)
        total = given.get("ensemble", ENSEMBLE)
        with cli.progress_bar(total, quiet=options.quiet, unit="prediction") as bar:
            found = estimate(kind, srgb8, fov=0.0, progress=bar.update, **given)
        return found, f"{found.record['model']}, shown {what}"
    path, fov, said = options.source.removeprefix("depth:"), 0.0, "every surface faces the camera"
    if kind == "depth":
        fov = reading.read_surface(scene, ReadOptions(fov=given.pop("fov", None))).fov
        said = f"from the depth in {path}, field of view {fov:g} degrees"
    elif kind == "file":
        axes = given.pop("convention", None)
        if named := re.search(
            r"(?i)nor(mals?)?_?((dx|directx)|gl|opengl)(?![a-z])", Path(path).stem
        ):
            axes = axes or ("directx" if named[3] else "opengl")
        convention = scene_folder.read_settings(scene / "scene.toml").convention
        given = {"convention": replace(convention, **given, **({"axes": axes} if axes else {}))}
        said = f"{path}, {given['convention']}"
    blank: Codes = np.zeros((*completion.picture_size(scene), 3), np.uint8)
    return estimate(options.source, blank, fov=fov, **given), said  # only their size matters


def _facts(found: Normals) -> list[str]:
    """What to know about the normals, in lines."""
    tilt = np.degrees(np.arccos(np.clip(found.normals[..., 2], -1, 1)))
    lines = [
        *found.remarks,
        f"turned away from the optical axis by {np.median(tilt):.0f} degrees (median), "
        f"{np.percentile(tilt, 95):.0f} (95 %)",
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
