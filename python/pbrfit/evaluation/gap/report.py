"""The gap as files: page, heat maps, CSV, summary."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from pbrfit.evaluation import page, summary
from pbrfit.evaluation.gap import BANDS, Gap, plots
from pbrfit.evaluation.page import Cell, Figure, Section, Table
from pbrfit.evaluation.tables import write_csv
from pbrfit.notation import scientific

CONTAINS = (summary.FILE, page.FILE, "gap.csv")
"""Files by which an output folder is known for one of this suite."""

PROTOCOL = (
    "pbrfit-gap-1: SH responses of the full BRDF (paper eqs. 1, 3-5) by quadrature; spheres seen "
    "from far away under random lights turned in every way"
)

COLUMNS = ("model", "material", "r", "n_dot_v", "band", "true", "found", "ratio", "distance")
SPHERE_COLUMNS = ("model", "material", "r", "rms_radiance", "rmse", "relative_rmse")


def write(folder: Path, gap: Gap) -> None:
    """Write `report.html`, its plots, `gap.csv`, `spheres.csv`, `summary.json`."""
    page.write_page(folder, "The gap of the reflection model", _opening(gap), list(_sections(gap)))
    write_csv(folder / "gap.csv", COLUMNS, _responses(gap))
    write_csv(folder / "spheres.csv", SPHERE_COLUMNS, _spheres(gap))
    summary.write_summary(folder, f"{PROTOCOL}; {gap.effort.name}", list(_rows(gap)))


def _rows(gap: Gap) -> Iterator[summary.Row]:
    for model in gap.models:
        overall = gap.overall_rmse(model)
        ratio, distance = gap.ratio(model), gap.distance(model)
        for m, material in enumerate(gap.materials):
            metrics: dict[str, float | None] = {"relative_rmse": float(overall[m])}
            for band in range(BANDS):
                metrics[f"least_ratio_{band}"] = float(ratio[m, ..., band].min())
                metrics[f"largest_ratio_{band}"] = float(ratio[m, ..., band].max())
                metrics[f"largest_distance_{band}"] = float(distance[m, ..., band].max())
            metrics["quadrature_error"] = gap.quadrature_error
            yield summary.Row(f"{model}, {material.key}", 0, None, metrics)


def _responses(gap: Gap) -> Iterator[tuple[object, ...]]:
    true = gap.true_response
    for model in gap.models:
        found, distance = gap.model_response(model), gap.distance(model)
        for index in np.ndindex(*true.shape):
            m, i, j, band = index
            yield (
                model,
                gap.materials[m].key,
                gap.effort.r[i],
                gap.effort.n_dot_v[j],
                band,
                float(true[index]),
                float(found[index]),
                float(found[index] / true[index]),
                float(distance[index]),
            )


def _spheres(gap: Gap) -> Iterator[tuple[object, ...]]:
    for model in gap.models:
        relative = gap.relative_rmse(model)
        for m, i in np.ndindex(*gap.sphere_signal.shape):
            yield (
                model,
                gap.materials[m].key,
                gap.effort.r[i],
                float(gap.sphere_signal[m, i]),
                float(gap.sphere_error[model][m, i]),
                float(relative[m, i]),
            )


def _opening(gap: Gap) -> list[str]:
    return [
        f"What the model says, against the integral that it stands for, for {len(gap.effort.r)} "
        f"values of roughness r and {len(gap.effort.n_dot_v)} of n·v (1 = seen straight on, 0 = "
        "grazing). There is no fit, no picture and no noise in this: it is the error of the model "
        "alone, which pictures of real surfaces add to all other errors.",
        "The true response is the paper's own BRDF (eqs. 3-5) integrated by brute force (eq. 1). "
        f"When the number of nodes is doubled no integral changes by more than "
        f"{scientific(gap.quadrature_error)}. That BRDF is no law of nature either: with its "
        "masking term some rough surfaces reflect more than all light at grazing angles "
        f"(largest directional albedo here: {gap.true_response[..., 0].max():.2f}).",
        "A response is the size of what comes back of light in one SH band l; it is 1 for a "
        "perfect mirror, and for l = 0 it is the directional albedo. `gap.csv` has all of them.",
    ]


def _sections(gap: Gap) -> Iterator[Section]:
    for number, model in enumerate(gap.models):
        prefix = f"{model}: " if len(gap.models) > 1 else ""
        mark = f"-{number}" if number else ""
        yield Section(
            f"{prefix}spheres under random lights",
            [
                "Root mean square error of radiance over the pixels of a sphere, relative to its "
                "root mean square radiance: means over random lights turned in every way. The "
                "last column is of all roughnesses together.",
            ],
            [_sphere_table(gap, model)],
            [_sphere_figure(gap)] if number == 0 else (),
        )
        yield Section(
            f"{prefix}directional albedo",
            [
                "Light that comes back under light of one radiance from all around (l = 0), by "
                "the model over the true one. Dielectrics are whole materials: lobe and diffuse "
                "term together, which in part make up for each other.",
            ],
            [_albedo_table(gap, model)],
            [
                Figure(
                    f"albedo{mark}",
                    plots.draw_albedos(gap, model),
                    "Directional albedo, model over true, by material.",
                )
            ],
        )
        for m, material in enumerate(gap.materials):
            figures = [
                Figure(
                    f"ratio-{material.key}{mark}",
                    plots.draw_ratios(gap, model, m),
                    f"Response of each band, {model} over true.",
                )
            ]
            if m == 0:
                figures.append(
                    Figure(
                        f"distance-{material.key}{mark}",
                        plots.draw_distances(gap, model, m),
                        "Size of the difference of the weights, which counts a lobe that points "
                        "the wrong way too: the model's lobe stands around the mirror direction, "
                        "the true one leans away from it.",
                    )
                )
            yield Section(
                f"{prefix}{material.name}, by band",
                [
                    "Bands l = 2 and 3 are what tells sharp from soft reflections. Where the true "
                    "response is small a ratio says little."
                ],
                (),
                figures,
            )


def _sphere_figure(gap: Gap) -> Figure:
    return Figure(
        "spheres",
        plots.draw_spheres(gap),
        "Relative error of spheres under random lights over roughness.",
    )


def _sphere_table(gap: Gap, model: str) -> Table:
    relative, overall = gap.relative_rmse(model), gap.overall_rmse(model)
    columns = [Cell("material"), *(Cell(f"r = {r:g}", "number") for r in gap.effort.r)]
    rows = [
        [
            Cell(material.name),
            *(Cell(f"{value:.3f}", "number") for value in relative[m]),
            Cell(f"{overall[m]:.3f}", "best"),
        ]
        for m, material in enumerate(gap.materials)
    ]
    return Table([*columns, Cell("all r", "number")], rows)


def _albedo_table(gap: Gap, model: str) -> Table:
    """Of the lobe alone: model beside truth."""
    found, true = gap.model_response(model)[0, ..., 0], gap.true_response[0, ..., 0]
    columns = [Cell("r"), *(Cell(f"n·v = {x:g}", "number") for x in gap.effort.n_dot_v)]
    rows = [
        [
            Cell(f"{r:g}"),
            *(Cell(f"{a:.2f} / {b:.2f}", "number") for a, b in zip(*pair, strict=True)),
        ]
        for r, *pair in zip(gap.effort.r, found, true, strict=True)
    ]
    caption = f"{gap.materials[0].name}: directional albedo, {model} / true"
    return Table(columns, rows, caption)
