"""Rows, verdicts and plots of the parts; what each must reach is in docs/solvers.md."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from pbrfit_evaluation import cycles
from pbrfit_evaluation.solvers import comparisons, exact, memory, race
from pbrfit_evaluation.solvers.fits import Case
from pbrfit_evaluation.suite import (
    Mark,
    Panel,
    Part,
    Plot,
    Results,
    Row,
    Section,
    Series,
    Table,
    Verdict,
    numbers_csv,
)
from pbrfit_evaluation.table1.rows import BY_KEY, COLUMNS

EXACT_SHARE = 64 / 67
"""Share of the rooms without noise that have to be exact, at least."""

OBJECTIVE_SLACK, METRIC_RATIO = 1e-3, 1.02
"""With noise: objective of a second-order solver over the mark, less 1, and mean error of `auto`
over that of `lbfgsb`, at most."""

ROUNDING = 1e-6
"""Two fits are level if their objectives differ by no more than float32 sums can."""

WORST_COLUMN = 1.25
"""Error of `auto` over that of the paper's recipe in any column of table1, at most."""

PRIORS_METRICS = ("clean", "albedo", "metallic", "relight")
"""What must be no worse with priors; roughness has a limit of its own."""

NOISE_METRICS = ("albedo", "albedo_scaled", "roughness", "metallic", "relight")

RESIDUAL = "residual relative to the pictures' RMS"

GROUPS: dict[str, dict[str, dict[str, object]]] = {
    "exact": {"rooms without noise": {}},
    "noise": {f"noise {level:g}": {"noise": level} for level in comparisons.LEVELS},
    "gap": {
        BY_KEY[row].name: {"variant": row} for row in (*comparisons.ROWS, *comparisons.CYCLES_ROWS)
    },
    "priors": {name: {"variant": name} for name in comparisons.PRIORS_CASES},
}
"""Cases that are looked at together, by part: what they are called, and their attributes."""

SHOWN: dict[str, tuple[dict[str, str], Sequence[str]]] = {
    "exact": (
        {name: name for name in exact.FITS},
        ("exact", "recon", "worst_map", "seconds"),
    ),
    "noise": (
        {name: name for name in comparisons.NOISE_FITS},
        ("above_mark", "recon", *NOISE_METRICS, "seconds"),
    ),
    "gap": ({"auto": "auto", "paper": "lbfgsb, paper's recipe"}, COLUMNS),
    "priors": (
        {"default": "auto, default priors", "none": "auto, no priors"},
        ("recon", "roughness", *PRIORS_METRICS),
    ),
}
"""Fits with what they are called, and metrics, by part. The mean of "exact" is the share of rooms;
"above_mark" is the objective over the mark, less 1."""

Of = Results[Case]


def part(
    name: str,
    title: str,
    cases: Callable[[Any], Sequence[Any]],
    run: Callable[[Any, int], Mapping[str, Any]],
    verdicts: Callable[[Results[Any]], Iterator[Verdict]],
    figures: Callable[[Results[Any]], Sequence[Row]] | None = None,
    shown: Callable[[Results[Any]], Section] = lambda _: Section(""),
    **more: Any,
) -> Part[Any]:
    """A part; its functions see results of which some are finished. Rows are means by default."""

    def rows(results: Results[Any]) -> Sequence[Row]:
        if results.finished:
            return figures(results) if figures else means(name, results)
        return [Row(name, 0, None, {}, status=results.status())] if results.pairs else []

    def sections(results: Results[Any], found: Sequence[Row]) -> Sequence[Section]:
        also = shown(results) if results.finished else Section("")
        return [Section(title, also.text, [Table.of(found), *also.tables], also.figures)]

    return Part(
        name,
        cases,
        run,
        rows,
        verdicts=lambda results, _: verdicts(results) if results.finished else (),
        sections=sections,
        csvs=lambda results, _: {"scenes.csv": numbers_csv(name, results)},
        **more,
    )


def _groups(part: str, results: Of) -> Iterator[tuple[str, Of]]:
    for name, facts in GROUPS[part].items():
        if (of := results.of(**facts)).finished:
            yield name, of


def means(part: str, results: Of) -> list[Row]:
    """Means over the cases of a group, a row a fit."""
    fits, metrics = SHOWN[part]
    return [
        Row(group, len(of.finished), name, of.metrics(metrics, fit))
        for group, of in _groups(part, results)
        for fit, name in fits.items()
    ]


