"""What the solvers must reach, and whether they do."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pbrfit_evaluation.ablation.demands import Demand, judge
from pbrfit_evaluation.solvers import Measured, Part, exact, gap, memory, noise, priors, race, start
from pbrfit_evaluation.table1.rows import BY_KEY, COLUMNS
from pbrfit_evaluation.verdicts import Verdict

Values = Mapping[str, Any]

EXACT_SHARE = 64 / 67
"""Of the rooms without noise that have to be exact."""


def verdicts(measured: Measured) -> list[Verdict[Part]]:
    """All that can be said of the parts that were run."""
    of_part: dict[Part, Callable[[Measured], Iterator[Verdict[Part]]]] = {
        "exact": _exact,
        "noise": _noise,
        "start": _start,
        "gap": _gap,
        "priors": _priors,
        "race": _race,
        "memory": _memory,
    }
    return [
        verdict
        for part, judged in of_part.items()
        if measured.finished(part)
        for verdict in judged(measured)
    ]


def _exact(measured: Measured) -> Iterator[Verdict[Part]]:
    found = measured.finished("exact")
    bar = math.ceil(EXACT_SHARE * len(found) - 1e-9)
    for name, recon, pictures in (
        ("gauss-newton", exact.RECON_FLOAT32, "float32"),
        ("auto", exact.RECON_FLOAT32, "float32"),
        ("gauss-newton, float64", exact.RECON_FLOAT64, "float64"),
    ):
        missed = [
            str(task.seed) for task, values in found if not exact.is_exact(values[name], recon)
        ]
        yield Verdict(
            "exact",
            f"{name.partition(',')[0]}: rooms of {len(found)} that are exact, {pictures} pictures",
            len(found) - len(missed),
            bar,
            f"not: {', '.join(missed)}" if missed else "",
            at_least=True,
        )
    above = {
        task.seed: values["auto"]["recon"] / values["lbfgsb"]["recon"] for task, values in found
    }
    worst = max(above, key=lambda seed: above[seed])
    higher = sum(ratio > 1 for ratio in above.values())
    yield Verdict(
        "exact",
        "auto's residual over lbfgsb's",
        above[worst],
        1.0,
        f"seed {worst}; above in {higher} of {len(found)}",
    )


def _noise(measured: Measured) -> Iterator[Verdict[Part]]:
    for level in noise.LEVELS:
        found = [pair for pair in measured.finished("noise") if pair[0].noise == level]
        if not found:
            continue
        for solver in ("auto", "gauss-newton"):
            above = {task.seed: noise.above_mark(values, solver) for task, values in found}
            worst = max(above, key=lambda seed: above[seed])
            yield Verdict(
                "noise",
                f"{solver}, noise {level:g}: objective over the mark, less 1",
                above[worst],
                noise.OBJECTIVE_SLACK,
                f"seed {worst}; mean {np.mean(list(above.values())):.1e}",
            )
        for suffix in ("", ", priors"):
            ratios = {
                metric: _mean_score(found, f"auto{suffix}", metric)
                / _mean_score(found, f"lbfgsb{suffix}", metric)
                for metric in noise.METRICS
            }
            worst_metric = max(ratios, key=lambda metric: ratios[metric])
            yield Verdict(
                "noise",
                f"auto over lbfgsb, noise {level:g}{suffix or ', no priors'}: worst mean error",
                ratios[worst_metric],
                noise.METRIC_RATIO,
                worst_metric.replace("_", ", "),
            )


def _mean_score(found: Sequence[tuple[Any, Values]], name: str, metric: str) -> float:
    return float(np.mean([values[name]["scores"][metric] for _, values in found]))


def _start(measured: Measured) -> Iterator[Verdict[Part]]:
    for setting in start.SETTINGS:
        above = {
            task.key.removeprefix("start_"): values[setting]["auto"] / values[setting]["lbfgsb"] - 1
            for task, values in measured.finished("start")
        }
        worst = max(above, key=lambda key: above[key])
        yield Verdict(
            "start",
            f"auto's objective over lbfgsb's, less 1: {setting}",
            above[worst],
            start.ROUNDING,
            f"{worst}; above in {sum(a > start.ROUNDING for a in above.values())} of {len(above)}",
        )


def gap_ratios(found: Sequence[tuple[Any, Values]]) -> dict[str, float]:
    """Mean error of `auto` over that of the paper's recipe, by column, for scenes of one row."""
    ratios = {}
    for column in COLUMNS:
        pairs = [(values["auto"][column], values["paper"][column]) for _, values in found]
        if all(ours is not None and paper is not None for ours, paper in pairs):
            ours, paper = np.mean(pairs, axis=0)
            ratios[column] = float(ours / paper)
    return ratios


