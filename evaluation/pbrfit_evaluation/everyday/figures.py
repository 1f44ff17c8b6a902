"""Rows, verdicts, tables and the sheet of maps; docs/everyday.md says what must hold."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from pbrfit_evaluation.everyday.measure import DISTURBANCES, GRID, covered, run
from pbrfit_evaluation.grid.figures import Bar, Metrics, Of, grid_rows, of_bars, sheets
from pbrfit_evaluation.options import count
from pbrfit_evaluation.scores import MAPS
from pbrfit_evaluation.scores import PROTOCOL as SCORES
from pbrfit_evaluation.suite import Row, Section, Suite, Table, Verdict, digits

ERRORS = (*MAPS, "relight")

MOST: dict[str, float] = {
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

SLOWEST = 1.5
"""Processor seconds likewise, of pictures in files."""

FOV_ERROR = 2.0
"""Degrees that an unknown field of view may be off in any scene of the kind room."""

CONTRADICTED: tuple[tuple[str, float], ...] = (("fov-wrong", 1.0), ("fov-true", 0.0))
"""Share of the scenes in which a given field of view is contradicted: at least of a wrong one, at
most of the true one."""

COVERED = 0.9
"""Share of the channels of all scenes whose scale is within two deviations, at least."""

UNDISTURBED = (
    *("noise", "clean", "fov-true"),
    *(twin for twin in DISTURBANCES if twin.startswith("white")),
)


def _bars() -> Iterator[Bar]:
    for one, most in MOST.items():
        of, over = (one, "default"), (DISTURBANCES[one].twin, "default")
        beside = f"over {GRID.conditions[DISTURBANCES[one].twin]}"
        yield Bar(f"{GRID.conditions[one]}: error of the worst map {beside}", of, over, MAPS, most)
        if one == "png" or one.startswith("jpeg"):
            what = f"{GRID.conditions[one]}: processor seconds {beside}"
            yield Bar(what, of, over, ["processor"], SLOWEST)


def _covered(of: Of) -> float:
    flags = [flag for _, values in of.finished for flag in covered(values["scale"])]
    return float(np.mean(flags)) if flags else math.nan


def rows(results: Of) -> list[Row]:
    """A row a disturbance: mean errors, multiples, seconds, the scale, the field of view."""

    def more(disturbance: str, _: str, of: Of) -> Metrics:
        twin = results.of(condition=DISTURBANCES[disturbance].twin)
        multiples = {name: of.over(twin, name) for name in (*ERRORS, "processor")}
        channels = [one for _, values in of.finished for one in values["scale"].values()]
        return {
            **{name: of.average("scores", name) for name in (*ERRORS, "processor")},
            **{f"{name}_multiple": value for name, value in multiples.items()},
            "worst_multiple": max(multiples[name] for name in MAPS),
            "scale_error": float(np.mean([one["error"] for one in channels])),
            "scale_deviation": float(np.mean([one["deviation"] for one in channels])),
            "scale_covered": _covered(of),
            "refined": of.average("refined"),
            "fov_error": max(of.numbers("fov", "error")),
            "fov_contradicted": of.average("fov", "contradicted"),
        }

    return grid_rows(GRID, results, (), more)


def verdicts(results: Of, _: Sequence[Row]) -> Iterator[Verdict]:
    """Whether each disturbance costs no more than it may."""
    yield from of_bars(results, _bars())
    yield from _fov_verdicts(results)
    disturbed = tuple(name for name in DISTURBANCES if name not in UNDISTURBED)
    for part, names in (("undisturbed", UNDISTURBED), ("disturbed", disturbed)):
        shares = {GRID.conditions[one]: _covered(results.of(condition=one)) for one in names}
        shares = {title: share for title, share in shares.items() if not math.isnan(share)}
        if shares:
            some = [pair for pair in results.pairs if pair[0].condition in names]
            worst = min(shares, key=lambda title: shares[title])
            what = f"{part}: share of scales within two of their deviations"
            where = f"least: {worst}, {digits(shares[worst])}"
            share = _covered(Of(results.options, some))
            yield Verdict(what, share, COVERED, where, at_least=True)


def _fov_verdicts(results: Of) -> Iterator[Verdict]:
    unknown = results.of(condition="fov-unknown")
    if unknown.finished:
        rooms = unknown.of(kind="room").numbers("fov", "error")
        others = [v["fov"]["error"] for case, v in unknown.finished if case.kind != "room"]
        where = f"of {len(rooms)} rooms; of {len(others)} others {digits(max(others, default=0.0))}"
        what = "unknown field of view: largest error in degrees"
        yield Verdict(what, max(rooms, default=math.nan), FOV_ERROR, where)
    for disturbance, bar in CONTRADICTED:
        of = results.of(condition=disturbance)
        if of.finished:
            said = of.finished[0][1]["fov"]["said"]
            what = (
                f"{GRID.conditions[disturbance]}: share of scenes in which the fit contradicts it"
            )
            where = f"such as “{said}”" if said else ""
            share = of.average("fov", "contradicted")
            yield Verdict(what, share, bar, where, at_least=bar > 0)


# ----------------------------------------------------------------------------------- what is shown


def sections(results: Of, of_rows: Sequence[Row]) -> Iterator[Section]:
    """Every figure, and maps."""
    yield Section(
        "Figures",
        "RMSE; relight is of pictures under held-out lights, mean radiance 0.4. Multiples are of "
        "means over those of the reference; of JPEG over those of float pictures with white noise "
        "of the same RMS, of a view 90° wide over those with the field of view known. Seconds are "
        "of one processor. Scale: the mean error of the scale of albedo, the mean of its stated "
        "deviation, and the share of channels and scenes in which the error is within two "
        "deviations.",
        [Table.of(of_rows)],
    )
    caption = "One scene: a picture, the maps that were found, and the true ones in the first row."
    yield from sheets("Maps", results, GRID, caption, "everyday-maps", by="condition")


SUITE = Suite(
    name="everyday",
    title="Everyday pictures",
    protocol=f"pbrfit-everyday-2: {SCORES}; {{size}} pixels, {{effort}}",
    cases=GRID.cases,
    run=run,
    rows=rows,
    verdicts=verdicts,
    sections=sections,
    settings=GRID.settings(
        2000,
        count("K", "in all; the kinds room, furnished and detailed take turns", 18, 2),
        *((64, 24), "disturbances"),
    ),
    about=(
        "Fits of scenes whose ground truth is known after what cameras and files do to pictures: "
        "8 bits, JPEG, clipping, hot samples, a bad picture, tone curves, vignetting, an unknown "
        "or wrong field of view. Scenes have 16 pictures of mean radiance 0.4 with white noise of "
        "0.01 in float32; fits have all defaults. docs/everyday.md says what each case is.",
    ),
    timed=True,
)
