"""Rows, verdicts and plots of the parts; what each must reach is in docs/benchmarks/normals.md."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from pbrfit.result.refinement import RefineNormals
from pbrfit_evaluation.normals.measure import MAPS, REFINE, Case
from pbrfit_evaluation.suite import (
    Column,
    Mark,
    Panel,
    Plot,
    Results,
    Row,
    Section,
    Series,
    Table,
    Verdict,
    digits,
)

MAPS_AND_RELIGHT = (*MAPS, "relight")
METRICS = ("recon", *MAPS_AND_RELIGHT)
ANGLES = ("mean", "median", "aligned")

LABELS: dict[RefineNormals, str] = {
    "off": "not refined",
    "auto": "refined where it is decided to (auto)",
    "on": "refined (on)",
}
"""What fits are called."""

JUDGED: RefineNormals = "auto"
"""What people get who say nothing."""

WON_BACK: dict[float, dict[str, float]] = {
    5.0: {"albedo": 0.85, "roughness": 0.85, "metallic": 0.60, "relight": 0.85},
    10.0: {"albedo": 0.85, "roughness": 0.85, "metallic": 0.60, "relight": 0.85},
    20.0: dict.fromkeys(MAPS_AND_RELIGHT, 0.5),
}
"""Least share of the loss that is won back, by θ."""

ANGLE_LEFT = {5.0: 0.25, 10.0: 0.25, 20.0: 0.5}
"""Mean angle after refining over that before, at most, by θ."""

SPOILT = 1.03
"""Errors with true normals over those without refinement, at most."""

INTRODUCED = 0.3
"""Mean angle in degrees between refined and true normals where the true ones are given, at most."""

MOST = 0.5
"""More than this share of the scenes without noise must come back."""

Rooms = Results[Case]


# ----------------------------------------------------------------------------------------- rooms


def _of(results: Rooms) -> Iterator[tuple[str, float, Rooms]]:
    """Scenes under each disturbance, those with true normals first."""
    cases = dict.fromkeys((case.disturbance, case.degrees) for case, _ in results.finished)
    kinds = list(dict.fromkeys(kind for kind, _ in cases))
    for kind, degrees in sorted(cases, key=lambda case: (kinds.index(case[0]), case[1])):
        yield kind, degrees, results.of(disturbance=kind, degrees=degrees)


def _errors(results: Rooms, refine: RefineNormals, metric: str) -> dict[tuple[str, int], float]:
    """By kind and seed of the scene."""
    return {(c.scene, c.seed): float(v[refine]["scores"][metric]) for c, v in results.finished}


def won_back(
    results: Rooms, disturbance: str, degrees: float, metric: str, refine: RefineNormals
) -> tuple[float, float]:
    """Share of what wrong normals cost that refining wins back: of means, and median of scenes.

    (off - refined) / (off - floor), where the floor is the fit without refinement at true normals.
    Scenes without a floor do not count. NaN where wrong normals cost nothing.
    """
    of_case = results.of(disturbance=disturbance, degrees=degrees)
    floors = _errors(results.of(disturbance="true"), "off", metric)
    held, refined = (_errors(of_case, fit, metric) for fit in ("off", refine))
    scenes = [scene for scene in held if scene in floors]
    if not scenes:
        return math.nan, math.nan
    off, found, floor = (np.array([of[s] for s in scenes]) for of in (held, refined, floors))
    lost = off > floor
    median = np.median((off - found)[lost] / (off - floor)[lost]) if lost.any() else math.nan
    if off.mean() <= floor.mean():
        return math.nan, float(median)
    share = (off.mean() - found.mean()) / (off.mean() - floor.mean())
    return float(share), float(median)


def room_rows(results: Rooms) -> list[Row]:
    """A row a disturbance, θ and fit."""
    rows = []
    for kind, degrees, of in _of(results):
        name = of.finished[0][0].in_words
        for refine in REFINE:
            metrics = of.metrics((*METRICS, "seconds"), refine, "scores")
            angles = of.metrics(ANGLES, refine, "angle")
            metrics |= {f"angle_{angle}": value for angle, value in angles.items()}
            if refine != "off" and degrees:
                for metric in MAPS_AND_RELIGHT:
                    share, _ = won_back(results, kind, degrees, metric, refine)
                    metrics[f"{metric}_won_back"] = share
                metrics["angle_left"] = of.average(refine, "angle", "mean") / of.average(
                    "given", "mean"
                )
            metrics["share_refined"] = of.average(refine, "decision", "refined")
            rows.append(Row(name, len(of.finished), LABELS[refine], metrics))
    return rows


def room_verdicts(results: Rooms, _: object) -> Iterator[Verdict]:
    """Enough is won back, and nothing spoilt."""
    for kind, degrees, of in _of(results):
        case = f"{kind} {degrees:g}°"
        count = len(of.finished)
        for metric, bar in WON_BACK.get(degrees, {}).items():
            share, median = won_back(results, kind, degrees, metric, JUDGED)
            where = f"median of scenes {digits(median)}"
            if math.isnan(share):
                where = "wrong normals cost nothing here, or the floor is missing"
            what = f"{case}: share of the {metric} loss won back"
            yield Verdict(what, share, bar, where, at_least=True)
        if degrees in ANGLE_LEFT:
            before, after = of.average("given", "mean"), of.average(JUDGED, "angle", "mean")
            refined = sum(of.numbers(JUDGED, "decision", "refined"))
            where = f"{before:.1f}° before, {after:.2f}° after, refined in {refined:g} of {count}"
            what = f"{case}: mean angle, after over before"
            yield Verdict(what, after / before, ANGLE_LEFT[degrees], where)
    of_true = results.of(disturbance="true")
    if not of_true.finished:
        return
    for metric in METRICS:
        held, refined_to = (_errors(of_true, fit, metric) for fit in ("off", JUDGED))
        ratios = {scene: refined_to[scene] / held[scene] for scene in held}
        kind, seed = max(ratios, key=lambda scene: ratios[scene])
        mean = float(np.mean(list(refined_to.values())) / np.mean(list(held.values())))
        where = f"worst scene {kind} {seed}: {digits(ratios[kind, seed])}"
        what = f"true normals: {metric} with {JUDGED} over that without refinement"
        yield Verdict(what, mean, SPOILT, where)
    seeds = [str(case.seed) for case, v in of_true.finished if v[JUDGED]["decision"]["refined"]]
    where = f"refined: {', '.join(seeds)}" if seeds else "refined none"
    what = "true normals: mean angle that is introduced, degrees"
    yield Verdict(what, of_true.average(JUDGED, "angle", "mean"), INTRODUCED, where)


def room_sections(results: Rooms, rows: Sequence[Row]) -> Iterator[Section]:
    """Errors; what is won back; error against θ."""
    shares = [f"{metric}_won_back" for metric in MAPS_AND_RELIGHT]
    angles = [Column(f"angle_{angle}", f"angle, {angle},\ndegrees") for angle in ANGLES]
    fitted = [row for row in rows if "angle_left" in row.metrics]
    plots = [_room_plot(results)] if results.finished else []
    yield Section(
        "Errors against the disturbance",
        "“Aligned” is the mean angle after the best turn of all normals together. Won back is "
        "(not refined - refined) / (not refined - floor), of means over scenes; the floor is the "
        "fit without refinement at true normals. scenes.csv says why auto decided as it did.",
        [
            Table.of(rows, [*METRICS, *angles, "seconds"]),
            Table.of(fitted, [*shares, Column("angle_left", "residual angle"), "share_refined"]),
        ],
        plots,
    )


def _room_plot(results: Rooms) -> Plot:
    """A row of panels a disturbance, a panel an error, a line a fit."""
    cases = list(_of(results))
    paths = {f"{m}, RMSE": ("scores", m) for m in MAPS_AND_RELIGHT}
    paths["mean angle, degrees"] = ("angle", "mean")
    panels = []
    for kind in dict.fromkeys(kind for kind, _, _ in cases if kind != "true"):
        # Turns of 0 degrees are the same whatever they are called.
        shown = [(theta, of) for name, theta, of in cases if name in (kind, "true")]
        thetas = [theta for theta, _ in shown]
        for title, path in paths.items():
            series = []
            for look, refine in enumerate(REFINE):
                values = [of.numbers(refine, *path) for _, of in shown]
                low, high = ([float(np.percentile(v, p)) for v in values] for p in (10, 90))
                means = [float(np.mean(v)) for v in values]
                series.append(Series(LABELS[refine], thetas, means, low=low, high=high, look=look))
            floors = [float(np.mean(of.numbers("off", *path))) for theta, of in shown if not theta]
            x, y = "θ of the disturbance, degrees", f"{kind}: error"
            marks = [Mark(floor, "floor") for floor in floors]
            panels.append(Panel("lines", series, x, y, title=title, marks=marks))
    caption = "Means over scenes; bands from the 10th to the 90th percentile of scenes."
    return Plot(
        "normals",
        caption,
        panels,
        columns=len(paths),
        share_x="all",
        share_y="col",
        size=(2.9, 2.7),
    )


# ----------------------------------------------------------------------------------------- exact


def exact_rows(results: Rooms) -> list[Row]:
    """A row a scene."""
    rows = []
    for case, values in results.finished:
        on = values["on"]
        metrics = {name: on["scores"][name] for name in MAPS}
        metrics |= {f"angle_{name}": on["angle"][name] for name in ("mean", "aligned")}
        status = "ok" if values["came_back"] else "did not come back"
        name = f"no noise, {case.in_words}, {case.scene} {case.seed}"
        rows.append(Row(name, 1, LABELS["on"], metrics, status=status))
    return rows


def exact_verdicts(results: Rooms, _: object) -> Iterator[Verdict]:
    """Most scenes come back."""
    for _kind, _degrees, of in _of(results):
        found = of.finished
        missed = [f"{case.scene} {case.seed}" for case, v in found if not v["came_back"]]
        yield Verdict(
            f"{found[0][0].in_words}, no noise: scenes of {len(found)} that came back",
            len(found) - len(missed),
            math.floor(MOST * len(found)) + 1,
            f"not: {', '.join(missed)}" if missed else "",
            at_least=True,
        )


def exact_sections(_: Rooms, rows: Sequence[Row]) -> list[Section]:
    """The table."""
    return [Section("Without noise", tables=[Table.of(rows)])]
