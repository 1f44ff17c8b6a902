"""Colours of furnished rooms, in linear Rec.709, and paints made from them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pbrfit.synthetic.surfaces import Paint

Array = NDArray[np.float64]
Rng = np.random.Generator

# Linear Rec.709. Oak, light oak, pine, cherry, walnut, mahogany, ebony.
WOODS = np.array(
    [
        [0.36, 0.21, 0.10],
        [0.50, 0.33, 0.18],
        [0.62, 0.44, 0.24],
        [0.40, 0.17, 0.08],
        [0.16, 0.085, 0.045],
        [0.22, 0.07, 0.035],
        [0.06, 0.045, 0.035],
    ]
)
# Lacquers, glazes and dyes: white, cream, brick, ochre, olive, sage, teal, navy, sky, plum, rose,
# charcoal, terracotta, mustard.
DYES = np.array(
    [
        [0.80, 0.79, 0.76],
        [0.74, 0.66, 0.50],
        [0.42, 0.09, 0.06],
        [0.62, 0.34, 0.08],
        [0.18, 0.19, 0.06],
        [0.33, 0.42, 0.30],
        [0.05, 0.26, 0.27],
        [0.035, 0.065, 0.20],
        [0.30, 0.48, 0.66],
        [0.20, 0.06, 0.16],
        [0.62, 0.31, 0.31],
        [0.045, 0.047, 0.05],
        [0.48, 0.17, 0.09],
        [0.66, 0.45, 0.05],
    ]
)
# Wall paints: chalk, linen, sage, dusk blue, clay, moss, blush, slate.
WALL_PAINTS = np.array(
    [
        [0.78, 0.76, 0.70],
        [0.66, 0.58, 0.45],
        [0.45, 0.53, 0.43],
        [0.28, 0.38, 0.50],
        [0.56, 0.34, 0.24],
        [0.17, 0.22, 0.14],
        [0.68, 0.48, 0.42],
        [0.20, 0.23, 0.27],
    ]
)
# Stones: white marble, beige limestone, grey granite, green marble, black marble, red marble.
STONES = np.array(
    [
        [0.76, 0.75, 0.73],
        [0.60, 0.51, 0.38],
        [0.30, 0.30, 0.31],
        [0.07, 0.15, 0.10],
        [0.035, 0.035, 0.04],
        [0.33, 0.10, 0.07],
    ]
)
LEAVES = np.array([[0.06, 0.17, 0.03], [0.16, 0.27, 0.05], [0.03, 0.10, 0.04], [0.30, 0.30, 0.06]])
FRUIT = np.array([[0.45, 0.05, 0.03], [0.68, 0.30, 0.03], [0.35, 0.45, 0.06], [0.70, 0.55, 0.08]])
RUST, VERDIGRIS = np.array([0.26, 0.085, 0.035]), np.array([0.17, 0.36, 0.28])
DARKEST, LIGHTEST = 0.014, 0.86  # of dielectrics, linear; sRGB 31 and 239 of 255
LIGHTEST_METAL = 0.98


def paint(color: Array, roughness: float, rng: Rng, spread: float = 0.2) -> Paint:
    """Draw a dielectric of about this colour and roughness."""
    light = rng.uniform(1 - spread, 1 + spread) * rng.uniform(0.93, 1.07, size=3)
    albedo = np.clip(color * light, DARKEST, LIGHTEST)
    return Paint(albedo, float(np.clip(roughness + rng.uniform(-0.06, 0.06), 0.12, 0.95)), 0.0)


def darker(paint: Paint, factor: float, rougher: float = 0.0) -> Paint:
    """Scale the albedo of a dielectric, and make it rougher."""
    return replace(
        paint,
        albedo=np.clip(paint.albedo * factor, DARKEST, LIGHTEST),
        roughness=float(np.clip(paint.roughness + rougher, 0.12, 0.95)),
    )
