"""A section of the page for each part."""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from pbrfit.report.notation import percent
from pbrfit.result.refinement import RefineNormals
from pbrfit_evaluation.normals import Measured, Part, cost, exact
from pbrfit_evaluation.normals.fits import NOISE, PICTURES, REFINE
from pbrfit_evaluation.normals.pictures import draw_sheet
from pbrfit_evaluation.normals.report import plots
from pbrfit_evaluation.normals.report.verdicts import at, errors, mean_angle, won_back
from pbrfit_evaluation.normals.rooms import MAPS_AND_RELIGHT, METRICS, TRUE
from pbrfit_evaluation.page import Cell, Figure, Section, Table

Values = Mapping[str, Any]
Found = Sequence[tuple[Any, Values]]

IN_WORDS: dict[RefineNormals, str] = {"off": "not refined", "auto": "auto", "on": "on"}

TABLED = (5.0, 10.0, 20.0)
"""θ whose figures are in the table of what is won back; the plot has all."""


ANGLES = ("mean", "median", "aligned")


def _number(value: float, form: str) -> Cell:
    return Cell(form.format(value) if np.isfinite(value) else "–", "number", value)


def _heads(first: Sequence[str], numbers: Sequence[str]) -> list[Cell]:
    return [*(Cell(text, "name") for text in first), *(Cell(text, "number") for text in numbers)]


# ----------------------------------------------------------------------------------------- rooms


def _rooms(measured: Measured) -> Section:
    found = measured.finished("rooms")
    kinds = Counter(task.scene for task, _ in at(found, TRUE))
    scenes = " and ".join(f"{count} {kind}" for kind, count in kinds.items())
    effort = measured.effort
    return Section(
        "Errors against the disturbance",
        [
            f"Scenes: {scenes}, of {effort.size} × {effort.size} pixels, seeds from "
            f"{effort.first_seed}; {PICTURES} pictures of mean radiance 0.4 with noise of {NOISE}, "
            f"as many held out. Priors and true segments as in table1's default. The floor is the "
            "fit without refinement at true normals, the loss what wrong normals add to it.",
            "Correlated: turned by a random field over 6 % of the width with a bias over 40 %, θ "
            "the root mean square of each component. Biased: all turned together by θ. Estimator: "
            "the errors of a learned estimator, scaled to the mean angle of a correlated "
            "disturbance, 1.25 θ.",
        ],
        [_errors(found), _won_back(found), _decisions(found)],
        [
            Figure(
                "normals",
                plots.draw_errors(found),
                "Error against the size of the disturbance, means over scenes; bands from the "
                f"{plots.BAND[0]}th to the {plots.BAND[1]}th percentile of scenes.",
            )
        ]
        if found
        else [],
    )


def _cases(found: Found) -> list[tuple[str, float]]:
    cases = {(task.disturbance, task.degrees) for task, _ in found}
    kinds = list(dict.fromkeys(task.disturbance for task, _ in found))
    return sorted(cases, key=lambda case: (kinds.index(case[0]), case[1]))


def _errors(found: Found) -> Table:
    columns = [
        *_heads(["Normals", "Refined"], METRICS),
        *_heads([], ["angle,\nmean", "angle,\nmedian", "angle, all\nturned back"]),
        *_heads([], ["seconds,\nmedian", "times\noff"]),
    ]
    rows = []
    for kind, degrees in _cases(found):
        of_case = at(found, kind, degrees)
        name = kind if kind == TRUE else f"{kind} {degrees:g}°"
        off_s = _seconds(of_case, "off")
        for refine in REFINE:
            angles = [values[refine]["angle"] for _, values in of_case]
            seconds = _seconds(of_case, refine)
            rows.append(
                [
                    Cell(name, "name"),
                    Cell(IN_WORDS[refine], "name"),
                    *(
                        _number(float(np.mean(list(errors(of_case, refine, m).values()))), "{:.4f}")
                        for m in METRICS
                    ),
                    _number(float(np.mean([a["mean"] for a in angles])), "{:.2f}°"),
                    _number(float(np.mean([a["median"] for a in angles])), "{:.2f}°"),
                    _number(float(np.mean([a["aligned"] for a in angles])), "{:.2f}°"),
                    _number(float(np.median(seconds)), "{:.1f}"),
                    _number(float(np.median(np.divide(seconds, off_s))), "{:.1f}"),
                ]
            )
            name = ""
    caption = (
        "RMSE, means over scenes; angles to the true normals: of each scene the mean and the "
        "median over pixels, and the mean after the best turn of all normals together; means over "
        "scenes. Seconds are of fits that ran beside others."
    )
    return Table(columns, rows, caption)


