"""The lights of a result: on two balls, as panoramas, and in numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pbrfit.display.tone import encoded
from pbrfit.model import panorama
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import Model, render
from pbrfit.report.maps import BALL_SIDE, ball_normals
from pbrfit.result import metrics
from pbrfit.scene.known_lamps import angles
from pbrfit.values.arrays import Array

PANORAMA_HEIGHT = 96
GAP = 8

MIRROR_ROUGHNESS = 0.1
"""Roughness of the mirror ball: lights of l ≤ 3 hold nothing that a sharper mirror would show."""

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Weights of linear Rec.709 R, G, B. Source: ITU-R BT.709-6."""

HATCH = 8
"""Pixels between the lines that mark negative radiance."""


@dataclass(frozen=True)
class Light:
    """A light in numbers."""

    mean: float
    """Radiance averaged over all directions, as luminance, in picture units."""
    azimuth: float
    elevation: float
    """Of the main direction, which is that of band 1, in degrees."""
    directed: float
    """0 for environment light, 1 for light from one direction."""
    color: tuple[float, float, float]
    """Mean radiance in the channels, the largest 1."""
    negative: float
    """Share of the positive light (as luminance) that negative radiance takes away again."""


def measure(coefficients: Array) -> Light:
    """Sum up a light (16, 3).

    Light of luminance E from one direction d has L_k = E Y_k(d), so band 1 is E √(3/4π) d, and its
    length is √3 |L₀|.
    """
    luminance = coefficients @ LUMINANCE
    main = luminance[[3, 1, 2]]  # x, y, z
    length = float(np.linalg.norm(main))
    direction = main / length if length > 0 else np.array([0.0, 0.0, 1.0])
    [[azimuth, elevation]] = angles(direction[None]).tolist()
    first = abs(float(luminance[0]))
    radiance = panorama.radiance(coefficients, 32) @ LUMINANCE
    weights = panorama.solid_angles(*radiance.shape)[:, None]
    positive = float(np.sum(weights * np.maximum(radiance, 0)))
    negative = float(np.sum(weights * np.maximum(-radiance, 0)))
    mean = np.maximum(coefficients[0], 0) / (2 * math.sqrt(math.pi))
    red, green, blue = (mean / (mean.max() or 1.0)).tolist()
    return Light(
        mean=float(luminance[0]) / (2 * math.sqrt(math.pi)),
        azimuth=azimuth,
        elevation=elevation,
        directed=min(1.0, length / (math.sqrt(3) * first)) if first > 0 else 0.0,
        color=(red, green, blue),
        negative=negative / positive if positive > 0 else 0.0,
    )


def balls_and_panorama(coefficients: Array, light: Light, model: Model) -> tuple[Array, Array]:
    """Pictures of a light as they go to the screen, NaN beside the balls, which are of a model.

    Both have the same exposure: white is the 98th percentile of the panorama.
    """
    radiance = panorama.radiance(coefficients, PANORAMA_HEIGHT)
    white = metrics.white_of(radiance)
    shown = encoded(radiance / white)
    rows, columns = np.indices(radiance.shape[:2])
    hatching = np.where((rows + columns) % HATCH < 2, 0.6, 0.1)
    dark = radiance @ LUMINANCE < 0
    shown = np.where(dark[..., None], hatching[..., None], shown)
    _ring(shown, light)
    # A matt white ball beside a mirror.
    ball = ball_normals(BALL_SIDE)
    normals = np.concatenate([ball, np.full((BALL_SIDE, GAP, 3), np.nan), ball], axis=1)
    mirror = np.zeros(normals.shape[:2])
    mirror[:, BALL_SIDE:] = 1.0
    roughness = np.where(mirror > 0, MIRROR_ROUGHNESS, 1.0)
    materials = Materials(np.ones(normals.shape), roughness, mirror)
    balls = render(materials, normals, coefficients, 0.0, model=model)
    return encoded(balls / white), shown


def _ring(shown: Array, light: Light) -> None:
    """Draw a ring around the main direction: black in white, to be seen on any ground."""
    height, width = shown.shape[:2]
    # The inverse of the formulas in `panorama`: azimuth 0 is +Z, at the left and right edge.
    column = ((180 - light.azimuth) / 360 + 0.5) % 1 * width
    row = (90 - light.elevation) / 180 * height
    rows, columns = np.indices((height, width)) + 0.5
    across = np.abs(columns - column)
    distance = np.hypot(rows - row, np.minimum(across, width - across))
    shown[np.abs(distance - 6) < 2] = 1.0
    shown[np.abs(distance - 6) < 0.8] = 0.0


BALLS_SIZE = (BALL_SIDE, 2 * BALL_SIDE + GAP)
PANORAMA_SIZE = (PANORAMA_HEIGHT, 2 * PANORAMA_HEIGHT)
