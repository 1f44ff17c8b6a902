"""The lights that the view offers: those of the pictures, and a lamp to be moved by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from pbrfit.model.reflection import render, render_directional
from pbrfit.report.lights import LUMINANCE
from pbrfit.report.viewer.maps import Maps, of_result
from pbrfit.result import metrics
from pbrfit.result.relighting import DirectionalLight
from pbrfit.result.result import Result
from pbrfit.values.arrays import Array

LAMP = DirectionalLight(-35.0, 35.0)
"""Where the lamp is at first: beside the viewer, from the upper left."""

AMBIENT = 0.12
"""Mean radiance of the light around the lamp at first, where the lamp gives a white surface 1."""

METERED_SIDE = 128
"""Longer side, in pixels, of the maps that exposures are found with."""

MOST_LAMPS = 8
"""Lamps of one picture that the shader takes; of more, what spherical harmonics hold is shown."""


def around(result: Result) -> Array:
    """(16, 3): the mean of the pictures' lights, each of mean radiance 1 as luminance."""
    found = result.sh_lighting()
    means = found[:, 0] @ LUMINANCE / (2 * math.sqrt(math.pi))
    used = means > 0
    if not used.any():
        light = np.zeros((16, 3))
        light[0] = 2 * math.sqrt(math.pi)
        return light
    return np.asarray(np.mean(found[used] / means[used, None, None], axis=0))


class Lighting:
    """The lights of a result, by the maps that the view gets, made small."""

    def __init__(self, result: Result) -> None:
        self.result = result
        self.small = of_result(result, METERED_SIDE)
        self.sh, self.lamps = _split(result)
        self.around = around(result)

    def picture(self, i: int) -> Array:
        """The small maps under the light of picture i, linear radiance."""
        return _radiance(self.small, self.result, self.sh[i], self.lamps[i])

    def under_lamp(self, maps: Maps) -> Array:
        """Maps under the lamp as it is at first."""
        lamps = (LAMP.direction[None], np.ones((1, 3)))
        return _radiance(maps, self.result, AMBIENT * self.around, lamps)

    def data(self, exposures: list[float], lamp_exposure: float) -> dict[str, Any]:
        """What the page holds, as JSON."""
        return {
            "lamp": {
                "azimuth": LAMP.azimuth,
                "elevation": LAMP.elevation,
                "ambient": AMBIENT,
                "exposure": lamp_exposure,
                "around": self.around.ravel().tolist(),
            },
            "lights": [
                {
                    "name": name,
                    "exposure": exposure,
                    "sh": sh.ravel().tolist() if sh.any() or not len(lamps[0]) else None,
                    "lamps": [
                        {"direction": direction.tolist(), "color": color.tolist()}
                        for direction, color in zip(*lamps, strict=True)
                    ],
                }
                for name, exposure, sh, lamps in zip(
                    self.result.pictures, exposures, self.sh, self.lamps, strict=True
                )
            ],
        }


def exposure_of(radiance: Array) -> float:
    """Stops that bring the 98th percentile to white, to a tenth."""
    return metrics.stops(metrics.white_of(radiance)) if np.isfinite(radiance).any() else 0.0


def _split(result: Result) -> tuple[Array, list[tuple[Array, Array]]]:
    """SH light and lamps (directions, colours) of each picture."""
    directions, colors = result.lamps_seen()
    pictures = np.zeros(0, int) if result.lamps is None else result.lamps.pictures
    lamps, sh = [], np.array(result.lighting)
    for i, blurred in enumerate(result.sh_lighting()):
        of = pictures == i
        if of.sum() > MOST_LAMPS:
            sh[i], of = blurred, np.zeros_like(of)
        lamps.append((directions[of], colors[of]))
    return sh, lamps


def _radiance(maps: Maps, result: Result, sh: Array, lamps: tuple[Array, Array]) -> Array:
    given = (maps.materials, maps.normals)
    found = render(*given, sh, result.fov, model=result.model)
    if len(lamps[0]):
        found += render_directional(*given, *lamps, result.fov, model=result.model).sum(axis=0)
    return found
