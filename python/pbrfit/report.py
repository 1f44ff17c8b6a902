"""Pictures for people: the preview of a result and plots of its history."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from pbrfit import metrics
from pbrfit.colormap import blue_to_yellow
from pbrfit.materials import Materials
from pbrfit.model import render

if TYPE_CHECKING:
    from pbrfit.result import Result
    from pbrfit.scene import Scene
    from pbrfit.uncertainty import Uncertainty

PANEL_SIDE = (192, 384)
"""Smallest and largest longer side of a panel in pixels."""

MARGIN = 12
CAPTION = 24
PAPER = (255, 255, 255)
INK = (30, 30, 30)
OUTSIDE = 0.85
"""Grey of pixels outside the mask."""

ERROR_SPAN = 0.2
"""Difference from the truth that is drawn white in the error panels."""

DEVIATIONS = (0.001, 0.3)
"""Standard deviations at the ends of their logarithmic scale."""

DEVIATION_TICKS = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3)
HELD = (1.0, 1.0, 1.0)
UNDETERMINED = (0.84, 0.37, 0.0)
"""Vermillion, told apart from the scale and from grey by all common colour vision."""

BAR = 20
"""Width of a bar of colours, in pixels."""


@dataclass(frozen=True)
class Panel:
    """One labelled picture: (H, W, 3) values in [0, 1] as they go to the screen."""

    caption: str
    pixels: NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Key:
    """What colours mean: a bar from the bottom up, ticks at shares of its height, and patches.

    Attributes
    ----------
    caption
        What the bar measures.
    bar
        (M, 3) colours, the lowest value first, as they go to the screen.
    ticks
        Labels by share of the bar's height.
    patches
        Colours by label, for what is not on the bar.
    """

    caption: str
    bar: NDArray[np.floating[Any]]
    ticks: Mapping[float, str]
    patches: Mapping[str, tuple[float, float, float]]


Row = list[Panel | Key | None]
"""Side by side; None leaves a gap."""


def preview(result: Result, scene: Scene | None = None) -> NDArray[np.uint8]:
    """Sheet of a result: (H, W, 3) uint8 sRGB.

    The first row shows a picture (with `scene`), its reconstruction, and the maps; where the result
    has an uncertainty, a row shows the marginal deviations; with ground truth a row shows the truth
    and one the absolute errors.
    """
    light = result.lighting[0]
    reconstruction = render(result.materials, result.normals, light, result.fov)
    white = metrics.white_of(reconstruction)
    name = result.pictures[0]
    row: Row = [Panel(f"reconstruction of {name}", displayed(reconstruction, white))]
    if scene is not None:
        row.insert(0, Panel(f"picture {name}", displayed(scene.images[0], white)))
    row += _maps(result.materials, "")
    row.append(Panel("normals", outside_grey(0.5 + 0.5 * result.normals)))
    rows = [row]
    gap: Row = [None] * (1 if scene is None else 2)
    if result.uncertainty is not None:
        rows.append([*gap, *_deviations(result.uncertainty)])
    if scene is not None and scene.truth is not None:
        true = scene.truth.materials
        rows.append([*gap, *_maps(true, "true ")])
        rows.append([*gap, *_errors(result.materials, true)])
    return sheet(rows)


def normals_preview(scene: Scene) -> NDArray[np.uint8]:
    """Sheet for checking normals: first picture, normals, and n·v; (H, W, 3) uint8 sRGB."""
    cosine = np.einsum("...i,...i->...", scene.normals, scene.views)
    facing = np.repeat(outside_grey(cosine)[..., :1], 3, axis=-1)
    facing[cosine <= 0] = (0.84, 0.37, 0.0)  # vermillion, told apart by all common colour vision
    image = np.where(scene.valid[..., None], scene.images[0], np.nan)
    return sheet(
        [
            [
                Panel(f"picture {scene.names[0]}", displayed(image, metrics.white_of(image))),
                Panel("normals: R right, G up", outside_grey(0.5 + 0.5 * scene.normals)),
                Panel("n·v, orange faces away", facing),
            ]
        ]
    )


def sheet(rows: list[Row]) -> NDArray[np.uint8]:
    """Panels in a grid, captions above: (H, W, 3) uint8."""
    first = next(panel for row in rows for panel in row if isinstance(panel, Panel))
    height, width = first.pixels.shape[:2]
    longer = max(height, width)
    low, high = PANEL_SIDE
    factor = -(-low // longer) if longer < low else min(1.0, high / longer)
    size = (max(1, round(width * factor)), max(1, round(height * factor)))
    step = (max(size[0], low) + MARGIN, size[1] + CAPTION + MARGIN)
    columns = max(len(row) for row in rows)
    canvas = Image.new(
        "RGB", (columns * step[0] + MARGIN, len(rows) * step[1] + MARGIN), color=PAPER
    )
    draw = ImageDraw.Draw(canvas)
    captions = [panel.caption for row in rows for panel in row if panel is not None]
    font = _font(captions, step[0] - MARGIN)
    for i, row in enumerate(rows):
        for j, panel in enumerate(row):
            if panel is None:
                continue
            x, y = MARGIN + j * step[0], MARGIN + i * step[1]
            draw.text((x, y), panel.caption, fill=INK, font=font)
            if isinstance(panel, Key):
                _draw_key(draw, panel, (x, y + CAPTION), size[1], font)
                continue
            pixels = (255 * np.clip(panel.pixels, 0, 1) + 0.5).astype(np.uint8)
            # Whole factors repeat pixels; smaller ones average them.
            scaling = Image.Resampling.NEAREST if factor >= 1 else Image.Resampling.BOX
            canvas.paste(Image.fromarray(pixels).resize(size, scaling), (x, y + CAPTION))
    return np.asarray(canvas)


def as_png(pixels: NDArray[np.uint8]) -> bytes:
    """Encode a sheet."""
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def plot_history(result: Result, path: Path) -> None:
    """Errors against run time and iterations, logarithmic, as PNG."""
    # Imported here: matplotlib is slow to start and needed by nobody else.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    # Okabe and Ito's colours, with marker shapes for those who see none.
    series = {
        "recon_rmse": ("reconstruction", "#000000", "o"),
        "albedo_rmse": ("albedo", "#D55E00", "s"),
        "roughness_rmse": ("roughness", "#0072B2", "^"),
        "metallic_rmse": ("metallic", "#009E73", "D"),
    }
    figure = Figure(figsize=(8, 4.5), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, sharey=True)
    history = result.history
    for axes, column, label in (
        (left, "elapsed_s", "run time [s]"),
        (right, "iteration", "iteration"),
    ):
        for name, (legend, color, marker) in series.items():
            if name in history.columns:
                axes.loglog(
                    np.maximum(history[column], 1e-3 if column == "elapsed_s" else 0.5),
                    history[name],
                    color=color,
                    marker=marker,
                    markevery=0.1,
                    markersize=4,
                    label=legend,
                )
        axes.set_xlabel(label)
        axes.grid(visible=True, which="major", alpha=0.3)
    left.set_ylabel("RMSE")
    left.legend()
    figure.suptitle(f"Error against run time: {len(result.pictures)} pictures, {_size(result)}")
    figure.savefig(path, dpi=120)


def _size(result: Result) -> str:
    height, width = result.mask.shape
    return f"{width} × {height} pixels, {result.options.solver}"


def _maps(materials: Materials, prefix: str) -> Row:
    return [
        Panel(f"{prefix}albedo", displayed(materials.albedo)),
        Panel(f"{prefix}roughness, white = 1", outside_grey(materials.roughness)),
        Panel(f"{prefix}metallic, white = 1", outside_grey(materials.metallic)),
    ]


def _errors(found: Materials, true: Materials) -> Row:
    return [
        Panel(
            f"{name} |error|, white = {ERROR_SPAN:g}",
            outside_grey(np.abs(getattr(found, name) - getattr(true, name)) / ERROR_SPAN),
        )
        for name in ("albedo", "roughness", "metallic")
    ]


def _deviations(uncertainty: Uncertainty) -> Row:
    """Marginal standard deviations, and the key to their colours."""
    deviations = uncertainty.marginal
    maps = {
        "albedo": np.sqrt(np.mean(np.square(deviations.albedo), axis=-1)),
        "roughness": deviations.roughness,
        "metallic": deviations.metallic,
    }
    low, high = np.log(DEVIATIONS)
    row: Row = []
    for i, (name, values) in enumerate(maps.items()):
        on_scale = (np.log(np.maximum(values, DEVIATIONS[0])) - low) / (high - low)
        colors = blue_to_yellow(on_scale)
        colors[values == 0] = HELD
        colors[uncertainty.undetermined[..., i]] = UNDETERMINED
        colors[np.isnan(values)] = OUTSIDE
        row.append(Panel(f"{name}, std. deviation", colors))
    row.append(
        Key(
            "from the data alone" if uncertainty.priors else "with uncertain lights",
            blue_to_yellow(np.linspace(0, 1, 256)),
            {(math.log(t) - low) / (high - low): f"{t:g}" for t in DEVIATION_TICKS},
            {"at a bound or known": HELD, "not determined": UNDETERMINED},
        )
    )
    return row


def _draw_key(
    draw: ImageDraw.ImageDraw,
    key: Key,
    corner: tuple[int, int],
    height: int,
    font: ImageFont.FreeTypeFont | ImageFont.ImageFont,
) -> None:
    """Bar, ticks and patches, from the corner at the upper left down over `height`."""
    left, top = corner[0], corner[1] + CAPTION // 3  # half a tick's label stands above the bar
    patch_top = corner[1] + height - len(key.patches) * CAPTION
    bar_height = patch_top - CAPTION - top
    for i in range(bar_height):
        color = key.bar[round((1 - i / max(1, bar_height - 1)) * (len(key.bar) - 1))]
        draw.line([(left, top + i), (left + BAR - 1, top + i)], fill=_ink(color))
    for share, label in key.ticks.items():
        y = top + round((1 - share) * (bar_height - 1))
        draw.line([(left + BAR, y), (left + BAR + 4, y)], fill=INK)
        draw.text((left + BAR + 8, y), label, fill=INK, font=font, anchor="lm")
    for i, (label, patch) in enumerate(key.patches.items()):
        y = patch_top + i * CAPTION
        box = (left, y, left + BAR - 1, y + BAR - 1)
        draw.rectangle(box, fill=_ink(patch), outline=INK)
        draw.text((left + BAR + 8, y + BAR // 2), label, fill=INK, font=font, anchor="lm")


def _ink(color: NDArray[np.floating[Any]] | tuple[float, float, float]) -> tuple[int, int, int]:
    red, green, blue = (int(255 * float(part) + 0.5) for part in color)
    return red, green, blue


def displayed(linear: NDArray[np.floating[Any]], white: float = 1.0) -> NDArray[np.floating[Any]]:
    """Linear radiance (H, W, 3) as it goes to the screen; NaN becomes grey."""
    return outside_grey(metrics.display(linear, white))


def outside_grey(values: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    """Values (H, W) or (H, W, 3) as (H, W, 3), grey where they are NaN."""
    if values.ndim == 2:
        values = np.repeat(values[..., None], 3, axis=-1)
    return np.where(np.isfinite(values), values, OUTSIDE)


def _font(captions: list[str], width: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Find the largest built-in font, from 15 points down, in which all captions fit."""
    for size in range(15, 8, -1):
        font = ImageFont.load_default(size)
        if all(font.getlength(caption) <= width for caption in captions):
            return font
    return ImageFont.load_default(8)
