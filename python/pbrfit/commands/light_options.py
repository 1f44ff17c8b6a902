"""Options that name a light: `--env`, `--light`, `--lamp`, `--sh`, `--picture`."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from pbrfit._core import InputError
from pbrfit.commands.arguments import add_flags, number, numbers, value
from pbrfit.model.environment import Environment
from pbrfit.model.lighting import Lighting
from pbrfit.result.relighting import SOFTEST, DirectionalLight, Light, PointLight, turned
from pbrfit.result.result import Result
from pbrfit.values.quoting import listed

Facts = list[tuple[str, str]]
"""Topics, and a sentence on each."""


def add_light(parser: argparse.ArgumentParser) -> None:
    """Add the options, of which one light has to be given; `choose_light` reads them."""
    lights = parser.add_argument_group("light, one of")
    one = lights.add_mutually_exclusive_group()
    add_flags(
        one,
        env=value(
            "PANORAMA",
            Path,
            "equirectangular picture, .hdr or .exr: its centre looks along -Z, into the scene",
        ),
        light=value(
            "AZIMUTH,ELEVATION",
            numbers("AZIMUTH,ELEVATION"),
            "hard light from far away, in degrees: 0,0 is the viewer's, 90,0 comes from the "
            "right, 0,90 from above",
        ),
        lamp=value(
            "X,Y,Z",
            numbers("X,Y,Z"),
            "a lamp near the surface, of results with depth, in its unit: the camera is at 0,0,0, "
            "X is right, Y up, and what it sees has Z below 0",
        ),
        sh=value("FILE", Path, "light of a lighting.json: SH light, and lamps if it has some"),
    )
    add_flags(
        lights,
        rotate=value(
            "DEG",
            number,
            "with --env, --sh, --picture: turn the light about +Y, from the viewer to the right "
            "(default: 0)",
        ),
        color=value(
            "R,G,B",
            numbers("R,G,B"),
            "with --light, --lamp: radiance of a white matt surface that faces it, of --lamp at "
            "the middle of what is seen (default: 1,1,1)",
        ),
        softness=value(
            "SIZE",
            number,
            f"with --light: angular radius of the lamp in degrees, 0 to {SOFTEST:g} (the sun: "
            "0.27); with --lamp: its radius in the depth's unit (default: 0, a point)",
        ),
        picture=value(
            "NAME", str, "with --sh: whose light of the file; alone: that of a picture of RESULT"
        ),
    )


def choose_light(options: argparse.Namespace, result: Result) -> tuple[Light, Facts]:
    """Read what the options name, and what there is to say about it.

    Without any other, `--picture` means the light that was found of a picture of the result.

    Raises InputError or OSError if a file cannot be used.
    """
    if options.light is not None:
        azimuth, elevation = options.light
        color, softness = options.color or (1.0, 1.0, 1.0), options.softness or 0.0
        light = DirectionalLight(azimuth, elevation, color, softness)
        shown = ", ".join(f"{channel:g}" for channel in light.color)
        kind = f"a disk of {softness:g} degrees," if softness else "hard,"
        fact = f"{kind} from azimuth {azimuth:g}, elevation {elevation:g}, color {shown}"
        return light, [("light", fact)]
    if options.lamp is not None:
        return _near(options, result)
    degrees = options.rotate or 0.0
    turn = f", turned by {degrees:g} degrees" if degrees else ""
    if options.env is not None:
        panorama = Environment.read(options.env, degrees)
        height, width = panorama.pixels.shape[:2]
        return panorama, [("light", f"{options.env}, a panorama of {width} × {height}{turn}")]
    file = options.result / "lighting.json" if options.sh is None else options.sh
    lighting, name = Lighting.load(file), options.picture
    pictures = lighting.pictures
    if name is None and len(pictures) == 1:
        name = pictures[0]
    if name not in pictures:
        expected = f"a light of {name} (--picture)"
        if name is None:
            expected = f"--picture NAME, because it holds {len(pictures)} lights"
        raise InputError(f"{file}: expected {expected}, found {listed(pictures)}")
    i, what = pictures.index(name), "SH"
    own: Light = (ambient := lighting.coefficients[i])
    if lighting.lamps is not None:
        lamps = lighting.lamps.of_pictures([i])
        if not lamps.colored:
            raise InputError(f"{file}: expected known colors of the lamps of {name}, found none")
        own, what = (lamps, ambient), f"{lamps.in_words()} and ambient SH light"
    own = turned(own, degrees) if degrees else own
    return own, [("light", f"{what}, of {name} in {file}{turn}")]


def _near(options: argparse.Namespace, result: Result) -> tuple[PointLight, Facts]:
    """A lamp at a place, as bright at the middle of what is seen as the colour says."""
    middle = result.middle
    if middle is None:
        raise InputError(
            f"{options.result}: expected a result with depth for --lamp, found one without"
        )
    color = options.color or (1.0, 1.0, 1.0)
    distance = float(np.linalg.norm(np.array(options.lamp) - middle))
    at_one = DirectionalLight(0, 0, color).color
    red, green, blue = (channel * distance**2 for channel in at_one)
    lamp = PointLight(options.lamp, (red, green, blue), options.softness or 0.0)
    said = ", ".join(f"{one:g}" for one in options.lamp)
    fact = f"near, at {said}, which is {distance:.3g} from the middle of what is seen"
    return lamp, [("light", fact), ("", f"color {', '.join(f'{c:g}' for c in color)} there")]
