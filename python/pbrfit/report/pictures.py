"""The pictures of a scene beside their reconstructions, and the residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pbrfit.display.tone import encoded
from pbrfit.report import lights, raster
from pbrfit.report.html import Cell, Table, heads, number
from pbrfit.report.lights import Light
from pbrfit.report.notation import percent, plain
from pbrfit.result import differences, metrics
from pbrfit.result.differences import Difference
from pbrfit.result.relighting import relight
from pbrfit.result.result import Result
from pbrfit.scene.scene import Scene
from pbrfit.threads import in_pieces
from pbrfit.values.arrays import Array

HIGH = 95
"""Percentile of the residuals that is shown beside their root mean square."""


@dataclass(frozen=True)
class Fit:
    """How well a picture is explained."""

    rms: float
    rmse: float
    """Root mean square of the picture and of (rendered − picture), in the picture's unit, with the
    weights of the samples."""
    high: float
    """Percentile `HIGH` of the residuals, relative to `rms`."""
    left_out: float
    """Share of its samples that took no part in the fit."""

    @property
    def share(self) -> float:
        """RMSE as a share of the picture's RMS."""
        return self.rmse / self.rms if self.rms > 0 else 0.0


@dataclass(frozen=True)
class Picture:
    """A picture as the page shows it."""

    name: str
    light: Light
    light_pngs: tuple[bytes, bytes] | None
    """Its light, without lamps: in numbers; on balls, as a panorama, None where there are lamps."""
    white: float
    """What is shown as white."""
    radiance: tuple[Array, ...]
    """The picture, unless it is not there, and its reconstruction; of the largest side shown."""
    fit: Fit | None = None
    residual: Difference | None = None
    """None without the scene."""

    def files(self, side: int) -> list[bytes]:
        """At a longer side: picture, reconstruction and residual, or only the second."""
        found = [
            raster.photograph(encoded(raster.reduced(one, side) / self.white))
            for one in self.radiance
        ]
        if self.residual is not None:
            smaller = raster.reduced_difference(self.residual, side)
            found.append(raster.difference_png(smaller))
        return found


def examine(result: Result, scene: Scene | None, side: int) -> list[Picture]:
    """Render and measure all pictures; what is shown has a longer side of `side` at most."""

    def one(i: int) -> Picture:
        coefficients = result.lighting[i]
        light, balls = lights.measure(coefficients), None
        if result.lamps is None:
            drawn = lights.balls_and_panorama(coefficients, light, result.model)
            balls = raster.picture_png(drawn[0]), raster.picture_png(drawn[1])
        rendered = relight(result, picture=i)
        small, about = raster.reduced(rendered, side), (result.pictures[i], light, balls)
        if scene is None:
            return Picture(*about, metrics.white_of(rendered), (small,))
        image, weights = scene.images[i], scene.channel_weights(i)
        counted = result.mask if weights is None else result.mask & (weights > 0).any(axis=-1)
        residual, rms, rmse = differences.residual(rendered, image, weights)
        fit = Fit(
            rms,
            rmse,
            high=float(np.percentile(residual.values[counted], HIGH)),
            left_out=1 - np.count_nonzero(counted) / np.count_nonzero(result.mask),
        )
        image, white = metrics.showable(image, result.mask, weights)
        shown = raster.reduced(image, side), small
        residual = raster.reduced_difference(residual, side)
        return Picture(*about, white, shown, fit, residual)

    return in_pieces(0, one, range(len(result.pictures)))


def table(pictures: Sequence[Picture]) -> Table:
    """Residuals by picture, in the scene's order; they all have a `fit`."""
    left_out = any(one.fit is not None and one.fit.left_out > 0 for one in pictures)
    names = ["RMS", "RMSE", "relative to RMS", f"{HIGH} % of pixels below"]
    names += ["samples left out"] * left_out
    rows = []
    for one in pictures:
        fit = one.fit
        assert fit is not None
        shares = [fit.share, fit.high, *([fit.left_out] if left_out else [])]
        rows.append(
            [
                Cell(one.name),
                *(number(plain(value), value) for value in (fit.rms, fit.rmse)),
                *(number(percent(value), value) for value in shares),
            ]
        )
    return Table(heads("picture", *names), rows)


def worst(pictures: Sequence[Picture], count: int = 3) -> list[Picture]:
    """Those with the largest residuals relative to their RMS."""
    with_fit = [one for one in pictures if one.fit is not None]
    return sorted(with_fit, key=lambda one: -one.fit.share if one.fit else 0.0)[:count]


def median_share(pictures: Sequence[Picture]) -> float | None:
    """Median of the residuals relative to the pictures' RMS; None without pictures."""
    shares = [one.fit.share for one in pictures if one.fit is not None]
    return float(np.median(shares)) if shares else None
