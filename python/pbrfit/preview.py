"""Pictures for people: the preview of a result and plots of its history."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pbrfit import metrics
from pbrfit.colormap import blue_to_yellow
from pbrfit.materials import Materials
from pbrfit.model import render
from pbrfit.sheet import OUTSIDE, Key, Panel, Row, displayed, outside_grey, sheet

if TYPE_CHECKING:
    from pbrfit.result import Result
    from pbrfit.scene import Scene
    from pbrfit.uncertainty import Uncertainty

ERROR_SPAN = 0.2
"""Difference from the truth that is drawn white in the error panels."""

DEVIATIONS = (0.001, 0.3)
"""Standard deviations at the ends of their logarithmic scale."""

DEVIATION_TICKS = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3)
HELD = (1.0, 1.0, 1.0)
UNDETERMINED = (0.84, 0.37, 0.0)
"""Vermillion, told apart from the scale and from grey by all common colour vision."""


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
