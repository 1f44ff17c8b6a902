"""The gap as rows, tables, heat maps, curves and CSV files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np

from pbrfit_evaluation import cycles
from pbrfit_evaluation.cycles.job import Distribution
from pbrfit_evaluation.gap.measure import COMPARED, INTEGRATED, MATERIALS, Array, Case
from pbrfit_evaluation.gap.spheres import (
    ALBEDOS,
    INTEGRALS,
    LEAST_COSINE,
    NOISE,
    SUBSTANCES,
    Sphere,
)
from pbrfit_evaluation.suite import (
    HeatMap,
    Line,
    Panel,
    Plot,
    Results,
    Row,
    Section,
    Series,
    Table,
    Value,
)

NAMES = [material.name for material in MATERIALS]


@dataclass(frozen=True, eq=False)
class Gap:
    """A model beside a BRDF. M materials, R roughnesses, V view angles.

    `true`, `found`, their `ratio` and `distance` are responses (M, R, V, 4); `signal` and `error`
    (M, R) are root mean square radiance of a sphere and its error.
    """

    reference: str
    model: str
    true: Array
    found: Array
    distance: Array
    signal: Array
    error: Array
    quadrature_error: float

    @property
    def ratio(self) -> Array:
        """Response of the model over the true one."""
        return np.asarray(self.found / self.true)

    @property
    def overall_rmse(self) -> Array:
        """(M,): error of spheres of all roughnesses together, relative to their signal."""
        error = np.mean(np.square(self.error), axis=-1)
        return np.asarray(np.sqrt(error / np.mean(np.square(self.signal), axis=-1)))


def gaps(results: Results[Case]) -> Iterator[Gap]:
    """Every model against every BRDF, over the roughnesses that were finished."""

    def stacked(values: Sequence[Any], *names: str) -> list[Array]:
        return [np.stack([np.array(of[name]) for of in values], axis=1) for name in names]

    for reference, (_, models) in COMPARED.items() if results.finished else ():
        values = [of[reference] for _, of in results.finished]
        true, signal = stacked(values, "true", "signal")
        worst = max(of["quadrature_error"] for of in values)
        for model in models:
            of_model = [of["models"][model] for of in values]
            found, distance, error = stacked(of_model, "found", "distance", "error")
            yield Gap(reference, model, true, found, distance, signal, error, worst)


def rows(results: Results[Case]) -> list[Row]:
    """A row for each model, BRDF and material."""
    made = []
    for gap in gaps(results):
        overall, ratio = gap.overall_rmse, gap.ratio
        for m, material in enumerate(MATERIALS):
            metrics: dict[str, float | None] = {"relative_rmse": float(overall[m])}
            for band in range(4):
                metrics[f"least_ratio_{band}"] = float(ratio[m, ..., band].min())
                metrics[f"largest_ratio_{band}"] = float(ratio[m, ..., band].max())
                metrics[f"largest_distance_{band}"] = float(gap.distance[m, ..., band].max())
            metrics["quadrature_error"] = gap.quadrature_error
            name = f"{gap.model} model / {gap.reference} integral, {material.key}"
            made.append(Row(name, 0, None, metrics, status=results.status("roughnesses")))
    return made


def csvs(results: Results[Case], _: Sequence[Row]) -> Mapping[str, Sequence[Line]]:
    """Every response."""
    points = [(case.r, n_dot_v) for case, _ in results.finished for n_dot_v in case.n_dot_v]
    lines = [
        {
            "reference": gap.reference,
            "model": gap.model,
            "material": MATERIALS[m].key,
            "r": points[i][0],
            "n_dot_v": points[i][1],
            "band": band,
            **{name: float(of[m, i, band]) for name, of in table.items()},
        }
        for gap in gaps(results)
        for table in [
            {
                name: getattr(gap, name).reshape(len(MATERIALS), -1, 4)
                for name in ("true", "found", "ratio", "distance")
            }
        ]
        for m, i, band in np.ndindex(*table["true"].shape)
    ]
    return {"gap.csv": lines}


def sections(results: Results[Case], rows: Sequence[Row]) -> Iterator[Section]:
    """All figures, spheres over roughness, and heat maps of the paper's model."""
    shown = ["relative_rmse", "least_ratio_0", "largest_ratio_0"]
    shown += [f"largest_distance_{band}" for band in range(4)]
    if not rows:
        return
    yield Section(
        "Each model against each integral",
        "Relative RMSE: of the radiance of spheres under random lights turned in every way, "
        "relative to its RMS, all roughnesses together. Ratios and distances of responses by SH "
        f"band, over the whole table. “{INTEGRATED}” is the paper's BRDF without the "
        "approximations of its closed form: no better form of it would come closer.",
        [Table.of(rows, [*shown, "quadrature_error"])],
    )
    against = {gap.model: gap for gap in gaps(results) if gap.reference == "principled"}
    relative = {model: (gap.error / gap.signal).tolist() for model, gap in against.items()}
    r = [case.r for case, _ in results.finished]
    lines: list[list[Value]] = [
        [name, model, *of[m]] for m, name in enumerate(NAMES) for model, of in relative.items()
    ]
    panels = [
        Panel(
            "lines",
            [Series(model, r, of[m]) for model, of in relative.items()],
            "roughness r",
            "relative RMSE",
            title=name,
            log="y",
        )
        for m, name in enumerate(NAMES)
    ]
    yield Section(
        "Spheres against the principled integral",
        tables=[Table(["material", "model", *(f"r = {x:g}" for x in r)], lines)],
        figures=[
            Plot("spheres", "Error of spheres over roughness.", panels, columns=4, share_y="all")
        ],
    )
    ratio, n_dot_v = against["paper"].ratio, results.finished[0][0].n_dot_v
    yield Section(
        "By roughness and view angle: paper model / principled integral",
        "Of dielectrics, lobe and diffuse term together, which in part make up for each other. "
        "Where the true response is small a ratio says little. Orange: too bright, purple: too "
        "dark.",
        figures=[
            Plot(
                name,
                caption,
                [
                    HeatMap(
                        of[::-1].tolist(),
                        [f"{x:g}" for x in n_dot_v],
                        [f"{x:g}" for x in r][::-1],
                        "n·v",
                        "roughness r",
                        title=title,
                        scale="ratio",
                    )
                    for title, of in maps
                ],
                columns=2,
            )
            for name, caption, maps in (
                (
                    "albedo",
                    "Directional albedo (l = 0), ratio.",
                    zip(NAMES, ratio[..., 0], strict=True),
                ),
                (
                    "ratio",
                    "The lobe alone (F = 1), ratio of responses.",
                    [(f"l = {band}", ratio[0, ..., band]) for band in range(4)],
                ),
            )
        ],
    )


