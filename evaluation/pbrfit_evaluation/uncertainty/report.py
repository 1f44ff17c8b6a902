"""The calibration as files: page, plot, Markdown, summary."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pbrfit_evaluation import page, summary
from pbrfit_evaluation.page import Cell, Figure, Section, Table
from pbrfit_evaluation.uncertainty import (
    BARS,
    INSIDE,
    LARGEST,
    LIGHTS,
    MARGIN,
    WITHIN,
    Calibration,
    Lights,
    plots,
    share_within,
)

Array = NDArray[np.float64]

PROTOCOL = (
    "pbrfit-uncertainty-1: standard deviations over refits under Gaussian noise by predicted "
    f"ones; rooms of the model itself, materials in [{INSIDE[0]}, {INSIDE[1]}], mean radiance 0.4"
)

MARKDOWN = "uncertainty.md"


@dataclass(frozen=True)
class Group:
    """Scenes with the same lights (known or free) and noise, together."""

    lights: Lights
    noise: float
    scenes: Sequence[Calibration]

    @property
    def title(self) -> str:
        """In words."""
        return f"lights {self.lights}, noise {self.noise:g}"

    @property
    def ratios(self) -> Array:
        """(Q, 5): found by predicted."""
        return np.concatenate([scene.found / scene.predicted for scene in self.scenes])

    @property
    def ratios_by_fit(self) -> Array:
        """(Q, 5): found by predicted from one fit."""
        with np.errstate(divide="ignore"):  # that fit may have ended on a bound, and predict 0
            return np.concatenate([scene.found / scene.predicted_by_fit for scene in self.scenes])

    @property
    def holds(self) -> bool:
        """Whether the bar is reached."""
        return BARS[self.lights].holds(self.ratios)

    def metrics(self) -> dict[str, float | None]:
        """Figures by name; None where nothing could be compared."""
        ratios, by_fit = self.ratios, self.ratios_by_fit
        bar = BARS[self.lights]
        found: dict[str, float | None] = {
            "draws": self.scenes[0].task.draws,
            "values": ratios.size,
            "median": _median(ratios),
            "within": share_within(ratios) if ratios.size else None,
        }
        for name, values in plots.by_parameter(ratios):
            found[f"median_{name}"] = _median(values)
        biases = [np.abs(scene.bias / scene.predicted) for scene in self.scenes]
        found |= {
            "median_by_fit": _median(by_fit),
            "within_by_fit": share_within(by_fit) if by_fit.size else None,
            "median_bias": _median(np.concatenate(biases)),
            "variance": float(np.mean([scene.variance for scene in self.scenes])),
            "compared": float(np.mean([scene.compared for scene in self.scenes])),
            "converged": float(np.mean([scene.converged for scene in self.scenes])),
            "albedo_scale": max(scene.albedo_scale for scene in self.scenes),
            "least_median": bar.low,
            "largest_median": bar.high,
            "least_within": bar.share,
        }
        return found


def groups(scenes: Sequence[Calibration]) -> list[Group]:
    """All that have a scene, in the order of lights and noise."""
    levels = sorted({(scene.task.lights, scene.task.noise) for scene in scenes}, key=_order)
    return [
        Group(
            lights,
            noise,
            [scene for scene in scenes if (scene.task.lights, scene.task.noise) == (lights, noise)],
        )
        for lights, noise in levels
    ]


def write(folder: Path, scenes: Sequence[Calibration]) -> None:
    """Write `report.html`, its plot, `uncertainty.md`, `summary.json`."""
    found = groups(scenes)
    table = _table(found)
    page.write_page(folder, "Are the deviations right?", _opening(), list(_sections(found, table)))
    (folder / MARKDOWN).write_text(page.markdown(table), encoding="utf-8")
    rows = [
        summary.Row(
            group.title,
            len(group.scenes),
            None,
            group.metrics(),
            status="ok" if group.holds else "not held",
        )
        for group in found
    ]
    summary.write_summary(folder, PROTOCOL, rows)


def lines(found: Sequence[Group]) -> list[str]:
    """For the terminal."""
    head = f"{'median':>8}{'within':>8}{'by a fit':>10}{'within':>8}"
    return [head, *(_line(group) for group in found)]


def _line(group: Group) -> str:
    metrics = group.metrics()
    mark = "" if group.holds else "   NOT HELD"
    cells = (
        f"{_number(metrics['median']):>8}{_percent(metrics['within']):>8}"
        f"{_number(metrics['median_by_fit']):>10}{_percent(metrics['within_by_fit']):>8}"
    )
    return f"{cells}  {group.title}{mark}"


def _opening() -> list[str]:
    return [
        "Pictures of the model itself get noise again and again and are fitted each time, from the "
        "truth and to convergence. The standard deviation of what is found, by the predicted one, "
        "should be 1. There are no priors, and nothing but noise is wrong with the pictures.",
        f"Compared are pixels each of whose unknowns has a predicted deviation below {LARGEST} and "
        f"lies {MARGIN:g} of them or more inside both bounds. Known lights: each pixel is fitted "
        "alone; free lights: all pixels and lights together.",
        "Bars, for all values of a row together: known lights: median from 0.9 to 1.1 and 90 % "
        f"within {100 * WITHIN:.0f} %; free lights: median from 0.8 to 1.25.",
    ]


def _sections(found: Sequence[Group], table: Table) -> Iterator[Section]:
    plot = plots.draw_ratios([(group.title, group.ratios) for group in found])
    yield Section(
        "Found by predicted",
        [
            "Predicted is the formula at the true materials, lights and noise. By a fit: what is "
            "predicted from one noisy set of pictures and its fit, which know neither; no bar. "
            "Variance: of the residual over its degrees of freedom, by the true one. Bias: median "
            "of the mean error, in predicted deviations. Scale: largest predicted relative "
            "deviation of the scale between albedo and light."
        ],
        [table],
        [Figure("ratios", plot, "Ratios of found to predicted deviations. Grey: within 20 %.")],
    )


def _table(found: Sequence[Group]) -> Table:
    names = ["scenes", "refits", "pixels", "converged", "median", "within 20 %", "albedo"]
    names += ["roughness", "metallic", "by a fit", "within 20 %", "variance", "bias", "scale"]
    columns = [Cell("lights, noise"), *(Cell(name, "number") for name in names), Cell("")]
    return Table(columns, [_row(group) for group in found])


def _row(group: Group) -> list[Cell]:
    of = group.metrics()
    numbers = [
        str(len(group.scenes)),
        f"{of['draws']:.0f}",
        _percent(of["compared"]),
        _percent(of["converged"]),
        _number(of["median"]),
        _percent(of["within"]),
        *(_number(of[f"median_{name}"]) for name in ("albedo", "roughness", "metallic")),
        _number(of["median_by_fit"]),
        _percent(of["within_by_fit"]),
        _number(of["variance"], 3),
        _number(of["median_bias"]),
        _number(of["albedo_scale"], 3),
    ]
    verdict = Cell("holds", "pass") if group.holds else Cell("not held", "fail")
    return [Cell(group.title, "name"), *(Cell(text, "number") for text in numbers), verdict]


def _order(level: tuple[Lights, float]) -> tuple[int, float]:
    return LIGHTS.index(level[0]), level[1]


def _median(values: Array) -> float | None:
    return float(np.median(values)) if values.size else None


def _number(value: float | None, digits: int = 2) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def _percent(value: float | None) -> str:
    return "–" if value is None else f"{100 * value:.1f} %"
