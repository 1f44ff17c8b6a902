"""A section of the page for each part."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from pbrfit.report.notation import scientific
from pbrfit_evaluation.page import Cell, Figure, Section, Table
from pbrfit_evaluation.solvers import Measured, Part, exact, memory, noise, priors, race, start
from pbrfit_evaluation.solvers.report import plots
from pbrfit_evaluation.solvers.report.verdicts import gap_ratios, gap_rows, speeds
from pbrfit_evaluation.table1.rows import BY_KEY, COLUMNS

Values = Mapping[str, Any]


def _number(value: float | None, digits: str = "") -> Cell:
    if value is None:
        return Cell("–", "number")
    return Cell(f"{value:{digits}}" if digits else scientific(value), "number", value)


def _heads(first: Sequence[str], numbers: Sequence[str]) -> list[Cell]:
    return [*(Cell(text, "name") for text in first), *(Cell(text, "number") for text in numbers)]


def _exact(measured: Measured) -> Section:
    found = measured.finished("exact")
    rows = []
    for name, _, in32 in exact.FITS:
        recon = exact.RECON_FLOAT32 if in32 else exact.RECON_FLOAT64
        runs = [values[name] for _, values in found]
        maps = [max(run[m] for m in exact.MAPS) for run in runs]
        rows.append(
            [
                Cell(name, "name"),
                Cell(f"{sum(exact.is_exact(run, recon) for run in runs)} of {len(runs)}", "number"),
                _number(statistics.median(run["recon"] for run in runs)),
                _number(max(run["recon"] for run in runs)),
                _number(statistics.median(maps)),
                _number(max(maps)),
                _number(statistics.median(run["seconds"] for run in runs), ".2f"),
                _number(max(run["seconds"] for run in runs), ".2f"),
            ]
        )
    heads = ["rooms exact", "recon,\nmedian", "recon,\nworst", "worst map,\nmedian"]
    heads += ["worst map,\nworst", "seconds,\nmedian", "seconds,\nmost"]
    tables = [Table(_heads(["Fit"], heads), rows)] if found else []
    if missed := _missed(found):
        tables.append(missed)
    return Section(
        "Exact: pictures without noise",
        [
            f"Exact is a residual of at most {scientific(exact.RECON_FLOAT32)} of the pictures' "
            f"RMS ({scientific(exact.RECON_FLOAT64)} for float64 pictures) and an RMSE of at most "
            f"{scientific(exact.MATERIAL)} in every map. “recon” is rendered and compared in "
            "float64; “worst map” is the largest RMSE of albedo, roughness and metallic. No "
            "priors. Wrong pixels are off by more than "
            f"{scientific(exact.WRONG)} in any map; one can be of several kinds: dark (mean "
            f"radiance below {exact.DARK}), grazing (n·v below {exact.GRAZING}), smooth (r below "
            f"{exact.SMOOTH}), rough (r above {exact.ROUGH}), metal, flat (roughness moves by more "
            f"than {exact.FLAT:g} a unit of noise, lights known).",
        ],
        tables,
        [Figure("exact", plots.draw_exact(found), "Every room, by seed.")] if found else [],
    )


def _missed(found: Sequence[tuple[Any, Values]]) -> Table | None:
    rows = []
    for task, values in found:
        for name, _, in32 in exact.FITS:
            run = values[name]
            recon = exact.RECON_FLOAT32 if in32 else exact.RECON_FLOAT64
            if name == "lbfgsb" or exact.is_exact(run, recon):
                continue
            wrong = run["wrong"]
            kinds = ", ".join(f"{n} {kind}" for kind, n in wrong["kinds"].items() if n)
            rows.append(
                [
                    Cell(str(task.seed), "name"),
                    Cell(name, "name"),
                    _number(run["recon"]),
                    *(_number(run[m]) for m in exact.MAPS),
                    _number(wrong["count"]),
                    Cell(kinds, "why"),
                    Cell(_worst_pixel(wrong["worst"]), "why"),
                ]
            )
    if not rows:
        return None
    columns = _heads(["Seed", "Fit"], ["recon", *exact.MAPS, "wrong\npixels"])
    columns += [Cell("of which"), Cell("the worst")]
    return Table(columns, rows, "Rooms that are not exact, by second-order solvers.")


def _worst_pixel(worst: Sequence[Values]) -> str:
    if not worst:
        return ""
    w = worst[0]
    return (
        f"at {tuple(w['pixel'])}, off by {scientific(max(w['off']))}: "
        f"r {w['roughness'][0]:.3f} found {w['roughness'][1]:.3f}, "
        f"m {w['metallic'][0]:.2f} found {w['metallic'][1]:.2f}, radiance {w['radiance']:.3f}, "
        f"n·v {w['cosine']:.2f}"
    )


def _noise(measured: Measured) -> Section:
    tables = []
    for level in noise.LEVELS:
        found = [values for task, values in measured.finished("noise") if task.noise == level]
        if not found:
            continue
        rows = [
            [
                Cell(name, "name"),
                _number(float(np.mean([noise.above_mark(values, name) for values in found]))),
                *(
                    _number(_mean(found, name, metric), ".4f")
                    for metric in ("recon", *noise.METRICS)
                ),
                _number(_mean(found, name, "seconds"), ".2f"),
            ]
            for name in (*noise.PLAIN, *noise.WITH_PRIORS)
        ]
        heads = ["objective over\nthe mark, less 1", "recon"]
        heads += [m.replace("_", ",\n") for m in noise.METRICS]
        caption = f"Noise of {level:g}, rooms: {len(found)}; means."
        tables.append(Table(_heads(["Fit"], [*heads, "seconds"]), rows, caption))
    return Section(
        "Noise",
        [
            "The objective is the data term in float64. The mark is the lower of that of L-BFGS-B "
            "and of Gauss-Newton started at the truth, room by room. With priors the objective is "
            "not the data term alone: theirs is above the mark.",
        ],
        tables,
    )


def _mean(found: Sequence[Values], name: str, metric: str) -> float:
    return float(np.mean([values[name]["scores"][metric] for values in found]))


def _start(measured: Measured) -> Section:
    rows = []
    found = measured.finished("start")
    for kind in start.KINDS:
        for level in start.NOISE:
            runs = [v for task, v in found if task.kind == kind and task.noise == level]
            if runs:
                ratios = [
                    max(v[name]["auto"] / v[name]["lbfgsb"] for v in runs)
                    for name in start.SETTINGS
                ]
                cells = [
                    Cell(f"{r:.4f}", "number" if r <= 1 + start.ROUNDING else "fail", r)
                    for r in ratios
                ]
                rows.append([Cell(kind, "name"), Cell(f"{level:g}", "name"), *cells])
    return Section(
        "The same start",
        [
            "Objective of “auto” over that of “lbfgsb”, both from the default start: the largest "
            "over the scenes of a kind. Penalties have fixed weights here, which leaves out the "
            "learnt prior. The robust loss is compared at one scale, that of the L-BFGS-B fit.",
        ],
        [Table(_heads(["Scene", "Noise"], list(start.SETTINGS)), rows)],
    )


def _gap(measured: Measured) -> Section:
    rows = []
    by_row = gap_rows(measured)
    for row, found in by_row.items():
        ratios = gap_ratios(found)
        cells = []
        for column in COLUMNS:
            if column not in ratios:
                cells.append(Cell("–", "number"))
                continue
            ours, paper = (
                float(np.mean([values[key][column] for _, values in found]))
                for key in ("auto", "paper")
            )
            text = f"{ratios[column]:.2f}\n{ours:.4f} / {paper:.4f}"
            cells.append(Cell(text, "number", ratios[column]))
        mean = float(np.exp(np.mean(np.log(list(ratios.values())))))
        rows.append([Cell(BY_KEY[row].name), _number(len(found)), *cells, _number(mean, ".2f")])
    return Section(
        "Model gap",
        [
            "Rows of table1 whose pictures the model cannot explain. Mean errors of “auto” with "
            "its defaults over those of the paper's recipe; below, both. Last the geometric mean "
            "of the ratios.",
        ],
        [Table(_heads(["Setup"], ["scenes", *COLUMNS, "mean"]), rows)],
        [
            Figure(
                "gap",
                plots.draw_gap({BY_KEY[row].name: gap_ratios(f) for row, f in by_row.items()}),
                "Ratio of mean errors: left of 1 “auto” is better.",
            )
        ]
        if by_row
        else [],
    )


def _priors(measured: Measured) -> Section:
    rows = []
    names = ("recon", "clean", "albedo", "roughness", "metallic", "relight")
    for case in priors.CASES:
        found = [values for task, values in measured.finished("priors") if task.case == case]
        if not found:
            continue
        cells = []
        for name in names:
            without, default = (
                float(np.mean([values[key][name] for values in found]))
                for key in ("none", "default")
            )
            text = f"{default / without:.2f}\n{default:.4f} / {without:.4f}"
            cells.append(Cell(text, "number", default / without))
        rows.append([Cell(case, "name"), _number(len(found)), *cells])
    return Section(
        "Priors",
        [
            "Mean errors of “auto” with the default priors over those without; below, both. The "
            "cases are the ablation's, with noise of 0.01. “recon” is against the noisy pictures, "
            "where any prior can only raise it; “clean” against the same without noise.",
        ],
        [Table(_heads(["Case"], ["rooms", *names]), rows)],
    )


def _race(measured: Measured) -> Section:
    rows = []
    found = measured.finished("race")
    for seed in dict.fromkeys(task.seed for task, _ in found):
        runs = {task.runner: values for task, values in found if task.seed == seed}
        mark = runs["paper"]["residual"]
        for runner in race.RUNNERS:
            if runner.key not in runs:
                continue
            values = runs[runner.key]
            reached = values["seconds"] if values["is_mark"] else values["reached"]
            ratios = [
                speeds(measured, runner.key, other).get(seed)
                if runner.key in ("gauss-newton", "auto")
                else None
                for other in ("lbfgsb", "torch")
            ]
            rows.append(
                [
                    Cell(str(seed), "name"),
                    Cell(runner.name, "name"),
                    _number(reached, ".3g") if reached is not None else Cell("never", "fail"),
                    *(
                        Cell("", "number")
                        if speed is None
                        else Cell(
                            f"{'over ' if speed.bounded else ''}{speed.ratio:.1f} ×",
                            "number",
                            speed.ratio,
                        )
                        for speed in ratios
                    ),
                    _number(values["residual"] / values["pictures_rms"]),
                    _number((values["residual"] / mark) ** 2),
                    _number(values["seconds"], ".3g"),
                    _number(values["evaluations"], ".0f"),
                    Cell(values["stop_reason"], "why"),
                ]
            )
    heads = ["seconds to\nthe mark", "sooner than\nlbfgsb", "sooner than\nPyTorch"]
    heads += ["recon at the\nend / RMS", "objective at the\nend / mark"]
    heads += ["seconds\nin all", "evaluations"]
    return Section(
        "Race",
        [
            "Seconds until the objective over all pixels, measured in float64 with the clock "
            "stopped, is as low as where the paper's recipe ends after all its iterations. "
            f"{race.THREADS} threads, 16 pictures without noise, rounded to float32. All start "
            "where the recipe does, but for “lbfgsb”, the product's stages from its own start. "
            "PyTorch: the compiled matrix form with torch.optim.LBFGS, strong Wolfe, maps through "
            "a sigmoid, float32; compiling is not on the clock, and it is given up after "
            f"{race.PEER_EVALUATIONS} evaluations or {race.PEER_PATIENCE:g} times the recipe's "
            "seconds. “Sooner than lbfgsb” is against the quicker of the recipe and “lbfgsb”.",
        ],
        [Table([*_heads(["Seed", "Runner"], heads), Cell("ended because")], rows)],
        [
            Figure(
                "race",
                plots.draw_race(found),
                "Residual over the pictures' RMS against wall time, both on logarithmic scales; a "
                "panel a scene. Dotted: the mark. Large dots: the mark is reached.",
            )
        ]
        if found
        else [],
    )


def _memory(measured: Measured) -> Section:
    rows = [
        [
            Cell(f"{task.size}²", "name"),
            Cell(task.solver, "name"),
            _number(values["pictures"] / 2**20, ".0f"),
            _number(None if values["peak"] is None else values["peak"] / 2**20, ".0f"),
            _number(None if values["peak"] is None else values["peak"] / values["pictures"], ".2f"),
            _number(values["seconds"], ".1f"),
        ]
        for task, values in measured.finished("memory")
    ]
    heads = ["pictures, MiB", "peak, MiB", "peak / pictures", "seconds"]
    return Section(
        "Memory",
        [
            "Peak of resident memory over that of a process with libraries loaded and a small fit "
            f"done, {memory.ITERATIONS} iterations with the default options; the pictures "
            "themselves count.",
        ],
        [Table(_heads(["Pictures", "Solver"], heads), rows)],
    )


SECTIONS: dict[Part, Callable[[Measured], Section]] = {
    "exact": _exact,
    "noise": _noise,
    "start": _start,
    "gap": _gap,
    "priors": _priors,
    "race": _race,
    "memory": _memory,
}
