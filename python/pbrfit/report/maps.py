"""The maps of a result, their uncertainty, and ground truth where there is one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit.io.color import encode_srgb
from pbrfit.io.resampling import reduced_size
from pbrfit.model.materials import Materials
from pbrfit.report import figures, raster
from pbrfit.report.html import paragraph
from pbrfit.report.notation import percent, plain
from pbrfit.result import differences
from pbrfit.result.differences import Difference
from pbrfit.result.refinement import FROM_PICTURES
from pbrfit.result.result import Result
from pbrfit.result.verdict import LEVELS, PARAMETERS, levels
from pbrfit.values.arrays import Array, Floats

BALL_SIDE = 96

TICKS = 6
"""Labels of a scale, at most about."""

DEPTH_SHOWN = (1, 99)
"""Percentiles of depth at the ends of its scale: single pixels beyond do not darken all others."""

Draw = Callable[[int], bytes]
"""A picture as PNG with at most this longer side."""


@dataclass(frozen=True)
class Shown:
    """A picture of the section: what draws it, and its text."""

    draw: Draw
    title: str
    remark: str
    alt: str


@dataclass(frozen=True)
class Block:
    """Pictures under one heading, with sentences and a key as HTML."""

    title: str
    text: str
    key: str
    pictures: tuple[Shown, ...]


def blocks(result: Result, truth: Materials | None) -> list[Block]:
    """Everything that is shown, in its order; `truth` where the result was compared with it."""
    found = [_recovered(result)]
    if truth is not None:
        true = tuple(_maps(truth, "true", dict.fromkeys(PARAMETERS, "")))
        found += [Block("Ground truth", "", "", true), _errors(result, truth)]
    if result.uncertainty is not None:
        found.append(_deviations(result))
    if result.depth is not None and np.isfinite(result.depth).any():
        found.append(_depth(result.depth))
    if result.height is not None and np.isfinite(result.height).any():
        found.append(_height(result.height))
    return found


def section(blocks: list[Block], result: Result, side: int) -> str:
    """HTML of the blocks, with pictures of a longer side."""
    size = reduced_size(result.mask.shape, side)
    made = "".join(_block(block, side, size) for block in blocks)
    # The mask is a fifth column, and the other rows keep to the same columns.
    return made if result.mask.all() else f'<div class="masked">{made}</div>'


def _block(block: Block, side: int, size: tuple[int, int]) -> str:
    shown = (
        figures.figure(figures.picture(one.draw(side), size, one.alt), one.title, one.remark)
        for one in block.pictures
    )
    grid = figures.grid(shown, "maps") if block.pictures else ""
    return f"<h3>{block.title}</h3>{block.text}{block.key}{grid}"


def _recovered(result: Result) -> Block:
    which = "as given" if result.given_normals is None else "refined"
    if result.height is not None or result.refinement.why.startswith(FROM_PICTURES):
        which = FROM_PICTURES
    remarks = {name: f"median {_median(getattr(result, name))}" for name in PARAMETERS}
    remarks["albedo"] += ", linear"
    if result.uncertainty is not None:
        for name, one in result.uncertainty.verdicts.items():
            remarks[name] += f"; {one.level}, {one.error_in_words}"
    pictures = [
        *_maps(result.materials, "recovered", remarks),
        normals_shown(result.normals, "normals", f"{which}, in camera space"),
    ]
    outside = ""
    if not result.mask.all():
        mask = result.mask.astype(np.float64)
        remark = f"white = fitted, {100 * mask.mean():.3g} % of the pixels"
        shown = Shown(_grey(mask), "mask", remark, "Mask of the pixels that were fitted")
        pictures.append(shown)
        outside = '<span class="mark"><span class="patch outside"></span> outside the mask</span>'
    ball = raster.picture_png(0.5 + 0.5 * ball_normals(BALL_SIDE))
    shown_ball = figures.picture(ball, (BALL_SIDE, BALL_SIDE), "Key to the normals: a ball")
    key = (
        f'<div class="keys">{figures.grey_key("roughness and metallic")}'
        f'<div class="key ball">{shown_ball}<span>normals on a ball: '
        f"red to the right, green up, blue towards the viewer</span></div>{outside}</div>"
    )
    text = paragraph(
        "Albedo is base colour, drawn through the sRGB curve; roughness is perceptual "
        "(α = roughness²); metallic is 0 for dielectrics and 1 for metals. "
        "materials.exr holds all of them as linear numbers."
    )
    return Block("Recovered", text, key, tuple(pictures))


def _errors(result: Result, truth: Materials) -> Block:
    of_maps = differences.errors(result.materials, truth)
    remarks = {name: f"RMSE {plain(result.metrics[f'{name}_rmse'])}" for name in PARAMETERS}
    return Block(
        "Error",
        paragraph("Difference from ground truth; for albedo the root mean square over channels."),
        figures.difference_key("absolute error", {}),
        tuple(_differences(of_maps, "Absolute error of", remarks)),
    )


def _deviations(result: Result) -> Block:
    uncertainty = result.uncertainty
    assert uncertainty is not None
    medians = uncertainty.summary()["median_deviation"]
    of_pixels = levels(uncertainty.deviation)
    remarks = {}
    for name in PARAMETERS:
        shares = [np.mean(of_pixels[name][result.mask] == i) for i in range(len(LEVELS))]
        parts = (
            f"{level} {percent(float(share))}" for level, share in zip(LEVELS, shares, strict=True)
        )
        remarks[name] = f"median {plain(medians[name])}; {', '.join(parts)}"
    text = (
        "Standard deviation of each value: from noise, from how far the pictures are from the "
        "model, from the lights and the scale between them and albedo, and from the priors on "
        "materials. Shares are of the pixels whose own deviation is within the limits of a "
        "verdict. materials.exr also has the intervals that hold 95 % of the values."
    )
    of_maps = differences.deviations(uncertainty)
    return Block(
        "Uncertainty",
        paragraph(text),
        figures.difference_key("standard deviation", differences.deviation_marks(of_maps.values())),
        tuple(_differences(of_maps, "Standard deviation of", remarks)),
    )


def _depth(depth: NDArray[np.float32]) -> Block:
    """Distances along the camera's axis, from blue (near) to yellow (far)."""
    low, middle, high = _ends(depth)
    unknown = "" if np.isfinite(depth).all() else "; transparent where unknown"
    draw = _between(depth, low, high)
    shown = Shown(draw, "depth", f"median {middle:.3g}{unknown}", "Map of the depth")
    text = paragraph(
        "Distance from the camera along its axis, as the scene gave it, in its own unit. The "
        f"scale ends where {DEPTH_SHOWN[0]} % of the pixels are nearer, and as many farther."
    )
    return Block(
        "Depth", text, figures.range_key("depth", {0.0: f"{low:.3g}", 1.0: f"{high:.3g}"}), (shown,)
    )