def _ratios(of: Of, ours: str, other: str, metrics: Sequence[str]) -> dict[str, float]:
    """Ratios of the mean errors of two fits; metrics that a scene lacks are left out."""
    pairs = {metric: [of.numbers(fit, metric) for fit in (ours, other)] for metric in metrics}
    return {
        metric: float(np.mean(pair[0]) / np.mean(pair[1]))
        for metric, pair in pairs.items()
        if all(len(numbers) == len(of.finished) for numbers in pair)
    }


def _worst(what: str, ratios: Mapping[str, float], bar: float) -> Verdict:
    """The largest ratio and which one it is."""
    worst = max(ratios, key=lambda name: ratios[name])
    return Verdict(what, ratios[worst], bar, worst.replace("_", ", "))


def _highest(what: str, above: Mapping[str, float], bar: float) -> Verdict:
    """The largest figure of any scene, and how many are above the bar."""
    worst = max(above, key=lambda scene: above[scene])
    where = f"{worst}; above in {sum(value > bar for value in above.values())} of {len(above)}"
    return Verdict(what, above[worst], bar, where)


# ----------------------------------------------------------------------------------------- exact


def exact_verdicts(results: Of) -> Iterator[Verdict]:
    """Enough rooms are exact; `auto` is never above `lbfgsb`."""
    found = results.finished
    for name, (_, bound) in exact.FITS.items():
        if name == "lbfgsb":
            continue
        missed = [str(case.seed) for case, values in found if not values[name]["exact"]]
        pictures = "float32" if bound == exact.RECON_FLOAT32 else "float64"
        yield Verdict(
            f"{name.partition(',')[0]}: rooms of {len(found)} that are exact, {pictures} pictures",
            len(found) - len(missed),
            math.ceil(EXACT_SHARE * len(found) - 1e-9),
            f"not: {', '.join(missed)}" if missed else "",
            at_least=True,
        )
    above = {f"seed {case.seed}": v["auto"]["recon"] / v["lbfgsb"]["recon"] for case, v in found}
    yield _highest("auto's residual over lbfgsb's", above, 1.0)


def exact_shown(results: Of) -> Section:
    """Rooms that a second-order solver misses, with the worst pixel; every room as a plot."""
    missed = []
    for case, values in results.finished:
        for name in exact.FITS:
            run = values[name]
            if name != "lbfgsb" and not run["exact"]:
                wrong = {key: n for key, n in run["wrong"].items() if key != "worst"}
                worst = {f"worst_{key}": value for key, value in run["wrong"]["worst"].items()}
                errors = {key: run[key] for key in ("recon", *exact.MAPS)}
                missed.append(Row(f"seed {case.seed}", 0, name, errors | wrong | worst))
    seeds = [case.seed for case, _ in results.finished]
    bars = [Mark(exact.RECON_FLOAT32, "float32"), Mark(exact.RECON_FLOAT64, "float64")]
    shown = (("recon", RESIDUAL, bars), ("worst_map", "worst map's RMSE", [Mark(exact.MATERIAL)]))
    panels = []
    for metric, label, marks in shown:
        of = {name: [max(1e-17, n) for n in results.numbers(name, metric)] for name in exact.FITS}
        series = [Series(name, seeds, numbers) for name, numbers in of.items()]
        panels.append(Panel("points", series, "seed of the room", label, log="y", marks=marks))
    caption = "Rooms that are not exact: errors, wrong pixels by kind, and the worst of them."
    return Section(
        "",
        tables=[Table.of(missed, caption=caption)] if missed else [],
        figures=[Plot("exact", "Every room, by seed.", panels, share_x="all", size=(11, 3))],
    )


# --------------------------------------------------------------------- noise, start, gap, priors


def noise_verdicts(results: Of) -> Iterator[Verdict]:
    """Objectives are near the mark, and maps no worse than L-BFGS-B's."""
    for group, of in _groups("noise", results):
        for solver in ("auto", "gauss-newton"):
            above = {f"seed {case.seed}": v[solver]["above_mark"] for case, v in of.finished}
            what = f"{solver}, {group}: objective over the mark, less 1"
            yield _highest(what, above, OBJECTIVE_SLACK)
        for suffix in ("", ", priors"):
            ratios = _ratios(of, f"auto{suffix}", f"lbfgsb{suffix}", NOISE_METRICS)
            what = f"auto over lbfgsb, {group}{suffix or ', no priors'}: worst mean error"
            yield _worst(what, ratios, METRIC_RATIO)


