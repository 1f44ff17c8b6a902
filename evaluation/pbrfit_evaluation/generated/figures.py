"""Rows, verdicts, tables and pictures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pbrfit_evaluation.generated.measure import Case
from pbrfit_evaluation.generated.ways import BY_KEY, WAYS
from pbrfit_evaluation.panels import beside_truth, in_lines, unpacked
from pbrfit_evaluation.suite import (
    Column,
    Picture,
    Results,
    Row,
    Section,
    Table,
    Verdict,
)

Of = Results[Case]

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
    found = []
    for way in WAYS:
        if way.key not in results.options.ways:
            continue
        of = results.of(way=way.key)
        measured = of.metrics([*ERRORS, "albedo", "relight"], "scores")
        for name in ("kept", "honest_refused", "damaged_kept"):
            measured[name] = of.mean(name).mean
        if way.path:
            for name in ("ours", "blender"):
                measured[f"first_light_{name}"] = of.mean("blender", name).mean
        ours = any(not case.by_cycles for case, _ in of.pairs)
        name = way.words + (OURS if ours else "")
        found.append(
            Row(name, len(of.finished), None, measured, status=of.status("rooms"), guess=way.guess)
        )
    return found


def verdicts(results: Of, _: object) -> Iterator[Verdict]:
    """Handling is worth something with damage, harmless without, and better than no maps."""
    for way, other, bar, what in (
        ("together", "repainted", NOT_WORSE, "all damage, all together over nothing handled"),
        ("together", "constant", NOT_WORSE, "all damage, all together over the constant guess"),
        ("path", "constant", NOT_WORSE, "by commands over the constant guess"),
        ("exact-handled", "exact", HARMLESS, "exact pictures, all together over nothing handled"),
    ):
        if {way, other} <= set(results.options.ways):
            for name in ERRORS:
                title = f"{what}: {name.replace('_', ', ')}"
                yield Verdict(title, results.of(way=way).over(results.of(way=other), name), bar)


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
    handled = {way.words for way in WAYS if way.review}
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
    shown = {case.way: values for case, values in results.finished if "maps" in values}
    if not shown:
        return
    most = max(shown.values(), key=lambda values: len(set(values["kinds"])))
    yield Picture(
        "inputs", "Stand-ins of the first room.", in_lines({"": unpacked(most["inputs"])})
    )
    kept = {}
    for key, values in shown.items():
        kept[BY_KEY[key].words] = panels = unpacked(values["maps"])
        if "in_blender" in values:
            panels |= unpacked(values["in_blender"])
    names = ("albedo", "roughness", "metallic", "relit")
    caption = "The first room; relit by the first held-out light."
    yield Picture("maps", caption, beside_truth(kept, names))