def _height(height: Floats) -> Block:
    """Heights towards the viewer, from blue (low) to yellow (high)."""
    low, _, high = _ends(height)
    across = height.shape[1]
    remark = f"{plain(high - low)} pixels from the lowest to the highest, {across} across"
    shown = Shown(_between(height, low, high), "height", remark, "Map of the height")
    text = paragraph(
        "Height of the surface towards the viewer, in pixels of the fit and above its mean: found "
        "from the normals, which are from the pictures. Slopes add up, so small relief is surer "
        "than the shape of the whole. The scale ends where "
        f"{DEPTH_SHOWN[0]} % of the pixels are lower, and as many higher."
    )
    return Block("Height", text, figures.range_key("height in pixels", _ticks(low, high)), (shown,))


def _ticks(low: float, high: float) -> dict[float, str]:
    """Round numbers on a scale, by their share of it."""
    if not high > low:
        return {0.0: f"{low:.3g}".replace("-", "−")}
    from matplotlib.ticker import MaxNLocator

    numbers = MaxNLocator(TICKS, steps=[1, 2, 5, 10]).tick_values(low, high)
    inside = [one for one in map(float, numbers) if low <= one <= high]
    return {(one - low) / (high - low): f"{one:.6g}".replace("-", "−") for one in inside}


def _ends(values: Floats) -> tuple[float, float, float]:
    """Where a scale begins, the median, and where it ends."""
    low, middle, high = np.nanpercentile(values, [DEPTH_SHOWN[0], 50, DEPTH_SHOWN[1]]).tolist()
    return low, middle, high


def _between(values: Floats, low: float, high: float) -> Draw:
    """A map in colours from blue (low) to yellow (high)."""
    span = max(high - low, 1e-6 * abs(high)) or 1.0

    def draw(side: int) -> bytes:
        shares = (raster.reduced(values, side) - low) / span
        colors = differences.blue_to_yellow(np.nan_to_num(shares))
        return raster.picture_png(np.where(np.isnan(shares)[..., None], np.nan, colors))

    return draw


def _maps(materials: Materials, which: str, remarks: Mapping[str, str]) -> Iterator[Shown]:
    albedo = materials.albedo
    yield Shown(
        lambda side: raster.picture_png(encode_srgb(np.clip(raster.reduced(albedo, side), 0, 1))),
        "albedo",
        remarks["albedo"],
        f"Map of the {which} albedo",
    )
    for name in PARAMETERS[1:]:
        drawn = _grey(getattr(materials, name))
        yield Shown(drawn, name, remarks[name], f"Map of the {which} {name}")


def normals_shown(normals: Array, title: str, remark: str) -> Shown:
    """Normals (H, W, 3) as colours."""
    alt = "Normals as colours" if title == "normals" else f"Normals as colours, {title}"
    return Shown(
        lambda side: raster.picture_png(0.5 + 0.5 * raster.reduced(normals, side)),
        *(title, remark, alt),
    )


def _grey(values: Array) -> Draw:
    return lambda side: raster.picture_png(raster.reduced(values, side))


def _differences(
    of_maps: Mapping[str, Difference], what: str, remarks: Mapping[str, str]
) -> Iterator[Shown]:
    for name in PARAMETERS:
        yield Shown(difference_shown(of_maps[name]), name, remarks[name], f"{what} {name}")


def difference_shown(difference: Difference) -> Draw:
    """A map of differences in its colours."""
    return lambda side: raster.difference_png(raster.reduced_difference(difference, side))


def ball_normals(side: int) -> Array:
    """(side, side, 3) normals of a ball seen from afar; NaN beside it."""
    along = (2 * np.arange(side) + 1 - side) / side
    x, y = np.meshgrid(along, -along)
    square = 1 - x * x - y * y
    z = np.sqrt(np.where(square > 0, square, np.nan))
    return np.where(np.isnan(z)[..., None], np.nan, np.stack([x, y, z], axis=-1))


def _median(values: Array) -> str:
    inside = values[np.isfinite(values)].reshape(-1, *values.shape[2:])
    return ", ".join(f"{v:.2f}" for v in np.atleast_1d(np.median(inside, axis=0)))
