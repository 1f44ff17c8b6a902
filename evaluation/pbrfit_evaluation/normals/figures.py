"""Rows, verdicts and plots of the parts; what each must reach is in docs/benchmarks/normals.md."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from pbrfit.commands.arguments import value
from pbrfit_evaluation.grid.figures import Bar, Metrics, Of, by_seed, grid_rows, of_bars, of_most
from pbrfit_evaluation.normals.measure import (
    DISTURBANCES,
    PARTS,
    REFINE,
    TRUE,
    cases,
    grid_of,
    is_exact,
    run,
    turn_of,
)
from pbrfit_evaluation.options import Setting, count, first_seed, several, threads
from pbrfit_evaluation.plots import draw, dress, mark, panels, png
from pbrfit_evaluation.scores import MAPS
from pbrfit_evaluation.suite import Picture, Row, Section, Suite, Table, Verdict

MAPS_AND_RELIGHT = (*MAPS, "relight")
METRICS = ("recon", *MAPS_AND_RELIGHT)
ANGLES = ("mean", "median")

JUDGED = "auto"
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


def won_back(results: Of, condition: str, metric: str, way: str) -> float:
    """Share of what wrong normals cost in the mean that refining wins back.

    (off - refined) / (off - floor), where the floor is the fit without refinement at true normals.
    Scenes without a floor do not count. NaN where wrong normals cost nothing.
    """
    floors, held, refined = (
        by_seed(results, *of, "scores", metric)
        for of in ((TRUE, "off"), (condition, "off"), (condition, way))
    )
    seeds = floors.keys() & held.keys() & refined.keys()
    floor, off, found = (sum(of[seed] for seed in seeds) for of in (floors, held, refined))
    return (off - found) / (off - floor) if off > floor else math.nan


def angle_left(of: Of) -> float:
    """Mean angle to the true normals after a fit over that before."""
    before = of.average("given", "mean")
    return of.average("angle", "mean") / before if before else math.nan


def rows(results: Of) -> list[Row]:
    """A row a disturbance, θ and fit."""

    def more(condition: str, way: str, of: Of) -> Metrics:
        if is_exact(condition):
            came_back = {"came_back": of.average("came_back")}
            angle = {"angle_mean": of.average("angle", "mean")}
            return of.metrics(MAPS, "scores") | angle | came_back
        angles = of.metrics(ANGLES, "angle")
        metrics = of.metrics((*METRICS, "seconds"), "scores")
        metrics |= {f"angle_{angle}": value for angle, value in angles.items()}
        if way != "off" and condition != TRUE:
            for metric in MAPS_AND_RELIGHT:
                metrics[f"{metric}_won_back"] = won_back(results, condition, metric, way)
            metrics["angle_left"] = angle_left(of)
        return metrics | {"share_refined": of.average("decision", "refined")}

    return grid_rows(grid_of(results.options), results, (), more)


def verdicts(results: Of, _: object) -> Iterator[Verdict]:
    """Enough is won back, and nothing spoilt; without noise most scenes come back."""
    yield from (replace(one, part="rooms") for one in _of_rooms(results))
    for condition, title in grid_of(results.options).conditions.items():
        back = by_seed(results, condition, "on", "came_back") if is_exact(condition) else {}
        if back:
            what = f"{title}: scenes of {len(back)} that came back"
            yield of_most(what, back, math.floor(MOST * len(back)) + 1, "exact")


def _of_rooms(results: Of) -> Iterator[Verdict]:
    for condition, title in grid_of(results.options).conditions.items():
        _kind, degrees = turn_of(condition)
        of = results.of(condition=condition, way=JUDGED)
        if not of.finished or degrees not in ANGLE_LEFT:
            continue
        for metric, bar in WON_BACK[degrees].items():
            share = won_back(results, condition, metric, JUDGED)
            where = "wrong normals cost nothing, or the floor is missing" if share != share else ""
            what = f"{title}: share of the {metric} loss won back"
            yield Verdict(what, share, bar, where, at_least=True)
        refined = f"refined in {sum(of.numbers('decision', 'refined')):g} of {len(of.finished)}"
        what = f"{title}: mean angle, after over before"
        yield Verdict(what, angle_left(of), ANGLE_LEFT[degrees], refined)
    for metric in METRICS:
        what = f"true normals: {metric} with {JUDGED} over that without refinement"
        spoilt = Bar(what, (TRUE, JUDGED), (TRUE, "off"), [metric], SPOILT)
        yield from of_bars(results, [spoilt])
    of_true = results.of(condition=TRUE, way=JUDGED)
    if of_true.finished:
        what = "true normals: mean angle that is introduced, degrees"
        yield Verdict(what, of_true.average("angle", "mean"), INTRODUCED)


def sections(results: Of, rows: Sequence[Row]) -> Iterator[Section]:
    """Errors; what is won back; error against θ; scenes without noise."""
    conditions = grid_of(results.options).conditions
    exact = {title for condition, title in conditions.items() if is_exact(condition)}
    if "rooms" in results.options.part:
        yield Section(
            "Errors against the disturbance",
            "Won back is (not refined - refined) / (not refined - floor), of means over scenes; "
            "the floor is the fit without refinement at true normals. scenes.csv says why auto "
            "decided as it did.",
            [Table.of([row for row in rows if row.name not in exact])],
            [_room_plot(results)] if results.finished else [],
        )
    if "exact" in results.options.part:
        yield Section("Figures", tables=[Table.of([row for row in rows if row.name in exact])])


def _room_plot(results: Of) -> Picture:
    """A row of panels a disturbance, a panel an error, a line a fit."""
    conditions = [one for one in grid_of(results.options).conditions if not is_exact(one)]
    paths = {f"{m}, RMSE": ("scores", m) for m in MAPS_AND_RELIGHT}
    paths["mean angle, degrees"] = ("angle", "mean")
    kinds = dict.fromkeys(turn_of(one)[0] for one in conditions if one != TRUE)
    of_panels = [(kind, title) for kind in kinds for title in paths]
    figure, grid = panels(len(of_panels), len(paths), (2.9, 2.7), sharex="all", sharey="col")
    for axes, (kind, title) in zip(grid, of_panels, strict=True):
        # Turns of 0 degrees are the same whatever they are called.
        shown = [one for one in conditions if turn_of(one)[0] in (kind, TRUE)]
        for place, (way, refine) in enumerate(REFINE.items()):
            found = {
                turn_of(one)[1]: values
                for one in shown
                if (values := results.of(condition=one, way=way).numbers(*paths[title]))
            }
            low, high = ([float(np.percentile(v, p)) for v in found.values()] for p in (10, 90))
            means = [float(np.mean(values)) for values in found.values()]
            draw(axes, list(found), means, place, refine.words, low=low, high=high)
        floor = results.of(condition=TRUE, way="off").average(*paths[title])
        if floor == floor:
            mark(axes, floor, "floor")
        dress(axes, "θ of the disturbance, degrees", f"{kind}: error", title)
    caption = "Means over scenes; bands from the 10th to the 90th percentile of scenes."
    return Picture("normals", caption, png(figure))


SUITE = Suite(
    name="normals",
    title="Wrong normals, refined",
    protocol="pbrfit-normals-1, {effort}",
    cases=cases,
    run=run,
    rows=rows,
    verdicts=verdicts,
    sections=sections,
    settings={
        "part": several("NAME", PARTS, what="only these parts"),
        "threads": threads,
        "disturbances": several("KIND", DISTURBANCES),
        "degrees": Setting(
            (1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 25.0),
            (10.0,),
            value(
                "THETA",
                float,
                "sizes of the disturbance (default: 1 2 5 10 15 20 25, with --quick 10); true "
                "normals are always there",
                nargs="+",
            ),
        ),
        "scenes": count("K", "rooms", 12, 2),
        "size": count("PIXELS", "of the rooms' pictures", 128, 32),
        "iterations": count("K", "of a fit", 500, 100),
        "first_seed": first_seed("room", 7000),
    },
    about=(
        "What wrong normals cost, and how much of it comes back when they are refined together "
        "with materials and lights: scenes whose ground truth is known, their normals disturbed "
        "by 1 to 25 degrees, with noise and without. docs/benchmarks/normals.md says what each "
        "part measures, and what must hold. Judged is “auto”, the default; without noise “on”.",
    ),
    timed=True,
)
