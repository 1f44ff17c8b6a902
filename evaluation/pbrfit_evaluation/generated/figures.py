"""Rows, verdicts, tables and pictures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from pbrfit_evaluation.generated.ways import GRID, PICTURED, WAYS, by_cycles
from pbrfit_evaluation.grid.figures import Bar, Metrics, Of, pictures
from pbrfit_evaluation.grid.figures import rows as grid_rows
from pbrfit_evaluation.grid.figures import verdicts as of_bars
from pbrfit_evaluation.panels import in_lines, unpacked
from pbrfit_evaluation.suite import Column, Picture, Row, Section, Table, Verdict

ERRORS = ("albedo_scaled", "roughness", "metallic", "relight_scaled")

NOT_WORSE = 1.0
"""Mean error over that of another row, at most: what handling pictures has to be worth."""

HARMLESS = 1.05
"""The same of exact pictures, which need no handling: 5 % is a third of the differences between
rooms."""

OURS = ", our renderer"
"""Ends the name of a row whose rooms are not by Cycles."""


def rows(results: Of) -> list[Row]:
    """A row a way."""

    def more(key: str, _: str, of: Of) -> Metrics:
        found = {name: of.mean(name).mean for name in ("kept", "honest_refused", "damaged_kept")}
        if WAYS[key].path:
            for name in ("ours", "blender"):
                found[f"first_light_{name}"] = of.mean("blender", name).mean
        return found

    ours = "" if by_cycles(results.options) else OURS
    found = grid_rows(GRID, results, [*ERRORS, "albedo", "relight"], more)
    return [replace(row, name=f"{row.name}{ours}") for row in found]


def verdicts(results: Of, _: object) -> Iterator[Verdict]:
    """Handling is worth something with damage, harmless without, and better than no maps."""
    for way, other, bar, what in (
        ("together", "repainted", NOT_WORSE, "all damage, all together over nothing handled"),
        ("together", "constant", NOT_WORSE, "all damage, all together over the constant guess"),
        ("path", "constant", NOT_WORSE, "by commands over the constant guess"),
        ("exact-handled", "exact", HARMLESS, "exact pictures, all together over nothing handled"),
    ):
        for name in ERRORS:
            title = f"{what}: {name.replace('_', ', ')}"
            one = Bar(title, (way, "default"), (other, "default"), [name], bar)
            yield from of_bars(results, [one])


def sections(results: Of, found: Sequence[Row]) -> Iterator[Section]:
    """Errors by stage, what the review did, and pictures."""
    headings = {"albedo_scaled": "albedo", "relight_scaled": "relit"}
    columns = [Column(name, headings.get(name, "")) for name in ERRORS]
    yield Section(
        "Errors by stage",
        "RMSE of linear values; albedo and relit pictures after the best factor a channel.",
        [Table.of(found, columns)],
    )
    columns = [
        Column("kept", "pictures kept"),
        Column("honest_refused", "refused though whole"),
        Column("damaged_kept", "kept though damaged"),
    ]
    handled = {way.words for way in WAYS.values() if way.review}
    reviewed = [row for row in found if row.name.removesuffix(OURS) in handled and row.scenes]
    yield Section(
        "What the review left",
        "Means over rooms. Tones alone are no damage here.",
        [Table.of(reviewed, columns)],
    )
    path = [row for row in found if "first_light_ours" in row.metrics]
    columns = [
        Column("first_light_ours", "relit by pbrfit"),
        Column("first_light_blender", "rendered by Blender"),
    ]
    if path:
        yield Section(
            "In Blender",
            "The export under the first held-out light, as above.",
            [Table.of(path, columns)],
        )
    figures = list(_pictures(results))
    if figures:
        yield Section("Pictures", figures=figures)


def _pictures(results: Of) -> Iterator[Picture]:
    shown = [values for _, values in results.finished if "inputs" in values]
    if shown:
        most = max(shown, key=lambda values: len(set(values["kinds"])))
        panels = in_lines({"": unpacked(most["inputs"])})
        yield Picture("inputs", "Stand-ins of the first room.", panels)
    labels = {key: WAYS[key].words for key in PICTURED}
    caption = "The first room; relit by the first held-out light."
    yield from pictures(results, labels, caption, by="condition")
