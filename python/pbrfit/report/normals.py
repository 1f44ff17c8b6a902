"""Given and refined normals: how far apart they are, and what was decided."""

from __future__ import annotations

import math

import numpy as np

from pbrfit.report import figures
from pbrfit.report.html import Cell, Table, number, paragraph, table
from pbrfit.report.maps import Block, Shown, difference_shown, normals_shown
from pbrfit.report.notation import percent, plain
from pbrfit.result import differences
from pbrfit.result.refinement import FROM_PICTURES
from pbrfit.result.result import Result

LABELS = {
    "mean_change_degrees": "change, mean",
    "largest_change_degrees": "change, largest",
    "changed_share": "pixels whose normal was changed",
}
"""Labels of figures; others are shown by their names."""


def sentence(result: Result) -> str:
    """What was decided about the normals; nothing where refining them was not asked for."""
    if result.height is not None:
        return "Normals and height were found from the pictures, as no normals were given."
    told = result.refinement
    if told.asked == "off" and not told.why.startswith(FROM_PICTURES):
        return ""
    return f"The normals were {told.in_words()}."


def blocks(result: Result) -> list[Block]:
    """The section's block about normals; none where there is nothing to tell."""
    decided = sentence(result)
    if not decided:
        return []
    text = paragraph(decided) + _table(result)
    given, change = result.given_normals, result.normal_change
    if given is None or change is None:
        return [Block("Normals", text, "", ())]
    text += paragraph("Relighting, exports and the view above use the refined normals.")
    inside = change[result.mask]
    mean, high, largest = (
        plain(float(value)) for value in (inside.mean(), np.percentile(inside, 95), inside.max())
    )
    remark = f"mean {mean}°, 95 % below {high}°, at most {largest}°"
    pictures = (
        normals_shown(given, "given", "as given, in camera space"),
        normals_shown(result.normals, "refined", "used for the maps"),
        Shown(
            difference_shown(differences.turned(change)),
            "change",
            remark,
            "Angle between given and refined normals",
        ),
    )
    key = figures.difference_key(
        "angle between given and refined normal",
        {"unchanged": differences.WHITE},
        degrees=True,
    )
    return [Block("Normals", text, key, pictures)]


def _table(result: Result) -> str:
    """Figures of the decision; nothing where there are none."""
    rows = [
        (Cell(LABELS.get(name, name.replace("_", " "))), number(_value(name, value), value))
        for name, value in result.refinement.figures.items()
    ]
    return f'<div class="decision">{table(Table((), rows))}</div>' if rows else ""


def _value(name: str, value: float) -> str:
    if not math.isfinite(value):
        return "unknown"
    if name.endswith("_degrees"):
        return f"{plain(value)}°"
    return percent(value) if name.endswith("_share") else plain(value)
