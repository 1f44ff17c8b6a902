"""What SH light leaves of panoramas: the tables of docs/relight.md.

    python tools/sh_relighting.py PANORAMA...

A sphere is rendered under each panorama twice: under its SH projection with the model that pbrfit
fits, and under every pixel of it with the full one (`pbrfit.model.reflection.render_directional`).
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pbrfit import Materials
from pbrfit.model import panorama
from pbrfit.model.reflection import Model, render, render_directional

Array = NDArray[np.float64]

SIDE = 24
ROWS = 256
"""Panoramas are averaged down to so many rows: 0.7 degrees a pixel."""

LIGHTS = 2048
"""Pixels of the panorama at once."""

MODEL: Model = "paper"

SURFACES = {
    "matt, r = 1": (0.8, 1.0, 0.0),
    "glossy plastic, r = 0.3": (0.5, 0.3, 0.0),
    "rough metal, r = 0.7": (0.8, 0.7, 1.0),
    "metal, r = 0.4": (0.8, 0.4, 1.0),
    "polished metal, r = 0.2": (0.8, 0.2, 1.0),
}
"""Albedo, roughness, metallic."""


def main() -> None:
    """Print the tables as Markdown."""
    paths = [Path(argument) for argument in sys.argv[1:]]
    pictures = {path.stem: panorama.read(path) for path in paths}
    print("| panorama | lost energy | least radiance / mean | lanczos | nonnegative |")
    print("|---|---|---|---|---|")
    for name, pixels in pictures.items():
        light = panorama.project(pixels)
        mean = float(light[0].mean()) / np.sqrt(4 * np.pi)
        lost = panorama.lost_energy(pixels, light)
        least = [panorama.darkest(panorama.windowed(light, w)) / mean for w in panorama.WINDOWS]
        print(f"| {name} | {100 * lost:.1f} % | " + " | ".join(f"{x:.2f}" for x in least) + " |")
    for window in panorama.WINDOWS:
        print(f"\nwindow {window}\n\n| panorama | " + " | ".join(SURFACES) + " |")
        print("|---" * (len(SURFACES) + 1) + "|")
        for name, pixels in pictures.items():
            errors = [f"{error:.2f}" for error in _errors(name, pixels, window)]
            print(f"| {name} | " + " | ".join(errors) + " |", flush=True)


def _errors(name: str, pixels: NDArray[np.float32], window: panorama.Window) -> list[float]:
    """RMSE over the RMS radiance of a sphere, a surface each."""
    small = _averaged(np.asarray(pixels, dtype=np.float64))
    light = panorama.windowed(panorama.project(small), window)
    errors = []
    for surface in SURFACES.values():
        key = (name, surface)
        if key not in _TRUE:
            _TRUE[key] = _under_every_pixel(small, surface)
        materials, normals = _sphere(surface)
        found = render(materials, normals, light, 0.0, model=MODEL)
        errors.append(float(np.sqrt(np.mean((found - _TRUE[key]) ** 2) / np.mean(_TRUE[key] ** 2))))
    return errors


_TRUE: dict[tuple[str, tuple[float, float, float]], Array] = {}


def _sphere(surface: tuple[float, float, float]) -> tuple[Materials, Array]:
    """The pixels of a sphere up to 80 degrees from its middle, as one row."""
    at = (2 * np.arange(SIDE) + 1 - SIDE) / SIDE
    x, y = (grid.ravel() for grid in np.meshgrid(at, -at))
    seen = x**2 + y**2 < np.sin(np.radians(80)) ** 2
    x, y = x[seen], y[seen]
    normals = np.stack([x, y, np.sqrt(1 - x**2 - y**2)], axis=-1)[None]
    albedo, roughness, metallic = (np.full((1, len(x)), value) for value in surface)
    return Materials(np.repeat(albedo[..., None], 3, axis=-1), roughness, metallic), normals


def _averaged(pixels: Array) -> Array:
    """Energy is kept: means weighted by solid angle."""
    factor = max(1, len(pixels) // ROWS)
    weights = panorama.solid_angles(*pixels.shape[:2])[:, None, None]
    height, width = len(pixels) // factor, pixels.shape[1] // factor
    blocks = (height, factor, width, factor, 3)
    total = (pixels * weights).reshape(blocks).sum(axis=(1, 3))
    return total / panorama.solid_angles(height, width)[:, None, None]


def _under_every_pixel(pixels: Array, surface: tuple[float, float, float]) -> Array:
    materials, normals = _sphere(surface)
    directions = panorama.directions(*pixels.shape[:2]).reshape(-1, 3)
    # Radiance that arrives from dω is an irradiance of so much times dω, or π times a colour.
    colors = pixels * panorama.solid_angles(*pixels.shape[:2])[:, None, None] / np.pi
    colors = colors.reshape(-1, 3)
    total = np.zeros((1, normals.shape[1], 3))
    for first in range(0, len(directions), LIGHTS):
        some = slice(first, first + LIGHTS)
        total += render_directional(
            materials, normals, directions[some], colors[some], 0.0, model=MODEL
        ).sum(0)
    return total


if __name__ == "__main__":
    main()
