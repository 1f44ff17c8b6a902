"""Rows, verdicts, the plot and the sheet of maps; docs/everyday.md says what must hold."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from pbrfit_evaluation.everyday.disturbances import DISTURBANCES, TITLES, Disturbance
from pbrfit_evaluation.everyday.measure import CHANNELS, PICTURED, Case
from pbrfit_evaluation.jobs import Values
from pbrfit_evaluation.panels import in_lines, unpacked
from pbrfit_evaluation.suite import (
    Column,
    Mark,
    Panel,
    Picture,
    Plot,
    Results,
    Row,
    Section,
    Series,
    Table,
    Verdict,
    digits,
)

Of = Results[Case]

MAPS = ("albedo", "roughness", "metallic")
ERRORS = (*MAPS, "relight")

REFERENCE: Disturbance = "noise"
"""What others are multiples of, but for those below."""

TWINS: dict[Disturbance, Disturbance] = {
    "jpeg-90-444": "white-90-444",
    "jpeg-90-420": "white-90-420",
    "jpeg-75-444": "white-75-444",
    "jpeg-75-420": "white-75-420",
    "fov-unknown": "fov-true",
    "fov-wrong": "fov-true",
}
"""Scenes that have the same but for what is measured, and so cost no more than it has to."""

MOST: dict[Disturbance, float] = {
    "clean": 1.02,
    "png": 1.5,
    "jpeg-90-444": 1.5,
    "jpeg-90-420": 1.5,
    "jpeg-75-444": 1.5,
    "jpeg-75-420": 1.5,
    "hot": 1.3,
    "black": 1.3,
    "clipped": 2.0,
    "brightest": 1.2,
    "shifted": 1.5,
    "another": 1.3,
    "gamma": 2.0,
    "vignetting": 2.0,
    "grey": 2.0,
    "fov-unknown": 1.2,
}
"""Mean error of the worst map over that of the reference or twin, at most."""

SLOWEST: dict[Disturbance, float] = dict.fromkeys(
    ("png", "jpeg-90-444", "jpeg-90-420", "jpeg-75-444", "jpeg-75-420"), 1.5
)
"""Processor seconds likewise."""

FOV_ERROR = 2.0
"""Degrees that an unknown field of view may be off in any scene of the kind room."""

CONTRADICTED: tuple[tuple[Disturbance, float], ...] = (("fov-wrong", 1.0), ("fov-true", 0.0))
"""Share of the scenes in which a given field of view is contradicted: at least of a wrong one, at
most of the true one."""

DEVIATIONS, COVERED = 2.0, 0.9
"""The scale's error is within so many of its standard deviations in this share of the channels of
all scenes, at least."""

SCALE_EXACT = 1e-6
"""Relative error of the scale that counts as none: pictures without noise in float32 leave some
1e-7, which is rounding and no noise."""

UNDISTURBED: tuple[Disturbance, ...] = (
    *("noise", "clean", "fov-true"),
    *(twin for twin in DISTURBANCES if twin.startswith("white")),
)


# ----------------------------------------------------------------------------------------- rows


def _measured(results: Of, disturbance: Disturbance) -> dict[tuple[str, int], Values]:
    """What was found of each scene, by kind and seed."""
    return {
        (case.kind, case.seed): values
        for case, values in results.of(disturbance=disturbance).finished
        if "not_run" not in values
    }


def _means(found: Iterable[Values]) -> dict[str, float]:
    """Mean errors and processor seconds."""
    each = [values["scores"] | {"seconds": values["seconds"]} for values in found]
    return {name: float(np.mean([of[name] for of in each])) for name in (*ERRORS, "seconds")}


def rows(results: Of) -> list[Row]:
    """A row a disturbance: mean errors, multiples, seconds, the scale, the field of view."""
    return [
        _row(results, disturbance)
        for disturbance in DISTURBANCES
        if results.of(disturbance=disturbance).pairs
    ]


def _row(results: Of, disturbance: Disturbance) -> Row:
    of = results.of(disturbance=disturbance)
    title = TITLES[disturbance]
    reasons = [values["not_run"] for _, values in of.finished if "not_run" in values]
    if reasons:
        return Row(title, 0, None, {}, status=f"not run: {reasons[0]}")
    found = _measured(results, disturbance)
    if not found:
        return Row(title, 0, None, {}, status=of.status("scenes"))
    metrics: dict[str, float | None] = {**_means(found.values())}
    twins = _measured(results, TWINS.get(disturbance, REFERENCE))
    both = [scene for scene in found if scene in twins]
    if both:
        means, of_twins = (_means(values[scene] for scene in both) for values in (found, twins))
        metrics |= {f"{name}_multiple": means[name] / of_twins[name] for name in means}
        metrics["worst_multiple"] = max(means[name] / of_twins[name] for name in MAPS)
    errors, deviations = _scale(found.values())
    metrics |= {
        "scale_error": float(np.mean(np.abs(errors))),
        "scale_deviation": float(np.mean(deviations)),
        "scale_covered": _share_covered(errors, deviations),
        "refined": float(np.mean([values["refined"] for values in found.values()])),
        "fov_error": max(values["fov"]["error"] for values in found.values()),
        "fov_contradicted": float(
            np.mean([values["fov"]["contradicted"] for values in found.values()])
        ),
    }
    return Row(title, len(found), None, metrics, status=of.status("scenes"))


def _scale(found: Iterable[Values]) -> NDArray[np.float64]:
    """(2, Q): error of the scale and its standard deviation, of all channels of all scenes."""
    pairs = [
        (values["scale"][channel]["error"], values["scale"][channel]["deviation"])
        for values in found
        for channel in CHANNELS
    ]
    return np.array(pairs, dtype=np.float64).T


def _share_covered(errors: NDArray[np.float64], deviations: NDArray[np.float64]) -> float:
    return float(np.mean(np.abs(errors) <= np.maximum(DEVIATIONS * deviations, SCALE_EXACT)))


# ------------------------------------------------------------------------------------- verdicts


def verdicts(results: Of, of_rows: Sequence[Row]) -> Iterator[Verdict]:
    """Whether each disturbance costs no more than it may."""
    by_title = {row.name: row for row in of_rows}
    for disturbance, bar in MOST.items():
        if (row := by_title.get(TITLES[disturbance])) is None:
            continue
        twin = TITLES[TWINS.get(disturbance, REFERENCE)]
        where = f"over {twin}"
        if (value := row.metrics.get("worst_multiple")) is None:
            where = row.status if row.status != "ok" else f"{twin} is missing"
        else:
            worst = max(MAPS, key=lambda name: row.metrics[f"{name}_multiple"] or 0)
            where = f"{worst}, {where}"
        yield Verdict(f"{row.name}: error of the worst map", _number(value), bar, where)
        if disturbance in SLOWEST:
            value = row.metrics.get("seconds_multiple")
            what = f"{row.name}: processor seconds"
            yield Verdict(what, _number(value), SLOWEST[disturbance], f"over {twin}")
    yield from _fov_verdicts(results)
    yield from _scale_verdicts(results)


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def _fov_verdicts(results: Of) -> Iterator[Verdict]:
    if found := _measured(results, "fov-unknown"):
        errors = {scene: values["fov"]["error"] for scene, values in found.items()}
        rooms = [error for (kind, _), error in errors.items() if kind == "room"]
        others = [error for (kind, _), error in errors.items() if kind != "room"]
        where = f"of {len(rooms)} rooms; of {len(others)} others {digits(max(others, default=0.0))}"
        what = "unknown field of view: largest error in degrees"
        yield Verdict(what, max(rooms, default=math.nan), FOV_ERROR, where)
    for disturbance, bar in CONTRADICTED:
        if found := _measured(results, disturbance):
            said = [values["fov"]["said"] for values in found.values()]
            share = float(np.mean([values["fov"]["contradicted"] for values in found.values()]))
            yield Verdict(
                f"{TITLES[disturbance]}: share of scenes in which the fit contradicts it",
                share,
                bar,
                f"such as “{said[0]}”" if said[0] else "",
                at_least=bar > 0,
            )


def _scale_verdicts(results: Of) -> Iterator[Verdict]:
    parts: dict[str, Sequence[Disturbance]] = {
        "undisturbed": UNDISTURBED,
        "disturbed": tuple(name for name in DISTURBANCES if name not in UNDISTURBED),
    }
    for part, disturbances in parts.items():
        shares = {}
        together = []
        for disturbance in disturbances:
            if found := _measured(results, disturbance):
                together.append(_scale(found.values()))
                shares[TITLES[disturbance]] = _share_covered(*together[-1])
        if together:
            share = _share_covered(*np.concatenate(together, axis=1))
            worst = min(shares, key=lambda title: shares[title])
            what = f"{part}: share of scales within two of their deviations"
            where = f"least: {worst}, {digits(shares[worst])}"
            yield Verdict(what, share, COVERED, where, at_least=True)


# ----------------------------------------------------------------------------------- what is shown


def sections(results: Of, of_rows: Sequence[Row]) -> Iterator[Section]:
    """The table, the plot, and maps."""
    if not any(row.metrics for row in of_rows):
        return
    yield Section(
        "Multiples",
        "Mean errors over those of the reference; of JPEG over those of float pictures with white "
        "noise of the same RMS, of a view 90° wide over those with the field of view known.",
        [_multiples(of_rows)],
        [_plot(of_rows)],
    )
    yield Section(
        "Errors, seconds and the scale",
        "RMSE; relight is of pictures under held-out lights, mean radiance 0.4. Seconds are of one "
        "processor. Scale: the mean error of the scale of albedo and lights, the mean of its "
        "stated deviation, and the share of channels and scenes in which the error is within two "
        "deviations.",
        [_errors(of_rows)],
    )
    maps = {case.disturbance: v["maps"] for case, v in results.finished if "maps" in v}
    if maps:
        truth = next(values["truth"] for _, values in results.finished if "truth" in values)
        kept = {"truth": truth} | {TITLES[name]: maps[name] for name in PICTURED if name in maps}
        png = in_lines({label: unpacked(panels) for label, panels in kept.items()})
        caption = (
            "One scene: a part of the picture that changed most, twice as large, and the maps that "
            "were found. The first row is the truth."
        )
        yield Section("Maps", figures=[Picture("everyday-maps", caption, png)])


def _multiples(of_rows: Sequence[Row]) -> Table:
    titles = {TITLES[name]: bar for name, bar in MOST.items()}
    columns = ["", *MAPS, "worst", "at most", "", "relight", "seconds"]
    lines = []
    for row in of_rows:
        bar, worst = titles.get(row.name), row.metrics.get("worst_multiple")
        verdict = row.status if row.status != "ok" else ""
        if bar is not None and worst is not None:
            verdict = "holds" if worst <= bar else "missed"
        line = [row.name, *(row.metrics.get(f"{name}_multiple") for name in MAPS), worst, bar]
        line += [verdict, *(row.metrics.get(f"{name}_multiple") for name in ("relight", "seconds"))]
        lines.append(line)
    return Table(columns, lines)


def _errors(of_rows: Sequence[Row]) -> Table:
    columns: list[Column | str] = [
        *ERRORS,
        "seconds",
        Column("scale_error", "scale error"),
        Column("scale_deviation", "stated"),
        Column("scale_covered", "within two"),
        Column("refined", "normals refined"),
        Column("fov_error", "field of view, largest error"),
    ]
    return Table.of([row for row in of_rows if row.metrics], columns)


LEAST = 0.5
"""Multiple below which dots are drawn at it."""


def _plot(of_rows: Sequence[Row]) -> Plot:
    """A dot a map, on a logarithmic axis, and a bar as far as it may go."""
    titles = {TITLES[name]: bar for name, bar in MOST.items()}
    shown = [row for row in of_rows if row.name in titles and "worst_multiple" in row.metrics]
    names = [row.name for row in shown]

    def series(label: str, values: Iterable[float | None], **more: object) -> Series:
        found = [max(_number(value), LEAST) for value in values]
        return Series(label, found, names, **more)  # type: ignore[arg-type]

    bars = [titles[name] for name in names]
    drawn = [
        Series("at most", bars, names, low=[LEAST] * len(bars), high=bars, look=7),
        *(series(name, (row.metrics[f"{name}_multiple"] for row in shown)) for name in MAPS),
    ]
    panel = Panel(
        *("dots", drawn, "mean error, multiple of the reference or twin"),
        log="x",
        marks=[Mark(1.0, axis="x")],
        x_range=(LEAST, None),
    )
    caption = (
        "Mean errors of the maps as multiples, and how large they may be. What is below "
        f"{LEAST:g} is drawn there."
    )
    return Plot("everyday", caption, [panel])
