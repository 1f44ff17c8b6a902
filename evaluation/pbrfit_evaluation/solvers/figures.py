"""Rows, verdicts and plots of the parts; what each must reach is in docs/solvers.md."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from pbrfit_evaluation.solvers import measure
from pbrfit_evaluation.solvers.measure import Case
from pbrfit_evaluation.suite import (
    Results,
    Row,
    Section,
    Table,
    Verdict,
)

EXACT_SHARE = 64 / 67
"""Share of the rooms without noise that have to be exact, at least."""

OBJECTIVE_SLACK, METRIC_RATIO = 1e-3, 1.02
"""With noise: objective of `gauss-newton` over the mark, less 1, and its mean error over that of
`lbfgsb`, at most."""

EXACT_METRICS = ("exact", "recon", "worst_map", "seconds")
"""The mean of "exact" is the share of rooms."""

NOISE_METRICS = ("albedo", "albedo_scaled", "roughness", "metallic", "relight")

NOISE_SHOWN = ("above_mark", "recon", *NOISE_METRICS, "seconds")

Of = Results[Case]


def _means(name: str, of: Of, fits: Iterable[str], metrics: Sequence[str]) -> list[Row]:
    """A row a fit."""
    rooms = len(of.finished)
    return [Row(name, rooms, fit, of.metrics(metrics, fit), status=of.status()) for fit in fits]


def _highest(what: str, above: Mapping[str, float], bar: float) -> Verdict:
    """The largest figure of any scene, and how many are above the bar."""
    worst = max(above, key=lambda scene: above[scene])
    where = f"{worst}; above in {sum(value > bar for value in above.values())} of {len(above)}"
    return Verdict(what, above[worst], bar, where)


# ----------------------------------------------------------------------------------------- exact


def exact_rows(results: Of) -> list[Row]:
    """Means over the rooms, a row a fit."""
    return _means("rooms without noise", results, measure.EXACT_FITS, EXACT_METRICS)


def exact_verdicts(results: Of, _: Sequence[Row]) -> Iterator[Verdict]:
    """Enough rooms are exact; `gauss-newton` is never above `lbfgsb`."""
    found = results.finished
    if not found:
        return
    for name, (solver, bound) in measure.EXACT_FITS.items():
        if solver == "lbfgsb":
            continue
        missed = [str(case.seed) for case, values in found if not values[name]["exact"]]
        pictures = "float32" if bound == measure.RECON_FLOAT32 else "float64"
        yield Verdict(
            f"{solver}: rooms of {len(found)} that are exact, {pictures} pictures",
            len(found) - len(missed),
            math.ceil(EXACT_SHARE * len(found) - 1e-9),
            f"not: {', '.join(missed)}" if missed else "",
            at_least=True,
        )
    above = {
        f"seed {case.seed}": v["gauss-newton"]["recon"] / v["lbfgsb"]["recon"] for case, v in found
    }
    yield _highest("gauss-newton's residual over lbfgsb's", above, 1.0)


def exact_sections(_: Of, rows: Sequence[Row]) -> list[Section]:
    """Means; what each room has is in scenes.csv."""
    return [Section("Exact: pictures without noise", tables=[Table.of(rows)])]


# ----------------------------------------------------------------------------------------- noise


def _levels(results: Of) -> Iterator[tuple[str, Of]]:
    for level in measure.LEVELS:
        if (of := results.of(noise=level)).finished:
            yield f"noise {level:g}", of


def noise_rows(results: Of) -> list[Row]:
    """Means over the rooms of a level, a row a fit."""
    return [
        row
        for level, of in _levels(results)
        for row in _means(level, of, measure.NOISE_FITS, NOISE_SHOWN)
    ]


def noise_verdicts(results: Of, _: Sequence[Row]) -> Iterator[Verdict]:
    """Objectives are near the mark, and maps no worse than L-BFGS-B's."""
    for level, of in _levels(results):
        above = {f"seed {case.seed}": v["gauss-newton"]["above_mark"] for case, v in of.finished}
        what = f"gauss-newton, {level}: objective over the mark, less 1"
        yield _highest(what, above, OBJECTIVE_SLACK)
        for suffix in ("", ", priors"):
            ratios = {
                metric: float(
                    np.mean(of.numbers(f"gauss-newton{suffix}", metric))
                    / np.mean(of.numbers(f"lbfgsb{suffix}", metric))
                )
                for metric in NOISE_METRICS
            }
            worst = max(ratios, key=lambda metric: ratios[metric])
            what = f"gauss-newton over lbfgsb, {level}{suffix or ', no priors'}: worst mean error"
            yield Verdict(what, ratios[worst], METRIC_RATIO, worst.replace("_", ", "))


def noise_sections(_: Of, rows: Sequence[Row]) -> list[Section]:
    """Likewise."""
    return [Section("Noise", tables=[Table.of(rows)])]
