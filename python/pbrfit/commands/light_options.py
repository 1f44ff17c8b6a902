"""Options that name a light: `--env`, `--light`, `--sh` and what goes with them."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.commands.arguments import add_flags, choice, number, numbers, value
from pbrfit.model import panorama
from pbrfit.model.lighting import Lighting, rotated
from pbrfit.model.panorama import Window
from pbrfit.result.relighting import DirectionalLight

NAMES_SHOWN = 32
"""Names of pictures that a message lists."""


Light = NDArray[np.float64] | DirectionalLight
"""SH light (16, 3), or a hard one."""

Facts = list[tuple[str, str]]
"""Topics, and a sentence on each."""


def add_light(parser: argparse.ArgumentParser) -> None:
    """Add the options, of which one light has to be given; `choose_light` reads them."""
    lights = parser.add_argument_group("light, one of")
    one = lights.add_mutually_exclusive_group(required=True)
    add_flags(
        one,
        env=value(
            "PANORAMA",
            Path,
            "equirectangular picture, .hdr or .exr: its centre looks along -Z, into the scene; "
            "projected to SH light",
        ),
        light=value(
            "AZIMUTH,ELEVATION",
            numbers(2, "AZIMUTH,ELEVATION"),
            "hard light from far away, in degrees: 0,0 is the viewer's, 90,0 comes from the "
            "right, 0,90 from above",
        ),
        sh=value("FILE", Path, "SH light of a lighting.json, such as RESULT's own"),
    )
    add_flags(
        lights,
        rotate=value(
            "DEG",
            number,
            "with --env, --sh: turn the light about +Y, from the viewer to the right (default: 0)",
        ),
        window=choice(
            Window, "with --env: damp what rings about lamps after the projection (default: none)"
        ),
        color=value(
            "R,G,B",
            numbers(3, "R,G,B"),
            "with --light: radiance of a white matt surface that faces it (default: 1,1,1)",
        ),
        picture=value("NAME", str, "with --sh: whose light of the file"),
    )


def choose_light(options: argparse.Namespace) -> tuple[Light, Facts]:
    """Read what the options name, and what there is to say about it.

    Raises InputError or OSError if a file cannot be used.
    """
    if options.light is not None:
        azimuth, elevation = options.light
        light = DirectionalLight(azimuth, elevation, options.color or (1.0, 1.0, 1.0))
        color = ", ".join(f"{channel:g}" for channel in light.color)
        fact = f"hard, from azimuth {azimuth:g}, elevation {elevation:g}, color {color}"
        return light, [("light", fact)]
    degrees = options.rotate or 0.0
    turn = f", turned by {degrees:g} degrees" if degrees else ""
    if options.env is not None:
        return _projected(options, degrees, turn)
    lighting = Lighting.load(options.sh)
    name = _whose(lighting.pictures, options)
    coefficients = lighting.of((name,), options.sh)[0]
    if degrees:
        coefficients = rotated(coefficients, degrees)
    return coefficients, [("light", f"SH, of {name} in {options.sh}{turn}")]


def _projected(options: argparse.Namespace, degrees: float, turn: str) -> tuple[Light, Facts]:
    """SH light of a panorama."""
    pixels = panorama.read(options.env)
    plain = panorama.project(pixels, degrees)
    lost = panorama.lost_energy(pixels, plain)
    window: Window = options.window or "none"
    light = panorama.windowed(plain, window)
    facts = [
        ("light", f"{options.env}, projected to SH light up to l = 3{turn}"),
        (
            "projection",
            f"loses {100 * lost:.1f} % of the light's energy, all that is sharper: matt surfaces "
            "hardly miss it, highlights do"
            + (" (for a sun or a lamp try --light)" if lost > 0.5 else ""),
        ),
    ]
    least = panorama.darkest(light)
    mean = float(light[0].mean()) / math.sqrt(4 * math.pi)
    if window != "none":
        facts.append(("window", f"{window}, which blurs the light: its least radiance {least:.3g}"))
    if least < -1e-6 * mean:
        cures = "nonnegative ends" if window == "lanczos" else "lanczos lessens, nonnegative ends"
        facts.append(
            (
                "ringing",
                f"the projected light falls to {least:.3g}, its mean is {mean:.3g}: shiny surfaces "
                f"may get black spots, which --window {cures}",
            )
        )
    return light, facts


def _whose(pictures: tuple[str, ...], options: argparse.Namespace) -> str:
    shown = ", ".join(pictures[:NAMES_SHOWN])
    if len(pictures) > NAMES_SHOWN:
        shown += f" and {len(pictures) - NAMES_SHOWN} more"
    if options.picture is not None:
        if options.picture not in pictures:
            raise InputError(
                f"{options.sh}: expected a light of {options.picture} (--picture), found {shown}"
            )
        return str(options.picture)
    if len(pictures) != 1:
        raise InputError(
            f"{options.sh}: expected --picture NAME, because it holds {len(pictures)} lights: "
            f"{shown}"
        )
    return pictures[0]
