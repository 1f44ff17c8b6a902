"""The gap as rows, tables, heat maps, curves and CSV files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import get_args

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
from pbrfit_evaluation.jobs import Values
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

EXACT = 0.02
"""Relative error on spheres of all roughnesses; models below it get no heat maps, in which nearly
all cells would say 1.00."""


@dataclass(frozen=True, eq=False)
class Gap:
    """A model beside a BRDF. M materials, R roughnesses, V view angles.

    `true`, `found` and `distance` are responses (M, R, V, 4); `signal` and `error` (M, R) are root
    mean square radiance of a sphere and its error.
    """

    reference: str
    model: str
    r: Sequence[float]
    n_dot_v: Sequence[float]
    true: Array
    found: Array
    distance: Array
    signal: Array
    error: Array
    quadrature_error: float

    @property
    def name(self) -> str:
        """What is compared with what."""
        return f"{self.model} model / {self.reference} integral"

    @property
    def ratio(self) -> Array:
        """(M, R, V, 4): response of the model over the true one."""
        return np.asarray(self.found / self.true)

    @property
    def relative_rmse(self) -> Array:
        """(M, R): error of a sphere under random lights, relative to its signal."""
        return np.asarray(self.error / self.signal)

    @property
    def overall_rmse(self) -> Array:
        """(M,): the same over spheres of all roughnesses together."""
        error = np.mean(np.square(self.error), axis=-1)
        return np.asarray(np.sqrt(error / np.mean(np.square(self.signal), axis=-1)))


def gaps(results: Results[Case]) -> Iterator[Gap]:
    """Every model against every BRDF, over the roughnesses that were finished."""

    def stacked(values: Sequence[Values], name: str) -> Array:
        return np.stack([np.asarray(of[name], np.float64) for of in values], axis=1)

    found = results.finished
    for reference, (_, models) in COMPARED.items() if found else ():
        values = [of[reference] for _, of in found]
        for model in models:
            of_model = [of["models"][model] for of in values]
            yield Gap(
                reference,
                model,
                r=[case.r for case, _ in found],
                n_dot_v=found[0][0].n_dot_v,
                true=stacked(values, "true"),
                found=stacked(of_model, "found"),
                distance=stacked(of_model, "distance"),
                signal=stacked(values, "signal"),
                error=stacked(of_model, "error"),
                quadrature_error=max(of["quadrature_error"] for of in values),
            )


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
            status = results.status("roughnesses")
            made.append(Row(f"{gap.name}, {material.key}", 0, None, metrics, status=status))
    return made


def csvs(results: Results[Case], _: Sequence[Row]) -> Mapping[str, Sequence[Line]]:
    """Every response, and every sphere."""
    responses: list[Line] = []
    spheres: list[Line] = []
    for gap in gaps(results):
        names = {"reference": gap.reference, "model": gap.model}
        for m, i in np.ndindex(*gap.signal.shape):
            of = {**names, "material": MATERIALS[m].key, "r": gap.r[i]}
            sphere = {"rms_radiance": gap.signal, "rmse": gap.error}
            sphere |= {"relative_rmse": gap.relative_rmse}
            spheres.append(of | {name: float(at[m, i]) for name, at in sphere.items()})
            table = {"true": gap.true, "found": gap.found, "ratio": gap.ratio}
            table |= {"distance": gap.distance}
            for j, band in np.ndindex(*gap.true.shape[2:]):
                point = {"n_dot_v": gap.n_dot_v[j], "band": band}
                numbers = {name: float(at[m, i, j, band]) for name, at in table.items()}
                responses.append(of | point | numbers)
    return {"gap.csv": responses, "spheres.csv": spheres}


def sections(results: Results[Case], rows: Sequence[Row]) -> Iterator[Section]:
    """All figures, spheres over roughness, and heat maps of the models that are not exact."""
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
    against = [gap for gap in gaps(results) if gap.reference == "principled"]
    lines: list[list[Value]] = [
        [material.name, gap.model, *map(float, gap.relative_rmse[m])]
        for m, material in enumerate(MATERIALS)
        for gap in against
    ]
    panels = [
        Panel(
            "lines",
            [Series(gap.model, gap.r, list(gap.relative_rmse[m])) for gap in against],
            "roughness r",
            "relative RMSE",
            title=material.name,
            log="y",
        )
        for m, material in enumerate(MATERIALS)
    ]
    yield Section(
        "Spheres against the principled integral",
        tables=[Table(["material", "model", *(f"r = {r:g}" for r in against[0].r)], lines)],
        figures=[
            Plot("spheres", "Error of spheres over roughness.", panels, columns=4, share_y="all")
        ],
    )
    for gap in gaps(results):
        if gap.model != INTEGRATED and gap.overall_rmse.max() >= EXACT:
            yield _maps(gap)


def _maps(gap: Gap) -> Section:
    materials = [material.name for material in MATERIALS]
    bands = [f"l = {band}" for band in range(4)]
    plots = [
        ("albedo", "Directional albedo (l = 0), ratio", np.moveaxis(gap.ratio[..., 0], 0, -1)),
        ("ratio", "The lobe alone (F = 1), ratio of responses", gap.ratio[0]),
        ("distance", "The lobe alone (F = 1), distance of responses", gap.distance[0]),
    ]
    return Section(
        f"By roughness and view angle: {gap.name}",
        "Of dielectrics, lobe and diffuse term together, which in part make up for each other. "
        "Where the true response is small a ratio says little. Orange: too bright, purple: too "
        "dark.",
        figures=[
            Plot(
                f"{name}-{gap.reference}",
                f"{caption}.",
                [
                    HeatMap(
                        values[::-1, :, i].tolist(),
                        [f"{x:g}" for x in gap.n_dot_v],
                        [f"{r:g}" for r in gap.r][::-1],
                        "n·v",
                        "roughness r",
                        title=title,
                        ratio=name != "distance",
                        scale="ratio" if name != "distance" else "a mirror's response is 1",
                    )
                    for i, title in enumerate(materials if name == "albedo" else bands)
                ],
                columns=2,
            )
            for name, caption, values in plots
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
        for distribution in get_args(Distribution)
        for substance in SUBSTANCES
        for of in [results.of(distribution=distribution, substance=substance)]
        for model in (of.finished[0][1] if of.finished else ())
    ]


def sphere_csvs(results: Results[Sphere], _: Sequence[Row]) -> Mapping[str, Sequence[Line]]:
    """Every error."""
    lines = [
        {
            "distribution": case.distribution,
            "substance": case.substance,
            "model": model,
            "r": case.r,
            "albedo": albedo,
            "relative_rmse": error,
        }
        for case, found in results.finished
        for model, errors in found.items()
        for albedo, error in zip(ALBEDOS, errors, strict=True)
    ]
    return {"cycles.csv": lines} if lines else {}


def sphere_sections(results: Results[Sphere], rows: Sequence[Row]) -> Iterator[Section]:
    """The errors as a table and a plot."""
    shown = ("paper", "principled", next(iter(INTEGRALS["GGX"])), NOISE)
    panels = []
    for distribution in get_args(Distribution):
        for substance in SUBSTANCES:
            found = results.of(distribution=distribution, substance=substance).finished
            series = [
                Series(name, [case.r for case, _ in found], [max(of[name][1:]) for _, of in found])
                for name in (found[0][1] if found else ())
                if name in shown
            ]
            title = f"{substance}, {distribution}"
            panels.append(
                Panel("lines", series, "roughness r", "RMSE / mean", title=title, log="y")
            )
    plot = Plot(
        "cycles",
        "The larger error of albedos 0.5 and 0.9.",
        panels,
        columns=len(SUBSTANCES),
        share_y="all",
    )
    yield Section(
        "Against Cycles",
        "RMSE of what a model says of spheres by Blender's Cycles, without bounces, of known "
        f"material and light, over the mean radiance; pixels with n·v > {LEAST_COSINE:g}. No "
        "figure can be below the noise of the renders. “Integrals” are by brute force, and tell "
        "what choices are worth: Fresnel's equations or Schlick's fit in the dielectric lobe; how "
        "much of what that lobe reflects, E_d, is held back from the body. GGX is Principled "
        "without light between facets; MULTI_GGX is Blender's default.",
        [Table.of(rows)],
        [plot] if results.finished else [],
    )