def _seconds(found: Found, refine: RefineNormals) -> list[float]:
    return [float(values[refine]["scores"]["seconds"]) for _, values in found]


def _won_back(found: Found) -> Table:
    columns = _heads(["Normals", "Refined"], [*MAPS_AND_RELIGHT, "angle left"])
    rows = []
    for kind, degrees in _cases(found):
        if degrees not in TABLED:
            continue
        of_case = at(found, kind, degrees)
        for refine in REFINE[1:]:
            shares = [won_back(found, kind, degrees, m, refine) for m in MAPS_AND_RELIGHT]
            angle = mean_angle(of_case, refine) / mean_angle(of_case)
            rows.append(
                [
                    Cell(f"{kind} {degrees:g}°" if refine == REFINE[1] else "", "name"),
                    Cell(IN_WORDS[refine], "name"),
                    *(_share(*share) for share in shares),
                    _number(angle, "{:.2f}"),
                ]
            )
    caption = (
        "Won back of what wrong normals cost, of means over scenes; in brackets the median of "
        "scenes. Below 0, refining made it worse."
    )
    return Table(columns, rows, caption)


def _share(of_means: float, median: float) -> Cell:
    if not np.isfinite(of_means):
        return Cell("no loss", "number")
    text = f"{100 * of_means:.0f} %"
    return Cell(f"{text} ({100 * median:.0f} %)", "number", of_means)


def _decisions(found: Found) -> Table:
    columns = [
        *_heads(["Normals"], ["refined by auto", "of"]),
        Cell("Why, most often"),
    ]
    rows = []
    for kind, degrees in _cases(found):
        decisions = [values["auto"]["decision"] for _, values in at(found, kind, degrees)]
        [(why, _)] = Counter(decision["why"] for decision in decisions).most_common(1)
        rows.append(
            [
                Cell(kind if kind == TRUE else f"{kind} {degrees:g}°", "name"),
                Cell(str(sum(decision["refined"] for decision in decisions)), "number"),
                Cell(str(len(decisions)), "number"),
                Cell(why, "why"),
            ]
        )
    return Table(columns, rows, "What auto decides; scenes.csv has the figures it rests on.")


# ----------------------------------------------------------------------------------- exact, real


def _exact(measured: Measured) -> Section:
    columns = [
        *_heads(["Normals", "Scene"], [*exact.MAPS, "angle", "angle, all\nturned back"]),
        *_heads([], [*(f"{name},\nbest 95 %" for name in (*exact.MAPS, "angle")), "wrong\npixels"]),
        Cell("of these (of all pixels)"),
        Cell(""),
    ]
    rows = []
    for task, values in measured.finished("exact"):
        scores, wrong = values["scores"], values["wrong"]
        kinds = [
            f"{name} {percent(share)} ({percent(wrong['kinds_of_all'][name])})"
            for name, share in wrong["kinds"].items()
        ]
        rows.append(
            [
                Cell(f"{task.disturbance} {exact.DEGREES:g}°", "name"),
                Cell(f"{task.scene} {task.seed}", "name"),
                *(_number(scores[name], "{:.1e}") for name in exact.MAPS),
                _number(values["angle"]["mean"], "{:.3f}°"),
                _number(values["angle"]["aligned"], "{:.3f}°"),
                *(_number(wrong["best"][name], "{:.1e}") for name in exact.MAPS),
                _number(wrong["best"]["angle"], "{:.3f}°"),
                Cell(percent(wrong["share"]), "number", wrong["share"]),
                Cell(", ".join(kinds) if wrong["share"] else "", "why"),
                Cell("came back", "pass") if exact.came_back(values) else Cell("did not", "fail"),
            ]
        )
    return Section(
        "Without noise",
        [
            f"The same scenes without noise, normals {exact.DEGREES:g}° off, refined (on). A scene "
            f"came back if the RMSE of each map is at most {exact.MATERIAL:g} and the mean angle "
            f"at most {exact.ANGLE:g}°. “All turned back”: the angle after the best turn of all "
            f"normals together. A pixel is wrong if its normal is off by more than "
            f"{exact.WRONG_DEGREES:g}° or a map by more than {exact.WRONG_MATERIAL:g}; grazing: "
            f"n·v below {exact.GRAZING}, dark: albedo below {exact.DARK}, smooth: roughness below "
            f"{exact.SMOOTH}, rough: above {exact.ROUGH}.",
        ],
        [Table(columns, rows)],
    )


