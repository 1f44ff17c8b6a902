"""The gap as rows, tables, heat maps and curves."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from pbrfit.commands.arguments import value, whole_number
from pbrfit_evaluation.arrays import Array
from pbrfit_evaluation.gap.measure import COMPARED, MATERIALS, Case, cases, run
from pbrfit_evaluation.options import Setting, fixed
from pbrfit_evaluation.plots import CELL, draw, dress, heat_map, panels, png
from pbrfit_evaluation.suite import Picture, Results, Row, Section, Suite, Table, Value

NAMES = [material.name for material in MATERIALS]


def _stacked(results: Results[Case], *path: str) -> Array:
    """(M, R, ...): an array at a path of names, of M materials and R roughnesses."""
    found: list[Any] = [of for _, of in results.finished]
    for name in path:
        found = [of[name] for of in found]
    return np.stack([np.array(of) for of in found], axis=1)


def _ratio(results: Results[Case], model: str) -> Array:
    """(M, R, V, 4): responses of a model over the true ones."""
    return np.asarray(_stacked(results, "models", model, "found") / _stacked(results, "true"))


def rows(results: Results[Case]) -> list[Row]:
    """A row for each model and material."""
    made = []
    for model in COMPARED if results.finished else ():
        error, signal = _stacked(results, "models", model, "error"), _stacked(results, "signal")
        overall = np.sqrt(np.square(error).mean(axis=1) / np.square(signal).mean(axis=1))
        ratio = _ratio(results, model)
        worst = max(of["quadrature_error"] for _, of in results.finished)
        for m, material in enumerate(MATERIALS):
            metrics: dict[str, float | None] = {"relative_rmse": float(overall[m])}
            for band in range(4):
                metrics[f"least_ratio_{band}"] = float(ratio[m, ..., band].min())
                metrics[f"largest_ratio_{band}"] = float(ratio[m, ..., band].max())
            metrics["quadrature_error"] = worst
            name = f"{model} model, {material.key}"
            made.append(Row(name, 0, None, metrics, status=results.status("roughnesses")))
    return made


def sections(results: Results[Case], rows: Sequence[Row]) -> Iterator[Section]:
    """Spheres over roughness, and heat maps of the paper's model."""
    if not rows:
        return
    signal = _stacked(results, "signal")
    relative = {
        model: (_stacked(results, "models", model, "error") / signal).tolist() for model in COMPARED
    }
    r = [case.r for case, _ in results.finished]
    lines: list[list[Value]] = [
        [name, model, *of[m]] for m, name in enumerate(NAMES) for model, of in relative.items()
    ]
    figure, grid = panels(len(NAMES), 4, sharey="all")
    for axes, (m, name) in zip(grid, enumerate(NAMES), strict=True):
        for place, (model, of) in enumerate(relative.items()):
            draw(axes, r, of[m], place, model)
        dress(axes, "roughness r", "relative RMSE", name, log="y")
    yield Section(
        "Spheres against the principled integral",
        tables=[Table(["material", "model", *(f"r = {x:g}" for x in r)], lines)],
        figures=[Picture("spheres", "Error of spheres over roughness.", png(figure))],
    )
    ratio, n_dot_v = _ratio(results, "paper"), results.finished[0][0].n_dot_v
    albedos = dict(zip(NAMES, ratio[..., 0], strict=True))
    bands = {f"l = {band}": ratio[0, ..., band] for band in range(4)}
    yield Section(
        "By roughness and view angle: paper model / principled integral",
        "Of dielectrics, lobe and diffuse term together, which in part make up for each other. "
        "Where the true response is small a ratio says little. Orange: too bright, purple: too "
        "dark.",
        figures=[
            Picture("albedo", "Directional albedo (l = 0), ratio.", _maps(albedos, n_dot_v, r)),
            Picture(
                "ratio", "The lobe alone (F = 1), ratio of responses.", _maps(bands, n_dot_v, r)
            ),
        ],
    )


def _maps(ratios: Mapping[str, Array], n_dot_v: Sequence[float], r: Sequence[float]) -> bytes:
    """Heat maps of ratios (R, V) by title, large r on top."""
    size = (1.6 + CELL * len(n_dot_v), 1.0 + 0.7 * CELL * len(r))
    figure, grid = panels(len(ratios), 2, size)
    for axes, (title, of) in zip(grid, ratios.items(), strict=True):
        heat_map(axes, of[::-1], [f"{x:g}" for x in n_dot_v], [f"{x:g}" for x in r][::-1])
        axes.set_title(title, loc="left", fontsize=10)
        axes.set(xlabel="n·v", ylabel="roughness r")
    return png(figure)


TENTHS = tuple(round(0.1 * i, 1) for i in range(1, 11))


SUITE = Suite(
    name="gap",
    title="The gap of the reflection models",
    protocol="pbrfit-gap-4: SH responses of the principled BRDF by quadrature; spheres seen from "
    "far away under random lights turned in every way; {effort}",
    cases=cases,
    run=run,
    rows=rows,
    sections=sections,
    settings={
        "seed": fixed(0, value("SEED", whole_number, "of the random lights")),
        "r": Setting((0.05, *TENTHS), (0.1, 0.3, 0.5, 0.8, 1.0)),
        "n_dot_v": Setting((0.05, *TENTHS), (0.1, 0.2, 0.5, 0.8, 1.0)),
        "rings": Setting(20, 10),
        "lights": Setting(64, 16),
    },
    about=(
        "The models that pbrfit fits beside brute-force integration of BRDFs, over roughness, "
        "view angle and SH band. The principled "
        "integral is that of the BRDF of Blender's Principled, which glTF and game engines share "
        "but for Fresnel's term of dielectrics.",
        "A response is the size of what comes back of light in one SH band l: 1 for a perfect "
        "mirror, and for l = 0 the directional albedo. Relative RMSE is of the radiance of "
        "spheres under random lights turned in every way, over its RMS.",
    ),
)