# ------------------------------------------------------------------------------------- on Cycles


def sphere_rows(results: Results[Sphere]) -> list[Row]:
    """A row for each distribution, substance and model, or one that says why there are none."""
    if not results.pairs:
        why_not = "--quick leaves Cycles out" if results.options.quick else cycles.why_not()
        return [Row("spheres by Cycles", 0, None, {}, status=f"not run: {why_not}")]
    return [
        Row(
            f"Cycles {distribution}, {substance}, {model}",
            0,
            None,
            {
                f"r_{case.r:g}_albedo_{albedo:g}": error
                for case, found in of.finished
                for albedo, error in zip(ALBEDOS, found[model], strict=True)
            },
            status=of.status("spheres"),
        )
        for distribution, substance, of in _groups(results)
        for model in (of.finished[0][1] if of.finished else ())
    ]


def _groups(results: Results[Sphere]) -> list[tuple[Distribution, str, Results[Sphere]]]:
    return [
        (distribution, substance, results.of(distribution=distribution, substance=substance))
        for distribution in get_args(Distribution)
        for substance in SUBSTANCES
    ]


def sphere_sections(results: Results[Sphere], rows: Sequence[Row]) -> Iterator[Section]:
    """The errors as a table and a plot."""
    shown = ("paper", "principled", next(iter(INTEGRALS["GGX"])), NOISE)
    panels = [
        Panel(
            "lines",
            [
                Series(
                    name,
                    [case.r for case, _ in of.finished],
                    [max(found[name][1:]) for _, found in of.finished],
                )
                for name in (of.finished[0][1] if of.finished else ())
                if name in shown
            ],
            "roughness r",
            "RMSE / mean",
            title=f"{substance}, {distribution}",
            log="y",
        )
        for distribution, substance, of in _groups(results)
    ]
    caption = "The larger error of albedos 0.5 and 0.9."
    plot = Plot("cycles", caption, panels, columns=len(SUBSTANCES), share_y="all")
    yield Section(
        "Against Cycles",
        "RMSE of what a model says of spheres by Blender's Cycles, without bounces, of known "
        f"material and light, over the mean radiance; pixels with n·v > {LEAST_COSINE:g}. No "
        "figure can be below the noise of the renders. “Integrals” are by brute force, and tell "
        "what Fresnel's equations are worth in the dielectric lobe, beside Schlick's fit. GGX is "
        "Principled without light between facets; MULTI_GGX is Blender's default.",
        [Table.of(rows)],
        [plot] if results.finished else [],
    )