def gap_rows(measured: Measured) -> dict[str, list[tuple[Any, Values]]]:
    """Finished scenes by row of table1."""
    found = measured.finished("gap")
    return {
        row: of_row
        for row in (*gap.ROWS, *gap.CYCLES_ROWS)
        if (of_row := [pair for pair in found if pair[0].of_table1.row == row])
    }


def _gap(measured: Measured) -> Iterator[Verdict[Part]]:
    for row, found in gap_rows(measured).items():
        name, ratios = BY_KEY[row].name, gap_ratios(found)
        worst = max(ratios, key=lambda column: ratios[column])
        mean = float(np.exp(np.mean(np.log(list(ratios.values())))))
        yield Verdict("gap", f"{name}: recon over the paper's recipe's", ratios["recon"], 1.0)
        yield Verdict("gap", f"{name}: geometric mean of the columns' ratios", mean, 1.0)
        yield Verdict("gap", f"{name}: worst column", ratios[worst], gap.WORST_COLUMN, worst)


def _priors(measured: Measured) -> Iterator[Verdict[Part]]:
    for case, limit in priors.ROUGHNESS.items():
        found = [values for task, values in measured.finished("priors") if task.case == case]
        if not found:
            continue

        def ratio(metric: str, found: Sequence[Values] = found, case: Any = case) -> float:
            without, default = ([v[key][metric] for v in found] for key in ("none", "default"))
            return judge(Demand("a", case, "recon", 1.0), without, default).value

        yield Verdict(
            "priors",
            f"{case}: roughness over that without priors",
            ratio("roughness"),
            limit,
            f"rooms: {len(found)}",
        )
        worst = max(priors.METRICS, key=ratio)
        yield Verdict(
            "priors", f"{case}: worst other error over that without", ratio(worst), 1.0, worst
        )


@dataclass(frozen=True)
class Speed:
    """How much sooner a solver had reached the mark, on one scene.

    Attributes
    ----------
    ratio
        Of the other's seconds to its own; 0 if it never did.
    bounded
        Whether the other never did: then its seconds are those after which it was given up.
    """

    ratio: float
    bounded: bool


def speeds(measured: Measured, solver: str, other: str) -> dict[int, Speed]:
    """By seed. `other`: "torch", or "lbfgsb" for the sooner of ours, as it is or by the recipe."""
    found: dict[int, dict[str, Values]] = {}
    for task, values in measured.finished("race"):
        found.setdefault(task.seed, {})[task.runner] = values
    result = {}
    for seed, runs in found.items():
        others = ("paper", "lbfgsb") if other == "lbfgsb" else (other,)
        there = [runs[key] for key in others if key in runs]
        if solver not in runs or not there:
            continue
        times = [_reached(values) for values in there]
        bounded = not any(math.isfinite(time) for time in times)
        seconds = max(v["seconds"] for v in there) if bounded else min(times)
        result[seed] = Speed(seconds / _reached(runs[solver]), bounded)
    return result


def _reached(values: Values) -> float:
    """Seconds to the mark; the paper's recipe makes it at its end."""
    if values["is_mark"]:
        return float(values["seconds"])
    return math.inf if values["reached"] is None else float(values["reached"])


def _race(measured: Measured) -> Iterator[Verdict[Part]]:
    for solver in ("gauss-newton", "auto"):
        for other, bar in (("lbfgsb", race.OVER_LBFGSB), ("torch", race.OVER_TORCH)):
            found = speeds(measured, solver, other)
            if not found:
                continue
            ratios = [speed.ratio for speed in found.values()]
            bounded = [str(seed) for seed, speed in found.items() if speed.bounded]
            where = f"from {min(ratios):.3g} to {max(ratios):.3g}"
            if bounded:
                where += f"; {other} never reached it on {', '.join(bounded)}: at least so much"
            yield Verdict(
                "race",
                f"{solver}: times sooner at the mark than {other}, median of {len(ratios)}",
                float(np.median(ratios)),
                bar,
                where,
                at_least=True,
            )


def _memory(measured: Measured) -> Iterator[Verdict[Part]]:
    for task, values in measured.finished("memory"):
        if values["peak"] is None or task.solver not in memory.BARS:
            continue
        yield Verdict(
            "memory",
            f"{task.solver}, {task.size}²: peak over the pictures' own bytes",
            values["peak"] / values["pictures"],
            memory.BARS[task.solver],
            f"{values['peak'] / 2**20:.0f} MiB",
        )
        if task.size**2 >= 4e6:
            yield Verdict(
                "memory",
                f"{task.solver}, {task.size}²: GiB at the peak",
                values["peak"] / 2**30,
                memory.LARGE_BYTES / 2**30,
            )