def _over(values: Mapping[str, Any], setting: str) -> float:
    return float(values[setting]["auto"] / values[setting]["lbfgsb"])


def start_rows(results: Of) -> list[Row]:
    """A row a kind of scene and level of noise: the largest ratio of each setting."""
    levels = [{"variant": k, "noise": n} for k in comparisons.KINDS for n in comparisons.NOISES]
    return [
        Row(
            f"{facts['variant']}, noise {facts['noise']}",
            len(found),
            None,
            {name: max(_over(v, name) for _, v in found) for name in comparisons.SETTINGS},
        )
        for facts in levels
        if (found := results.of(**facts).finished)
    ]


def start_verdicts(results: Of) -> Iterator[Verdict]:
    """`auto` is never above `lbfgsb`."""
    for name in comparisons.SETTINGS:
        above = {
            case.key.removeprefix("start_"): _over(values, name) - 1
            for case, values in results.finished
        }
        yield _highest(f"auto's objective over lbfgsb's, less 1: {name}", above, ROUNDING)


def gap_rows(results: Of) -> list[Row]:
    """A row a setup and fit; setups that were not run say why."""
    rows = means("gap", results)
    if results.options.cycles_scenes > 0 and (why := cycles.why_not()):
        names = [BY_KEY[row].name for row in comparisons.CYCLES_ROWS]
        rows += [Row(name, 0, None, {}, status=f"not run: {why}") for name in names]
    return rows


def gap_verdicts(results: Of) -> Iterator[Verdict]:
    """`auto` explains the pictures better, and no column is much worse."""
    for name, of in _groups("gap", results):
        ratios = _ratios(of, "auto", "paper", COLUMNS)
        mean = float(np.exp(np.mean(np.log(list(ratios.values())))))
        yield Verdict(f"{name}: recon over the paper's recipe's", ratios["recon"], 1.0)
        yield Verdict(f"{name}: geometric mean of the columns' ratios", mean, 1.0)
        yield _worst(f"{name}: worst column", ratios, WORST_COLUMN)


def gap_shown(results: Of) -> Section:
    """Ratios as a plot."""
    of = {name: _ratios(o, "auto", "paper", COLUMNS) for name, o in _groups("gap", results)}
    series = []
    for column in COLUMNS:
        there = {name: ratios[column] for name, ratios in of.items() if column in ratios}
        series.append(Series(column, list(there.values()), list(there)))
    label = "error of auto / error of the paper's recipe"
    panel = Panel("dots", series, label, log="x", marks=[Mark(WORST_COLUMN, axis="x")])
    caption = "Ratio of mean errors: left of 1 “auto” is better; dotted the bar of a column."
    return Section("", figures=[Plot("gap", caption, [panel], size=(8.5, 1 + 0.5 * len(of)))])


def priors_verdicts(results: Of) -> Iterator[Verdict]:
    """Priors make roughness much better, and nothing worse."""
    for name, of in _groups("priors", results):
        limit = comparisons.PRIORS_CASES[name]
        [ratio] = _ratios(of, "default", "none", ["roughness"]).values()
        where = f"rooms: {len(of.finished)}"
        yield Verdict(f"{name}: roughness over that without priors", ratio, limit, where)
        ratios = _ratios(of, "default", "none", PRIORS_METRICS)
        yield _worst(f"{name}: worst other error over that without", ratios, 1.0)


# ---------------------------------------------------------------------------------- race, memory

Runs = Mapping[str, Mapping[str, Any]]
"""What runners found on a scene, by key."""


def _races(results: Results[race.Task]) -> dict[int, Runs]:
    """By seed."""
    seeds = dict.fromkeys(task.seed for task, _ in results.finished)
    return {s: {task.runner: v for task, v in results.of(seed=s).finished} for s in seeds}


def _reached(values: Mapping[str, Any]) -> float:
    """Seconds to the mark; the paper's recipe makes it at its end."""
    found = values["seconds"] if values["is_mark"] else values["reached"]
    return math.inf if found is None else float(found)


