"""What surroundings were supposed, and what they do to light."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit.display.tone import encoded
from pbrfit.io.resampling import reduced_size
from pbrfit.report import figures, raster
from pbrfit.report.html import paragraph
from pbrfit.report.surroundings import plan_view
from pbrfit.result import metrics
from pbrfit.result.relighting import DirectionalLight, LampLight, relight
from pbrfit.result.result import Result
from pbrfit.transport.scenery import Scenery

SIDE = 384
"""Longer side of the relit pictures."""

LAMPS = tuple(DirectionalLight(azimuth, up) for up in (35, 50, 65) for azimuth in (-45, -20, 30))
"""Lamps that may show shadows, from the upper left first."""

LEAST_OPEN = 0.35
"""Share of the pixels that a lamp should reach; else the one that reaches most is taken."""

NO_LIGHT = 0.02
"""Share of the pixels below which no lamp is shown: walls keep all of them out."""


def section(result: Result) -> str:
    """HTML about surroundings; nothing where the fit knew none."""
    transport, scenery = result.transport, result.scenery
    if scenery is None:
        if not transport.figures:
            return ""
        nothing = "Surroundings do nothing: all light reaches every surface."
        return paragraph(f"{nothing} The fit left them out: {transport.why}.")
    text = paragraph(
        f"Things, walls and floor that the depth shows {scenery.in_words(transport)}. "
        "What no picture shows is supposed: how deep things are, how high walls, where the room "
        "ends behind the camera."
    )
    if transport.kind == "bounce":
        text += paragraph(
            "The fit took what surfaces reflect from the pictures themselves; reconstructions and "
            "relit pictures compute it from the maps."
        )
    plans = figures.plot(plan_view(scenery), "Surroundings from above and from the side")
    return text + plans + _relit(result, scenery)


def _relit(result: Result, scenery: Scenery) -> str:
    """The same light with and without surroundings."""
    first = f"light of {result.pictures[0]}"
    cards = _pair(result, result.lights[0], first)
    lamp = _lamp(scenery)
    if lamp is not None:
        cards += _pair(result, lamp, "a hard lamp")
    text = "Each pair has the same light and the same exposure."
    if lamp is not None:
        text += (
            f" The lamp is far away, at azimuth {lamp.azimuth:g}° and elevation "
            f"{lamp.elevation:g}°; what surfaces reflect of it is left out."
        ).replace("-", "−")
    heading = "<h3>With and without surroundings</h3>"
    return heading + paragraph(text, "note") + figures.grid(cards, "relit maps")


def _pair(
    result: Result, light: NDArray[np.float64] | DirectionalLight | LampLight, name: str
) -> list[str]:
    among, without = (relight(result, light, shadows=one) for one in (True, False))
    white = metrics.white_of(without)
    size = reduced_size(result.mask.shape, SIDE)
    found = []
    for picture, how in ((among, "with surroundings"), (without, "without")):
        png = raster.picture_png(encoded(raster.reduced(picture, SIDE) / white))
        shown = figures.picture(png, size, f"Relit by {name}, {how}")
        found.append(figures.figure(shown, how, name))
    return found


def _lamp(scenery: Scenery) -> DirectionalLight | None:
    """A lamp that reaches some surfaces and not all."""
    shares = [float(scenery.open_to(lamp.direction).mean()) for lamp in LAMPS]
    good = [i for i, share in enumerate(shares) if share >= LEAST_OPEN]
    best = good[0] if good else int(np.argmax(shares))
    return LAMPS[best] if shares[best] >= NO_LIGHT else None
