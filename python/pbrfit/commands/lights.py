"""`pbrfit lights`."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pbrfit._core import InputError
from pbrfit.commands import arguments as cli
from pbrfit.commands.network_options import Flags, add_source, asked_for, source
from pbrfit.commands.scene_options import STORED, field_of_view
from pbrfit.io.output import new_file
from pbrfit.model.lamps import Lamps
from pbrfit.report import lamp_sheet as drawn
from pbrfit.scene import ball as balls
from pbrfit.scene import completion, known_lamps
from pbrfit.scene.folder import check_unread, locate
from pbrfit.scene.options import ReadOptions
from pbrfit.scene.reading import read_pictures
from pbrfit.values.checks import errors_about

FLAGS: dict[str, Flags] = {
    "ball": {
        "circle": cli.value(
            "X,Y,R",
            cli.numbers("X,Y,R"),
            "where the ball is, and its radius, in pixels from the left and the top; again for "
            "each other ball of the same kind (default: it is sought)",
            action="append",
        ),
        "ball": cli.choice(
            (*balls.KINDS, "auto"),
            "mirror: lamps are where its highlights are; matt: where it is brightest "
            "(default: auto, by how much of it is bright)",
        ),
        "albedo": cli.value(
            "A",
            cli.number,
            "of a matt ball, such as 0.18 of a grey one; then the colours of lamps are known too",
        ),
        "fov": field_of_view(cli.number, "scene.toml, EXIF, else 60"),
        **STORED,
    },
    "file": {},
}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add its options."""
    parser.description = (
        "Give known lamps to a folder of pictures: lights.json, with the direction from which each "
        "picture was lit, as a mirror ball or a matt one in the pictures shows it, or as a file "
        "says: .lp (reflectance transformation imaging), .relight, .csv, .txt or .json."
    )
    cli.add_scene(parser)
    said = "ball: one that is seen in the pictures; FILE: .lp, .relight, .csv, .txt or .json"
    add_source(parser, source(("ball",), said))
    cli.add_flags(
        parser,
        preview=cli.value(
            "FILE", Path, "write a PNG with the ball, its highlights and the directions of lamps"
        ),
        overwrite=cli.switch("replace an existing lights.json and preview"),
    )
    cli.add_quiet(parser, "no summary")
    cli.add_flags(parser.add_argument_group("--from ball"), **FLAGS["ball"])


def run(options: argparse.Namespace) -> int:
    """Write lamps, and say where they are."""
    completion.check_no_lamps(options.scene, overwrite=options.overwrite)
    check_unread([options.scene], filter(None, [options.preview]))
    kind = "ball" if options.source == "ball" else "file"
    given: dict[str, Any] = asked_for(options, FLAGS, kind)
    if kind == "file":
        names = locate(options.scene).names
        lamps, said = known_lamps.load(Path(options.source), names)
        lines, shown = [said, *_table(names, lamps)], None
    else:
        names, lamps, lines, shown = _of_ball(options, given)
    if options.preview is not None:
        of = [names[i] for i in lamps.pictures[~lamps.near]]
        png = drawn.preview(of, lamps.places[~lamps.near], shown)
        with new_file(options.preview, overwrite=options.overwrite) as temporary:
            temporary.write_bytes(png)
    path = completion.add_lamps(options.scene, lamps, overwrite=options.overwrite)
    look = [] if options.preview is None else [f"look at them: {options.preview}"]
    cli.tell(options, [f"{path}: {lines[0]}", *lines[1:], *look])
    return cli.DONE


def _of_ball(
    options: argparse.Namespace, given: dict[str, Any]
) -> tuple[tuple[str, ...], Lamps, list[str], drawn.ShownBalls]:
    """Names of the pictures, their lamps, what there is to say, and what there is to see."""
    albedo = given.get("albedo")
    if albedo is not None and not 0 < albedo <= 1:
        raise InputError(f"albedo: expected a number above 0, 1 at most, found {albedo:g}")
    pictures, fov, fov_said = read_pictures(options.scene, ReadOptions.from_json(given))
    _, height, width, _ = pictures.pixels.shape
    with errors_about(options.scene):
        circles = [
            balls.checked_ball(x, y, radius, (height, width))
            for x, y, radius in given.get("circle", ())
        ]
        circles = circles or [balls.find_ball(pictures.pixels)]
        asked = given.get("ball", "auto")
        found = balls.lights_of_balls(
            pictures.pixels,
            pictures.limits,
            pictures.names,
            circles,
            fov,
            None if asked == "auto" else asked,
        )
    if albedo is not None and found.kind == "mirror":
        raise InputError("--albedo: has no meaning with a mirror ball")
    lamps = Lamps(
        np.arange(len(pictures.names)),
        found.directions,
        colors=None if albedo is None else found.colors / albedo,  # type: ignore[arg-type]
    )
    where = " and ".join(f"{one.x:.1f},{one.y:.1f},{one.radius:.1f}" for one in circles)
    how = "as given" if "circle" in given else "found"
    lines = [
        f"{known_lamps.in_words(lamps)}, from a {found.kind} ball at {where} (X,Y,R, {how}; "
        "--circle sets it)",
        f"  field of view {fov_said}",
        *_table(pictures.names, lamps, found),
    ]
    if found.kind == "matt" and albedo is None:
        lines.append("colours of lamps are known with --albedo A, that of the ball")
    mask = shlex.quote(str(options.scene / "mask.png"))
    lines.append(
        f"leave the ball out of the fit: in {mask} make black "
        + " and ".join(
            f"a disc of radius {1.1 * one.radius:.0f} around {one.x:.0f},{one.y:.0f}"
            for one in circles
        )
    )
    what = "highlights" if found.kind == "mirror" else "where it faces a lamp"
    mean = pictures.pixels.mean(axis=0, dtype=np.float64)
    return pictures.names, lamps, lines, drawn.ShownBalls(mean, circles, found.highlights, what)


def _table(names: Sequence[str], lamps: Lamps, found: balls.BallLights | None = None) -> list[str]:
    """A line a lamp."""
    wide = max(7, *(len(name) for name in names))
    heads = f"  {'picture':<{wide}}{'azimuth':>10}{'elevation':>11}"
    if found is not None:
        heads += f"{'sure to':>10}" + (f"{'residual':>10}" if found.kind == "matt" else "")
    lines = [heads] if not lamps.near.all() else []
    angles = known_lamps.angles(lamps.places)
    for k, i in enumerate(lamps.pictures):
        line = f"  {names[i]:<{wide}}"
        if lamps.near[k]:
            x, y, z = lamps.places[k]
            lines.append(f"{line}  near, at {x:.3g}, {y:.3g}, {z:.3g}")
            continue
        azimuth, elevation = angles[k]
        line += f"{azimuth:>9.1f}°{elevation:>10.1f}°"
        if found is not None:
            line += f"{found.degrees[k]:>9.1f}°"
            if found.kind == "matt":
                line += f"{100 * found.residuals[k]:>8.2g} %"
        lines.append(line)
    return lines