def speed(runs: Runs, solver: str, other: str) -> tuple[float, bool]:
    """How many times sooner a solver had reached the mark, 0 if it never did; NaN if unknown.

    `other` is "torch", or "lbfgsb" for the sooner of ours, as it is or by the recipe. True if the
    other never did: then its seconds are those after which it was given up.
    """
    others = ("paper", "lbfgsb") if other == "lbfgsb" else (other,)
    there = [runs[key] for key in others if key in runs]
    if solver not in runs or not there:
        return math.nan, False
    seconds = min(map(_reached, there))
    if math.isfinite(seconds):
        return seconds / _reached(runs[solver]), False
    return max(values["seconds"] for values in there) / _reached(runs[solver]), True


def race_rows(results: Results[race.Task]) -> list[Row]:
    """A row a scene and runner; runners that were not run say why."""
    rows = []
    for seed, runs in _races(results).items():
        for runner, values in runs.items():
            metrics = {
                "seconds_to_the_mark": _reached(values),
                "recon": values["residual"] / values["pictures_rms"],
                "objective_over_the_mark": (values["residual"] / runs["paper"]["residual"]) ** 2,
                **{key: values[key] for key in ("seconds", "evaluations")},
            }
            if runner in ("gauss-newton", "auto"):
                for other in ("lbfgsb", "torch"):
                    metrics[f"times_sooner_than_{other}"] = speed(runs, runner, other)[0]
            status = "ok" if math.isfinite(_reached(values)) else "never reached the mark"
            rows.append(Row(f"race, seed {seed}", 1, race.NAMES[runner], metrics, status=status))
    why_not = {name: race.missing(runner) for runner, name in race.NAMES.items()}
    return rows + [
        Row("race", 0, name, {}, status=f"not run: {why}") for name, why in why_not.items() if why
    ]


def race_verdicts(results: Results[race.Task]) -> Iterator[Verdict]:
    """Second-order solvers are there much sooner."""
    for solver in ("gauss-newton", "auto"):
        for other, bar in (("lbfgsb", race.OVER_LBFGSB), ("torch", race.OVER_TORCH)):
            speeds = {seed: speed(runs, solver, other) for seed, runs in _races(results).items()}
            ratios = [ratio for ratio, _ in speeds.values() if not math.isnan(ratio)]
            if not ratios:
                continue
            where = f"from {min(ratios):.3g} to {max(ratios):.3g}"
            if never := [str(seed) for seed, (_, bounded) in speeds.items() if bounded]:
                where += f"; {other} never reached it on {', '.join(never)}: at least so much"
            what = f"{solver}: times sooner at the mark than {other}, median of {len(ratios)}"
            yield Verdict(what, float(np.median(ratios)), bar, where, at_least=True)


def race_shown(results: Results[race.Task]) -> Section:
    """Residual against time, a panel a scene."""
    panels = []
    for seed, runs in _races(results).items():
        rms = runs["paper"]["pictures_rms"]
        series = []
        for runner, values in runs.items():
            seconds, _, residuals = zip(*values["points"], strict=True)
            x, y = np.maximum(seconds, 1e-2), np.divide(residuals, rms)
            look = list(race.NAMES).index(runner)
            series.append(Series(race.NAMES[runner], list(x), list(y), look=look))
        mark = Mark(runs["paper"]["residual"] / rms, "the mark")
        title = f"seed {seed}"
        panels.append(
            Panel("lines", series, "seconds", RESIDUAL, title=title, log="xy", marks=[mark])
        )
    caption = "Residual over all pixels against wall time. The paper's recipe ends at the mark."
    return Section("", figures=[Plot("race", caption, panels, share_x="all", size=(11, 3.4))])


def memory_rows(results: Results[memory.Task]) -> list[Row]:
    """A row a fit."""
    names = ("pictures_mib", "peak_mib", "peak_over_pictures", "seconds")
    return [
        Row(f"memory, {task.size}²", 1, task.solver, {name: values[name] for name in names})
        for task, values in results.finished
    ]


def memory_verdicts(results: Results[memory.Task]) -> Iterator[Verdict]:
    """Peaks are small beside the pictures."""
    for task, values in results.finished:
        bar, peak = memory.BARS.get(task.solver), values["peak_mib"]
        if peak is None or bar is None:
            continue
        name, ratio = f"{task.solver}, {task.size}²", values["peak_over_pictures"]
        yield Verdict(f"{name}: peak over the pictures' own bytes", ratio, bar, f"{peak:.0f} MiB")
        if task.size**2 >= 4e6:
            yield Verdict(f"{name}: GiB at the peak", peak / 1024, memory.LARGE_GIB)