def _real(measured: Measured) -> Section:
    found = measured.finished("real")
    columns = [
        *_heads(["Set", "Start"], _three("given")),
        *_heads([], [*_three("auto"), *_three("on")]),
        *_heads([], ["recon,\nnot refined", "recon,\nauto", "recon,\non", "times\noff"]),
        Cell("auto: refined, why"),
    ]
    rows = []
    name = ""
    for task, values in found:
        first = task.source.name != name
        name = task.source.name
        auto = values["auto"]["decision"]
        seconds = values["on"]["seconds"] / values["off"]["seconds"]
        angles = [values["given"], values["auto"]["angle"], values["on"]["angle"]]
        rows.append(
            [
                Cell(name if first else "", "name"),
                Cell(task.in_words, "name"),
                *(
                    _number(a[key], "{:.2f}°")
                    for a in angles
                    for key in ("mean", "median", "aligned")
                ),
                *(_number(values[refine]["recon"], "{:.4f}") for refine in REFINE),
                _number(seconds, "{:.1f}"),
                Cell(f"{'yes' if auto['refined'] else 'no'}: {auto['why']}", "why"),
            ]
        )
    figures = [_sheet(found, name) for name in dict.fromkeys(t.source.name for t, _ in found)]
    if found:
        plot = plots.draw_real(found)
        figures.insert(0, Figure("real", plot, "Mean angle to the true normals, by start."))
    return Section(
        "Pictures of others whose normals are known",
        [
            "Two bunnies, rendered elsewhere under single lights, with the normals of their mesh, "
            "and a brick sphere with those of a sphere. Lights of order 3 do not hold the "
            "highlights of the glossy bunny. Angles to the true normals, before and after; flat: "
            "all normals are +Z. A turn of all normals of a matt surface together cannot be seen: "
            "“all turned back” is the mean angle after the best such turn.",
        ],
        [Table(columns, rows)],
        figures,
    )


def _three(name: str) -> list[str]:
    return [f"{name},\nmean", f"{name},\nmedian", f"{name}, all\nturned back"]


def _sheet(found: Found, name: str) -> Figure:
    starts = {}
    for task, values in found:
        if task.source.name == name:
            given, refined = values["given"]["mean"], values["on"]["angle"]["mean"]
            panels = {key: base64.b64decode(png) for key, png in values["panels"].items()}
            starts[task.in_words] = (
                panels,
                (f"error: {given:.1f}° in the mean", f"error: {refined:.1f}° in the mean"),
            )
    title = f"{name}: normals before and after refining"
    caption = "Normals given, refined (on), and their angles to the true ones."
    return Figure(f"real-{name}", draw_sheet(title, starts), caption)


# ------------------------------------------------------------------------------------------ cost


def _cost(measured: Measured) -> Section:
    found = measured.finished("cost")
    columns = [
        *_heads(["Case", "Pictures"], ["fits each", "not refined, s", "with, s", "times"]),
        Cell("Refined"),
    ]
    rows = []
    for task, values in found:
        off, refined = cost.medians(values)
        rows.append(
            [
                Cell(task.case, "name"),
                Cell(f"{task.size}²", "name"),
                Cell(str(len(values["off"])), "number"),
                _number(off, "{:.2f}"),
                _number(refined, "{:.2f}"),
                _number(refined / off, "{:.2f}"),
                Cell("yes" if values["refined"] else "no"),
            ]
        )
    threads = {values["threads"] for _, values in found}
    return Section(
        "Cost",
        [
            "Seconds of a fit of a furnished room, median over fits that took turns, one at a "
            f"time; threads: {', '.join(map(str, sorted(threads)))}. Refined: normals off by "
            f"{cost.DEGREES:g}° (correlated), on against off. Declined: true normals, auto "
            "against off.",
        ],
        [Table(columns, rows)],
        [Figure("cost", plots.draw_cost(found), "Both on logarithmic scales.")] if found else [],
    )


SECTIONS: dict[Part, Callable[[Measured], Section]] = {
    "rooms": _rooms,
    "exact": _exact,
    "real": _real,
    "cost": _cost,
}
