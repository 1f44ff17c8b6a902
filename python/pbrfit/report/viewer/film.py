"""The pictures along the bottom of the view: small files of the inputs, or of how they were lit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pbrfit.display.tone import encoded
from pbrfit.report import budget
from pbrfit.report.html import address
from pbrfit.report.raster import photograph, picture_png, reduced
from pbrfit.report.viewer.lights import Lighting, exposure_of
from pbrfit.result.metrics import stops
from pbrfit.scene.scene import Scene
from pbrfit.threads import in_pieces

SIDES = (1024, 768, 512, 384, 256, 128, 96, 64, 48)
"""Longer sides that inputs may have, in pixels."""

THUMB_SIDE = 96
"""Longer side of a reconstruction, which stands for a picture that is not there."""


@dataclass(frozen=True)
class Tile:
    """A picture that can be chosen."""

    address: str
    """The picture itself, for `src`."""
    exposure: float
    """Stops that it is shown with."""
    original: bool
    """Whether it is the input, to be compared with."""


def of_scene(scene: Scene, whites: Sequence[float], limit: float) -> list[Tile]:
    """The inputs, each with its white, as large as fits into `limit` bytes."""

    def tile(i: int, side: int) -> Tile:
        exposure = stops(whites[i])
        finite = np.nan_to_num(scene.images[i], nan=0.0, posinf=0.0, neginf=0.0)
        shown = encoded(reduced(finite, side), exposure, "neutral")
        # A JPEG, whose colours have all their pixels: it is compared with what is rendered.
        made = photograph(shown, "JPEG", subsampling=0)
        return Tile(address(made), exposure, original=True)

    # One picture out of the middle tells how large all will be.
    count = len(scene.images)
    _, (side, _) = budget.largest_that_fits(
        lambda choice: tile(count // 2, choice[0]).address,
        [one for one in budget.choices(max(scene.valid.shape), SIDES) if one[1]],
        limit / count,
    )
    return in_pieces(0, lambda i: tile(i, side), range(count))


def of_lights(lighting: Lighting) -> list[Tile]:
    """How the maps look under each light, where the inputs are not there."""
    tiles = []
    for i in range(len(lighting.result.pictures)):
        radiance = lighting.picture(i)
        exposure = exposure_of(radiance)
        shown = encoded(reduced(radiance, THUMB_SIDE), exposure, "neutral")
        tiles.append(Tile(address(picture_png(shown)), exposure, original=False))
    return tiles
