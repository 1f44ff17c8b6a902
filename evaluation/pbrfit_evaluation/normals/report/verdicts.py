"""What refining normals must reach, and whether it does."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from pbrfit.result.refinement import RefineNormals
from pbrfit_evaluation.normals import Measured, Part, cost, exact
from pbrfit_evaluation.normals.rooms import MAPS_AND_RELIGHT, METRICS, TRUE
from pbrfit_evaluation.verdicts import Verdict, digits

Values = Mapping[str, Any]
Found = Sequence[tuple[Any, Values]]

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
"""Mean angle in degrees between refined and true normals where the true ones are given; below."""

MOST = 0.5
"""More than this share of the scenes without noise must come back."""


def verdicts(measured: Measured) -> list[Verdict[Part]]:
    """All that can be said of the parts that were run."""
    of_part: dict[Part, Callable[[Measured], Iterator[Verdict[Part]]]] = {
        "rooms": _rooms,
        "exact": _exact,
        "cost": _cost,
    }
    return [
        verdict
        for part, judged in of_part.items()
        if measured.finished(part)
        for verdict in judged(measured)
    ]


# ----------------------------------------------------------------------------------------- rooms


def at(found: Found, disturbance: str, degrees: float = 0.0) -> list[tuple[Any, Values]]:
    """Scenes under one disturbance."""
    return [
        pair for pair in found if (pair[0].disturbance, pair[0].degrees) == (disturbance, degrees)
    ]


def errors(found: Found, refine: RefineNormals, metric: str) -> dict[tuple[str, int], float]:
    """Of every scene of `found`, by kind and seed."""
    return {
        (task.scene, task.seed): float(values[refine]["scores"][metric]) for task, values in found
    }


def won_back(
    found: Found, disturbance: str, degrees: float, metric: str, refine: RefineNormals
) -> tuple[float, float]:
    """Share of what wrong normals cost that refining wins back: of means, and median of scenes.

    (off - refined) / (off - floor), where the floor is the fit without refinement at true normals.
    Scenes without a floor do not count. NaN where wrong normals cost nothing.
    """
    of_case = at(found, disturbance, degrees)
    floors = errors(at(found, TRUE), "off", metric)
    held, refined = errors(of_case, "off", metric), errors(of_case, refine, metric)
    scenes = [scene for scene in held if scene in floors]
    if not scenes:
        return math.nan, math.nan
    off, found_errors, floor = (
        np.array([of[scene] for scene in scenes]) for of in (held, refined, floors)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = (off - found_errors) / (off - floor)
    lost = off > floor
    median = float(np.median(shares[lost])) if lost.any() else math.nan
    if off.mean() <= floor.mean():
        return math.nan, median
    return float((off.mean() - found_errors.mean()) / (off.mean() - floor.mean())), median


def mean_angle(found: Found, refine: RefineNormals | None = None) -> float:
    """Mean over scenes of the mean angle, of given normals or after a fit; NaN of no scene."""
    values = [v["given"] if refine is None else v[refine]["angle"] for _, v in found]
    return float(np.mean([value["mean"] for value in values])) if values else math.nan


def _rooms(measured: Measured) -> Iterator[Verdict[Part]]:
    found = measured.finished("rooms")
    for kind in dict.fromkeys(task.disturbance for task, _ in found if task.disturbance != TRUE):
        for degrees, bars in WON_BACK.items():
            of_case = at(found, kind, degrees)
            if not of_case:
                continue
            for metric, bar in bars.items():
                share, median = won_back(found, kind, degrees, metric, JUDGED)
                yield Verdict(
                    "rooms",
                    f"{kind} {degrees:g}°: share of the {metric} loss won back",
                    share,
                    bar,
                    f"median of scenes {digits(median)}"
                    if math.isfinite(share)
                    else "wrong normals cost nothing here, or the floor is missing",
                    at_least=True,
                )
            before, after = mean_angle(of_case), mean_angle(of_case, JUDGED)
            refined = sum(values[JUDGED]["decision"]["refined"] for _, values in of_case)
            yield Verdict(
                "rooms",
                f"{kind} {degrees:g}°: mean angle, after over before",
                after / before,
                ANGLE_LEFT[degrees],
                f"{before:.1f}° before, {after:.2f}° after, refined in {refined} of {len(of_case)}",
            )
    of_true = at(found, TRUE)
    if not of_true:
        return
    for metric in METRICS:
        ratio, worst = spoilt(of_true, metric)
        yield Verdict(
            "rooms",
            f"true normals: {metric} with {JUDGED} over that without refinement",
            ratio,
            SPOILT,
            worst,
        )
    seeds = [str(task.seed) for task, values in of_true if values[JUDGED]["decision"]["refined"]]
    yield Verdict(
        "rooms",
        "true normals: mean angle that is introduced, degrees",
        mean_angle(of_true, JUDGED),
        INTRODUCED,
        f"refined: {', '.join(seeds)}" if seeds else f"refined none of {len(of_true)}",
    )


def spoilt(of_true: Found, metric: str) -> tuple[float, str]:
    """Mean error with refinement over that without, at true normals; and the worst scene's."""
    held, refined = errors(of_true, "off", metric), errors(of_true, JUDGED, metric)
    ratios = {scene: refined[scene] / held[scene] for scene in held}
    worst = max(ratios, key=lambda scene: ratios[scene])
    mean = float(np.mean(list(refined.values())) / np.mean(list(held.values())))
    return mean, f"worst scene {worst[0]} {worst[1]}: {digits(ratios[worst])}"


# ------------------------------------------------------------------------------------ exact, cost


def _exact(measured: Measured) -> Iterator[Verdict[Part]]:
    found = measured.finished("exact")
    for kind in dict.fromkeys(task.disturbance for task, _ in found):
        of_kind = [pair for pair in found if pair[0].disturbance == kind]
        missed = [
            f"{task.scene} {task.seed}" for task, values in of_kind if not exact.came_back(values)
        ]
        yield Verdict(
            "exact",
            f"{kind} {exact.DEGREES:g}°, no noise: scenes of {len(of_kind)} that came back",
            len(of_kind) - len(missed),
            math.floor(MOST * len(of_kind)) + 1,
            f"not: {', '.join(missed)}" if missed else "",
            at_least=True,
        )


def _cost(measured: Measured) -> Iterator[Verdict[Part]]:
    found = measured.finished("cost")
    for task, values in found:
        off, refined = cost.medians(values)
        where = f"{off:.1f} s and {refined:.1f} s, medians of {len(values['off'])}"
        times = refined / off
        if values["refined"] != (task.case == "refined"):
            where += "; was refined" if values["refined"] else "; nothing was refined"
            times = times if values["refined"] else math.nan  # what was not done costs nothing
        yield Verdict(
            "cost",
            f"{task.case}, {task.size}²: seconds over those without refinement",
            times,
            cost.TIMES,
            where,
        )
    exponent = cost.exponent(*refined_seconds(found))
    if math.isfinite(exponent):
        yield Verdict("cost", "refined: exponent of seconds over pixels", exponent, cost.EXPONENT)


def refined_seconds(found: Found) -> tuple[list[float], list[float]]:
    """Pixels and median seconds of fits that refined, by size."""
    pairs = sorted(
        (float(values["pixels"]), cost.medians(values)[1])
        for task, values in found
        if task.case == "refined"
    )
    return [pixels for pixels, _ in pairs], [seconds for _, seconds in pairs]
