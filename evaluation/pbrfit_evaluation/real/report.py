"""The suite as files: page, pictures, CSV, summary."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pbrfit.model.reflection import MODELS, Model
from pbrfit_evaluation import page, summary
from pbrfit_evaluation.page import Cell, Figure, Section, Table
from pbrfit_evaluation.real import EXPLANATIONS, IN_WORDS, Effort, Fold, figures
from pbrfit_evaluation.real.held_out import Explanation
from pbrfit_evaluation.real.plots import draw_errors
from pbrfit_evaluation.real.sources import PublicSet, Source
from pbrfit_evaluation.tables import write_csv

PROTOCOL = (
    "pbrfit-real-1: materials from the kept pictures, lights of held-out pictures by linear least "
    "squares; RMSE over RMS radiance of all held-out pictures together, linear, clipped samples "
    "left out; PSNR and SSIM in sRGB, exposed so that the picture's 98th percentile is white"
)

COLUMNS = (
    "source",
    "model",
    "fold",
    "explanation",
    "picture",
    "rms",
    "rmse",
    "relative_rmse",
    "psnr",
    "ssim",
)


@dataclass(frozen=True)
class Measured:
    """All that was measured of one source with a model: folds, or why there are none."""

    source: Source
    model: Model
    folds: Mapping[int, Fold]
    error: str | None

    @property
    def name(self) -> str:
        """Of source and model."""
        return f"{self.source.name}, {self.model}"


def write(
    folder: Path, measured: Sequence[Measured], effort: Effort, absent: Sequence[PublicSet]
) -> None:
    """Write `report.html`, its pictures, `pictures.csv` and `summary.json`."""
    sections = list(_sections(measured, absent))
    page.write_page(folder, "Real pictures, some held out", _opening(effort), sections)
    write_csv(folder / "pictures.csv", COLUMNS, _lines(measured))
    protocol = f"{PROTOCOL}; {effort.max_size} pixels, {effort.iterations} iterations"
    summary.write_summary(folder, protocol, list(_rows(measured, absent)))


def _rows(measured: Sequence[Measured], absent: Sequence[PublicSet]) -> Iterator[summary.Row]:
    for one in measured:
        if not one.folds:
            yield summary.Row(one.name, 0, None, {}, status=one.error or "not run")
            continue
        for name in EXPLANATIONS:
            found = figures(list(one.folds.values()), name)
            metrics = {
                "relative_rmse": found.error,
                "kept_relative_rmse": found.kept_error,
                "psnr": found.psnr,
                "ssim": found.ssim,
                "seconds": found.seconds,
                "folds": float(len(one.folds)),
            }
            solver = {"default": "auto", "plain": "auto", "paper": "lbfgsb"}.get(name)
            yield summary.Row(f"{one.name}, {name}", 1, solver, metrics, status=one.error or "ok")
    for missing in absent:
        yield summary.Row(missing.kind, 0, None, {}, status=f"not there: {missing.origin}")


def _lines(measured: Sequence[Measured]) -> Iterator[tuple[object, ...]]:
    for one in measured:
        for number, fold in one.folds.items():
            for name, outcome in fold.outcomes.items():
                for score in outcome.scores:
                    relative = score.rmse / score.rms if score.rms > 0 else None
                    yield (
                        one.source.name,
                        one.model,
                        number,
                        name,
                        score.name,
                        score.rms,
                        score.rmse,
                        relative,
                        score.psnr,
                        score.ssim,
                    )


def _opening(effort: Effort) -> list[str]:
    return [
        "Some pictures of each set are held out. Materials are fitted to the others. Then only the "
        "light of each held-out picture is fitted, 48 numbers for all its pixels, and what is left "
        "is the error of the materials and of the model. There is no other truth for real "
        "pictures.",
        "What it can tell: whether the maps carry over to light that they have not seen, better "
        "than a constant guess or a map of albedo alone. What it cannot tell: whether the maps are "
        "right. Several materials may explain the same pictures, and where lights are much alike, "
        "shading that is painted into the albedo explains the held-out picture as well.",
        "The sum of kept pictures needs no materials at all: light adds up, so a factor a picture "
        "and channel is a fair competitor where lights are many and alike. It says nothing about "
        "surfaces.",
        f"Pictures are averaged down to {effort.max_size} pixels, fits have at most "
        f"{effort.iterations} iterations. Samples that an integer file holds at its maximum are "
        "clipped: they say only that there was at least so much light, so they have no weight in "
        "fits and errors. Known lights are not used.",
    ]


def _sections(measured: Sequence[Measured], absent: Sequence[PublicSet]) -> Iterator[Section]:
    done = [one for one in measured if one.folds]
    if done:
        errors: dict[str, dict[Explanation, float]] = {
            one.name: {name: figures(list(one.folds.values()), name).error for name in EXPLANATIONS}
            for one in done
        }
        figure = Figure(
            "held_out", draw_errors(errors), "Error of held-out pictures; 1 is that of black."
        )
        yield Section("All sets", [], [_overview(errors)], [figure])
    both = _both_models(done)
    if both is not None:
        yield both
    for one in measured:
        yield _section(one)
    if absent:
        yield Section(
            "Not there",
            ["Public sets that the folder does not hold, and where they come from."],
            [
                Table(
                    [Cell("set"), Cell("origin")],
                    [[Cell(missing.kind), Cell(missing.origin, "why")] for missing in absent],
                )
            ],
        )


def _overview(errors: Mapping[str, Mapping[Explanation, float]]) -> Table:
    """Errors of all sources; the best of the materials in bold."""
    columns = [Cell("RMSE / RMS"), *(Cell(IN_WORDS[name], "number") for name in EXPLANATIONS)]
    rows = []
    for source, of in errors.items():
        least = min(of[name] for name in EXPLANATIONS if name != "combination")
        cells = [Cell(f"{of[n]:.3f}", "best" if of[n] == least else "number") for n in EXPLANATIONS]
        rows.append([Cell(source, "name"), *cells])
    return Table(columns, rows)


def _both_models(done: Sequence[Measured]) -> Section | None:
    """The two models beside each other, for sources that were explained with both."""
    by_source: dict[str, dict[Model, Measured]] = {}
    for one in done:
        by_source.setdefault(one.source.name, {})[one.model] = one
    shared = {name: of for name, of in by_source.items() if len(of) == len(MODELS)}
    if not shared:
        return None
    fits: tuple[Explanation, ...] = ("default", "plain", "paper")
    columns = [Cell("RMSE / RMS")]
    columns += [Cell(f"{IN_WORDS[fit]},\n{model}", "number") for fit in fits for model in MODELS]
    rows = []
    for name, of in shared.items():
        cells = [Cell(name, "name")]
        for fit in fits:
            errors = [figures(list(of[model].folds.values()), fit).error for model in MODELS]
            cells += [
                Cell(f"{error:.4f}", "best" if error == min(errors) else "number")
                for error in errors
            ]
        rows.append(cells)
    return Section(
        "The two models",
        [
            "Errors of held-out pictures with materials and lights of either reflection model: "
            "the same pictures, the same solver. The smaller of each pair is bold."
        ],
        [Table(columns, rows)],
    )


def _section(one: Measured) -> Section:
    about = one.source.about[0].upper() + one.source.about[1:]
    sentences = [f"{about}. Explained with model {one.model}."]
    if one.error is not None:
        sentences.append(f"Failed: {one.error}.")
    if not one.folds:
        return Section(one.name, sentences)
    found = list(one.folds.values())
    first = found[0]
    held_out = sum(len(fold.outcomes["default"].scores) for fold in found)
    sentences.append(
        f"{one.source.pictures} pictures of {first.size[0]} × {first.size[1]}, {first.pixels} "
        f"pixels used, {100 * first.clipped:.2g} % of the samples clipped; {len(found)} folds, "
        f"{held_out} held-out pictures in all, {first.kept} kept each time."
    )
    columns = [
        Cell("explained by"),
        *(
            Cell(text, "number")
            for text in ("held out: RMSE / RMS", "PSNR, dB", "SSIM", "kept: RMSE / RMS", "fit, s")
        ),
    ]
    rows = []
    for name in EXPLANATIONS:
        of = figures(found, name)
        texts = (
            f"{of.error:.4f}",
            f"{of.psnr:.1f}",
            f"{of.ssim:.3f}",
            "" if of.kept_error is None else f"{of.kept_error:.4f}",
            f"{of.seconds:.1f}" if of.seconds else "",
        )
        rows.append([Cell(IN_WORDS[name], "name"), *(Cell(text, "number") for text in texts)])
    pictures = [
        Figure(
            f"sheet-{one.source.name}-{one.model}",
            fold.sheet,
            "First row: a kept picture and the maps of our default. Second: a held-out picture and "
            "how it is explained. Third: errors.",
        )
        for fold in found
        if fold.sheet is not None
    ]
    return Section(one.name, sentences, [Table(columns, rows)], pictures)
