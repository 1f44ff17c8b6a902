"""The gap as files: page, heat maps, CSV, summary."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from pbrfit.report.notation import scientific
from pbrfit_evaluation import page, summary
from pbrfit_evaluation.cycles.job import Distribution
from pbrfit_evaluation.gap import BANDS, INTEGRATED, PAPER, PRINCIPLED, TABULATED, Gap, plots
from pbrfit_evaluation.gap.spheres import ALBEDOS, LEAST_COSINE, Spheres
from pbrfit_evaluation.page import Cell, Figure, Section, Table
from pbrfit_evaluation.tables import write_csv

CONTAINS = (summary.FILE, page.FILE, "gap.csv")
"""Files by which an output folder is known for one of this suite."""

PROTOCOL = (
    "pbrfit-gap-2: SH responses of two BRDFs by quadrature, the principled one and the paper's "
    "(eqs. 1, 3-5); spheres seen from far away under random lights turned in every way; spheres by "
    "Cycles"
)

COLUMNS = (
    "reference", "model", "material", "r", "n_dot_v", "band", "true", "found", "ratio", "distance",
)  # fmt: skip
SPHERE_COLUMNS = (
    "reference", "model", "material", "r", "rms_radiance", "rmse", "relative_rmse",
)  # fmt: skip
CYCLES_COLUMNS = ("distribution", "substance", "model", "r", "albedo", "relative_rmse")

EXACT = 0.02
"""Models with a smaller error on spheres get no heat maps: nearly all cells would say 1.00."""


def write(folder: Path, gaps: Sequence[Gap], spheres: Spheres | str) -> None:
    """Write `report.html`, its plots, `gap.csv`, `spheres.csv`, `cycles.csv`, `summary.json`.

    Parameters
    ----------
    folder
        Exists.
    gaps
        As `measure_all` gives them.
    spheres
        Of Cycles, or why there are none.
    """
    sections = [
        *_worth(gaps[0]),
        _costs(gaps),
        *_cycles(spheres),
        *(section for gap in gaps for section in _maps(gap)),
    ]
    page.write_page(folder, "The gap of the reflection models", _opening(gaps), sections)
    write_csv(folder / "gap.csv", COLUMNS, [row for gap in gaps for row in _responses(gap)])
    write_csv(
        folder / "spheres.csv", SPHERE_COLUMNS, [row for gap in gaps for row in _spheres(gap)]
    )
    rows = [row for gap in gaps for row in _rows(gap)]
    if isinstance(spheres, Spheres):
        write_csv(folder / "cycles.csv", CYCLES_COLUMNS, _on_cycles(spheres))
        rows += _cycles_rows(spheres)
    summary.write_summary(folder, f"{PROTOCOL}; {gaps[0].effort.name}", rows)


def lines(gaps: Sequence[Gap], spheres: Spheres | str) -> Iterator[str]:
    """Say the main figures in the terminal."""
    yield "spheres under random lights, RMSE / RMS radiance, all roughnesses together"
    for gap in gaps:
        for model in gap.models:
            for material, value in zip(gap.materials, gap.overall_rmse(model), strict=True):
                yield f"{value:>10.2g}  {plots.title(gap, model)}, {material.name}"
    worst = max(gap.quadrature_error for gap in gaps)
    yield f"quadrature error {worst:.1e}"
    if isinstance(spheres, str):
        yield f"spheres by Cycles: not run: {spheres}"
        return
    yield "spheres by Cycles, RMSE / mean, the largest of all roughnesses and albedos from 0.5"
    for (distribution, substance, model), errors in spheres.errors.items():
        yield f"{errors[:, 1:].max():>10.2g}  {distribution}, {substance}: {model}"


# ------------------------------------------------------------------------------------ for programs


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
            yield summary.Row(f"{plots.title(gap, model)}, {material.key}", 0, None, metrics)


def _cycles_rows(spheres: Spheres) -> Iterator[summary.Row]:
    for (distribution, substance, model), errors in spheres.errors.items():
        metrics: dict[str, float | None] = {
            f"r_{r:g}_albedo_{albedo:g}": float(errors[i, c])
            for i, r in enumerate(spheres.effort.r)
            for c, albedo in enumerate(ALBEDOS)
        }
        yield summary.Row(f"Cycles {distribution}, {substance}, {model}", 0, None, metrics)


def _responses(gap: Gap) -> Iterator[tuple[object, ...]]:
    true = gap.true_response
    for model in gap.models:
        found, distance = gap.model_response(model), gap.distance(model)
        for index in np.ndindex(*true.shape):
            m, i, j, band = index
            yield (
                gap.reference.name,
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
                gap.reference.name,
                model,
                gap.materials[m].key,
                gap.effort.r[i],
                float(gap.sphere_signal[m, i]),
                float(gap.sphere_error[model][m, i]),
                float(relative[m, i]),
            )


def _on_cycles(spheres: Spheres) -> Iterator[tuple[object, ...]]:
    for (distribution, substance, model), errors in spheres.errors.items():
        for i, c in np.ndindex(*errors.shape):
            yield (
                *(distribution, substance, model, spheres.effort.r[i], ALBEDOS[c]),
                float(errors[i, c]),
            )


# -------------------------------------------------------------------------------------- for people


def _opening(gaps: Sequence[Gap]) -> list[str]:
    gap = gaps[0]
    worst = max(one.quadrature_error for one in gaps)
    brightest = max(one.true_response[0, ..., 0].max() for one in gaps)
    return [
        "What pbrfit's reflection models say, against integrals of BRDFs by brute force, for "
        f"{len(gap.effort.r)} values of roughness r and {len(gap.effort.n_dot_v)} of n·v (1 = seen "
        "straight on, 0 = grazing). There is no fit, no picture and no noise in this: it is the "
        "error of the model alone, which pictures of real surfaces add to all other errors.",
        "The principled integral is that of the BRDF of Blender's Principled, which glTF and game "
        "engines share but for Fresnel's term of dielectrics: GGX, height-correlated Smith, light "
        "between facets, over a diffuse body. The paper integral is that of the paper's eqs. 3-5, "
        "with a masking that lets some rough surfaces reflect more than all light at grazing "
        f"angles (largest directional albedo here: {brightest:.2f}). When the number of nodes is "
        f"doubled no integral changes by more than {scientific(worst)}.",
        "A response is the size of what comes back of light in one SH band l; it is 1 for a "
        "perfect mirror, and for l = 0 it is the directional albedo. `gap.csv` has all of them.",
    ]


def _worth(gap: Gap) -> Iterator[Section]:
    yield Section(
        "What a model is worth: against the principled integral",
        [
            "Root mean square error of radiance over the pixels of a sphere, relative to its root "
            "mean square radiance: means over random lights turned in every way. The last column "
            f"is of all roughnesses together. “{INTEGRATED}” is the paper's BRDF without the "
            "approximations of its closed form: no better form of it would come closer.",
        ],
        [_sphere_table(gap)],
        [
            Figure(
                "spheres",
                plots.draw_spheres(gap),
                "Relative error of spheres under random lights over roughness.",
            )
        ],
    )


def _costs(gaps: Sequence[Gap]) -> Section:
    columns = [Cell("model"), Cell("stands for")]
    columns += [Cell(m.name, "number") for m in gaps[0].materials]
    columns += [Cell("largest difference of a response", "number")]
    own = (PAPER.name, "paper"), (PRINCIPLED.name, "principled"), (TABULATED.name, "principled")
    by_reference = {gap.reference.name: gap for gap in gaps}
    rows = []
    for reference, model in own:
        gap = by_reference[reference]
        values = [*gap.overall_rmse(model), gap.distance(model).max()]
        stands_for = "its table" if reference == TABULATED.name else f"the {reference} integral"
        rows.append(
            [Cell(model), Cell(stands_for), *(Cell(scientific(v), "number") for v in values)]
        )
    return Section(
        "What its approximations cost: each model against what it stands for",
        [
            "The closed form of the paper's model is an approximation of an integral. The "
            "principled model is a table of one, made with Schlick's Fresnel term, and for "
            "dielectrics scaled by one number that makes the directional albedo right. Spheres as "
            "above, all roughnesses together."
        ],
        [Table(columns, rows)],
    )


def _cycles(spheres: Spheres | str) -> Iterator[Section]:
    name = "Against Cycles"
    if isinstance(spheres, str):
        yield Section(name, [f"Not run: {spheres}"])
        return
    effort = spheres.effort
    yield Section(
        name,
        [
            f"Spheres rendered by Blender's Cycles, {effort.size} × {effort.size} pixels, "
            f"{effort.samples} paths a pixel, no bounces, under {effort.lights} lights of random "
            f"SH coefficients; pixels with n·v > {LEAST_COSINE:g}. RMSE of what a model says of "
            "the known material and light, over the mean radiance, for albedo "
            + " / ".join(f"{albedo:g}" for albedo in ALBEDOS)
            + ". No figure can be below the noise of the renders.",
            "GGX is Principled without light between facets, which the principled model has; there "
            "the integral without it is what should agree. MULTI_GGX is Blender's default. "
            "“Integrals” are by brute force, and tell what choices are worth: Fresnel's equations "
            "or Schlick's fit in the dielectric lobe; how much of what that lobe reflects, E_d, is "
            "held back from the body. For plain GGX Blender holds back more than the lobe "
            "reflects, E_d/E, with E the albedo of a lobe of F = 1.",
        ],
        [_cycles_table(spheres, distribution) for distribution in spheres.effort.distributions],
        [Figure("cycles", plots.draw_cycles(spheres), "Errors on spheres by Cycles.")],
    )


def _maps(gap: Gap) -> Iterator[Section]:
    """Heat maps of the models that differ from the reference."""
    for model in gap.models:
        if model == INTEGRATED or gap.overall_rmse(model).max() < EXACT:
            continue
        name = plots.title(gap, model, " over ")
        mark = f"-{gap.reference.name}"
        yield Section(
            f"Directional albedo: {name}",
            [
                "Light that comes back under light of one radiance from all around (l = 0). "
                "Dielectrics are whole materials: lobe and diffuse term together, which in part "
                "make up for each other.",
            ],
            [_albedo_table(gap, model)],
            [Figure(f"albedo{mark}", plots.draw_albedos(gap, model), "By material.")],
        )
        yield Section(
            f"{gap.materials[0].name}, by band: {name}",
            [
                "Bands l = 2 and 3 are what tells sharp from soft reflections. Where the true "
                "response is small a ratio says little. The distance is the size of the difference "
                "of the weights, which counts a lobe that points the wrong way too: the paper's "
                "lobe stands around the mirror direction, the true one leans away from it."
            ],
            (),
            [
                Figure(f"ratio{mark}", plots.draw_ratios(gap, model, 0), "Ratio of responses."),
                Figure(f"distance{mark}", plots.draw_distances(gap, model, 0), "Distance."),
            ],
        )


def _sphere_table(gap: Gap) -> Table:
    columns = [Cell("material"), Cell("model")]
    columns += [Cell(f"r = {r:g}", "number") for r in gap.effort.r]
    rows = [
        [
            Cell(material.name if model == next(iter(gap.models)) else ""),
            Cell(model),
            *(Cell(_short(value), "number") for value in gap.relative_rmse(model)[m]),
            Cell(_short(gap.overall_rmse(model)[m]), "number"),
        ]
        for m, material in enumerate(gap.materials)
        for model in gap.models
    ]
    return Table([*columns, Cell("all r", "number")], rows)


def _cycles_table(spheres: Spheres, distribution: Distribution) -> Table:
    columns = [Cell("sphere"), Cell("model")]
    columns += [Cell(f"r = {r:g}", "number") for r in spheres.effort.r]
    models = spheres.models(distribution)
    rows = [
        [
            Cell(substance.name if model == models[0] else ""),
            Cell(model),
            *(
                Cell(" / ".join(f"{value:.3f}" for value in errors), "number")
                for errors in spheres.errors[distribution, substance.key, model]
            ),
        ]
        for substance in spheres.effort.substances
        for model in models
    ]
    return Table(columns, rows, f"distribution {distribution}")


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
    caption = f"{gap.materials[0].name}: directional albedo, {plots.title(gap, model)}"
    return Table(columns, rows, caption)


def _short(value: float) -> str:
    return f"{value:.3f}" if value >= 1e-3 else scientific(value)
