"""Files that say where the lamps of pictures are: found in a scene folder, read, written.

`.lp` is the form of reflectance transformation imaging: a count, then a line a picture with its
file name and a direction. `lights.csv` is a table, `lights.json` this project's own form. All have
X right, Y up, Z towards the viewer. What is read is rows as they stand in the file; `lamp_names`
tells which picture each is of.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pbrfit._core import InputError
from pbrfit.io.input_files import TEXT_BYTES, read_text, there
from pbrfit.io.json_files import UNFIT, number, read_json, table, text, unfit, whole, write_json
from pbrfit.io.quoting import listed, quoted, shown

LAMP_FILES = ("lights.json", "lights.csv", "light_directions.txt")
"""Names in a scene folder, beside any `*.lp`; the last is that of DiLiGenT (Shi et al. 2016)."""

LAMP_SUFFIXES = (".lp", ".csv", ".txt", ".json")

VERSION = 1
"""Of `lights.json`."""

LENGTH_OFF_MAX = 0.02
"""Largest difference of a direction's length from 1 that is rounding; beyond, vectors of a file are
places on a dome, of which only the direction is known."""

BEHIND_MAX = 0.5
"""Share of directions that may point away from the viewer: above, the file has another Z axis."""

FAR, NEAR = "far", "near"
"""Kinds of lamps in a CSV file."""

COLUMNS = ("picture", "x", "y", "z", "r", "g", "b", "kind")
"""Columns of a table, in the order that they have without a header."""

SYNONYMS = dict.fromkeys(("file", "filename", "image", "imagename", "name"), "picture") | {
    f"{before}{axis}": axis for before in ("l", "d", "light", "dir") for axis in "xyz"
}
"""What other tools call columns."""

Vector = tuple[float, float, float]

UNKNOWN: Vector = (math.nan, math.nan, math.nan)
"""A colour that nobody told."""


@dataclass(frozen=True)
class LampRow:
    """A lamp as a file has it."""

    picture: str
    """Name of the picture that it lights, as written; empty = the file tells by order."""
    place: Vector
    """Unit vector to a far lamp, or where a near one is."""
    near: bool = False
    color: Vector = UNKNOWN
    """Linear Rec.709; NaN = unknown."""
    axis: Vector = (0.0, 0.0, -1.0)
    exponent: float = 0.0


def find_lamps(folder: Path) -> Path | None:
    """The file with lamps that a scene folder has; all but JSON may also lie beside the pictures.

    Raises InputError if there are several.
    """
    found = [path for name in LAMP_FILES if there(path := folder / name)]
    for below in (folder, folder / "images"):
        if below.is_dir():
            beside = LAMP_FILES[1:] if below != folder else ()
            found += sorted(p for p in below.iterdir() if _is_lp(p) or p.name in beside)
    if len(found) > 1:
        names = listed(path.relative_to(folder).as_posix() for path in found)
        raise InputError(f"{folder}: expected one file with lamps, found {names}")
    return found[0] if found else None


def _is_lp(path: Path) -> bool:
    return path.suffix.lower() == ".lp" and not path.name.startswith(".")


def read_lamps(path: Path) -> tuple[list[LampRow], str]:
    """Lamps of a file, and what was decided about them, in words; empty where that is nothing.

    Raises InputError if the file is of another form, or has vectors that are no directions; OSError
    if it cannot be read.
    """
    suffix = path.suffix.lower()
    if suffix not in LAMP_SUFFIXES:
        raise InputError(
            f"{path}: expected lamps in {', '.join(LAMP_SUFFIXES)}, found {shown(path.name)}"
        )
    try:
        rows = {".lp": _of_lp, ".json": _of_json}.get(suffix, _of_csv)(path)
    except csv.Error as error:
        raise unfit(path, "lamps", error) from None
    if not rows:
        raise InputError(f"{path}: expected lamps, found none")
    return _directions(path, rows)


def write_lamps(path: Path, rows: Iterable[LampRow]) -> None:
    """Write `lights.json`."""
    write_json(path, {"version": VERSION, "lamps": [row_as_json(row) for row in rows]})


def _directions(path: Path, rows: list[LampRow]) -> tuple[list[LampRow], str]:
    """Rows whose far lamps have unit vectors."""
    for i, row in enumerate(rows):
        if not all(map(math.isfinite, row.place)):
            raise InputError(
                f"{path}: lamp {i + 1}: expected finite numbers, found NaN or infinity"
            )
        if not row.near and not any(row.place):
            raise InputError(f"{path}: lamp {i + 1}: expected a direction, found (0, 0, 0)")
    far = [row for row in rows if not row.near]
    behind = sum(row.place[2] < 0 for row in far)
    if far and behind > BEHIND_MAX * len(far):
        raise InputError(
            f"{path}: expected Z towards the viewer, found {behind} of {len(far)} directions with "
            "negative z: likely Z away from the viewer"
        )
    lengths = [math.hypot(*row.place) for row in far]
    made = [row if row.near else replace(row, place=unit(row.place)) for row in rows]
    if all(abs(length - 1) <= LENGTH_OFF_MAX for length in lengths):
        return made, ""
    return made, (
        f"vectors of length {min(lengths):.3g} to {max(lengths):.3g} are taken as places on a "
        "dome, of which only the direction counts"
    )


def unit(vector: Vector) -> Vector:
    """The vector at length 1."""
    if abs(math.hypot(*vector) - 1) < 1e-12:
        return vector  # to the bit: what is written and read again stays the same
    largest = max(map(abs, vector))  # squares of it neither overflow nor vanish
    scaled = [one / largest for one in vector]
    length = math.hypot(*scaled)
    return scaled[0] / length, scaled[1] / length, scaled[2] / length


def _lines(path: Path, expected: str) -> tuple[list[str], list[str]]:
    """Lines of a text file that hold something, with comments and without."""
    try:
        text = read_text(path, TEXT_BYTES, "cp1252")
    except UnicodeDecodeError as error:
        raise unfit(path, expected, error) from None
    lines = [line for line in text.splitlines() if re.search(r'[^\s,;"]', line)]
    return lines, [line for line in lines if not line.lstrip().startswith("#")]


def _of_lp(path: Path) -> list[LampRow]:
    expected = "a count, then lines of file name, x, y, z"
    lines = _lines(path, expected)[1]
    if not lines or not re.fullmatch(r"\s*\d{1,9}\s*", lines[0]):
        found = quoted(lines[0]) if lines else "an empty file"
        raise InputError(f"{path}: expected {expected}, found {found} in place of the count")
    if int(lines[0]) != len(lines) - 1:
        raise InputError(
            f"{path}: expected {int(lines[0])} lamps, as it says, found {len(lines) - 1}"
        )
    rows = []
    for i, line in enumerate(lines[1:]):
        # Names may have in them what divides columns; after a direction there may be a colour.
        spaced = line.rstrip(" \t,;").replace(";", " ").replace(", ", "  ")
        parts = spaced.rsplit(maxsplit=3)
        name = line[: len(parts[0])].strip()
        if len(parts) != 4 or re.search(r"\s[-+]?\d*\.\d+(\s+[-+]?[\d.]+){2}$", name):
            raise InputError(
                f"{path}: lamp {i + 1}: expected file name, x, y, z, found {quoted(line)}"
            )
        rows.append((name, *parts[1:]))
    return _of_rows(path, COLUMNS[:4], rows)


_SPLIT = r"[-+−]?\d+,\d+"  # 0,6 in two cells


def _of_csv(path: Path) -> list[LampRow]:
    expected = f"a table with the columns {', '.join(COLUMNS[:4])}, and maybe r, g, b and kind"
    lines, body = _lines(path, expected)
    told = re.fullmatch(r'"?sep=([;,|\t ])"?\s*', lines[0], re.IGNORECASE) if lines else None
    body = body[1:] if told else body
    if not body:
        raise InputError(f"{path}: expected {expected}, found an empty file")
    # Decimal commas may outnumber what divides columns.
    separator = next((of for of in "\t;, " if len(_cells(body[0], of)) >= 3), ",")
    separator = told[1] if told else separator
    rows = [_cells(line, separator) for line in body]
    above = lines[: lines.index(body[0]) + 1]  # a header may have the sign of a comment
    heads = [_columns(_cells(line.lstrip("# \t"), separator)) for line in above]
    header = next((head for head in heads if {"x", "y", "z"} <= set(head)), ())
    hint, wide = "", max(map(len, rows))
    if separator == "," and not any("." in cell for row in rows for cell in row[1:]):
        hint = "; numbers with decimal commas need semicolons or tabs between columns"
    if header:
        if not set(header) <= set(COLUMNS) or len(set(header)) < len(header):
            raise InputError(f"{path}: expected {expected}, found {listed(header)}")
        rows = rows[1:] if header is heads[-1] else rows
    else:
        header = {3: COLUMNS[1:4], 4: COLUMNS[:4], 7: COLUMNS[:7], 8: COLUMNS}.get(wide, ())
        split = (re.fullmatch(rf"{_SPLIT}(,{_SPLIT}){{2}}", ",".join(row[-6:])) for row in rows)
        if not header or (hint and wide == 7 and any(split)):
            raise InputError(
                f"{path}: expected {expected}, found {wide} columns without a header{hint}"
            )
    for i, row in enumerate(rows):
        while len(row) > len(header) and not row[-1]:  # spreadsheets' empty columns
            row.pop()
        if len(row) != len(header):
            raise InputError(
                f"{path}: lamp {i + 1}: expected {len(header)} values, found {len(row)}{hint}"
            )
    return _of_rows(path, header, rows)


def _cells(line: str, separator: str) -> list[str]:
    """Cells of a line of a table."""
    reader = csv.reader([line.strip(" ")], delimiter=separator, skipinitialspace=True)
    return [cell.strip() for cell in next(reader)]


def _columns(cells: Sequence[str]) -> tuple[str, ...]:
    """Columns that a header names, as of `COLUMNS` where they are such."""
    names = ",".join(re.sub(r"[\W_]", "", cell.casefold()) for cell in cells).rstrip(",")
    return tuple(SYNONYMS.get(name, name) for name in names.split(","))


def _of_rows(path: Path, columns: Sequence[str], table: Sequence[Sequence[str]]) -> list[LampRow]:
    """Lamps of a table."""
    rows = [dict(zip(columns, cells, strict=True)) for cells in table]
    numbers = [row.get(name, "") for row in rows for name in COLUMNS[1:7]]
    commas = [cell for cell in numbers if "," in cell]
    # 1,234 alone may be a thousand or one; 0,5 or 1,25 beside it tell that commas are decimal.
    thousands = all(re.fullmatch(r"[-+−]?[1-9]\d{0,2}(,\d{3})+", cell) for cell in commas)
    if commas and (thousands or any("." in cell for cell in numbers)):
        raise InputError(
            f"{path}: expected numbers as 0.5 or all as 0,5, found {quoted(commas[0])}"
        )
    return [_of_row(path, i, row) for i, row in enumerate(rows)]


def _of_row(path: Path, i: int, row: dict[str, str]) -> LampRow:
    """A line of a table by its columns."""
    kind = row.get("kind", "").lower() or FAR
    if kind not in (FAR, NEAR):
        raise InputError(
            f"{path}: lamp {i + 1}: expected kind {FAR} or {NEAR}, found {quoted(kind)}"
        )
    color = _vector(path, i, [row.get(name, "") or "nan" for name in "rgb"])
    place = _vector(path, i, [row[name] for name in "xyz"])
    return LampRow(row.get("picture", ""), place, kind == NEAR, color=_color(path, i, color))


def _vector(path: Path, i: int, cells: Sequence[str]) -> Vector:
    try:
        x, y, z = (float(cell.replace(",", ".").replace("−", "-")) for cell in cells)
    except ValueError:
        raise InputError(
            f"{path}: lamp {i + 1}: expected numbers, found {quoted(' '.join(cells))}"
        ) from None
    return x, y, z


def _color(path: Path, i: int, color: Vector) -> Vector:
    if any(value < 0 or math.isinf(value) for value in color):
        raise InputError(
            f"{path}: lamp {i + 1}: expected a color of 0 or more, found {quoted(color)}"
        )
    return color


def _of_json(path: Path) -> list[LampRow]:
    expected = "JSON with version and lamps, each with picture and direction or position"
    content = read_json(path, expected)
    try:
        content = table(content)
        version, lamps = whole(content["version"]), content["lamps"]
        if version != VERSION:
            raise ValueError(f"version {version} in place of {VERSION}")
        if not isinstance(lamps, list):
            raise ValueError(f"{quoted(lamps)} in place of a list of lamps")
    except UNFIT as error:
        raise unfit(path, expected, error) from None
    return rows_of_json(path, lamps)


def rows_of_json(path: Path, lamps: Sequence[Any]) -> list[LampRow]:
    """Lamps of a list in a JSON file; InputError names the file and which of them is none."""
    rows = []
    for i, lamp in enumerate(lamps):
        try:
            rows.append(_from_json(path, i, table(lamp)))
        except UNFIT as error:
            if isinstance(error, InputError):
                raise
            what = "picture and direction or position"
            raise unfit(f"{path}: lamp {i + 1}", what, error) from None
    return rows


KEYS = ("picture", "direction", "position", "color", "axis", "exponent")


def _from_json(path: Path, i: int, lamp: dict[str, Any]) -> LampRow:
    unknown = [key for key in lamp if key not in KEYS]
    if unknown:
        raise ValueError(f"key {quoted(unknown[0])} in place of {', '.join(KEYS)}")
    near = "position" in lamp
    if near == ("direction" in lamp):
        raise ValueError("both or neither of direction and position")
    row = LampRow(text(lamp["picture"]), _numbers(lamp["position" if near else "direction"]), near)
    if lamp.get("color") is not None:
        values = [math.nan if one is None else one for one in lamp["color"]]
        row = replace(row, color=_color(path, i, _numbers(values, finite=False)))
    if not near and {"axis", "exponent"} & set(lamp):
        raise ValueError("axis or exponent of a lamp without position")
    if "axis" in lamp:
        axis = _numbers(lamp["axis"])
        if not any(axis):
            raise ValueError("axis (0, 0, 0)")
        row = replace(row, axis=unit(axis))
    exponent = number(lamp.get("exponent", 0.0))
    if exponent < 0:
        raise ValueError(f"exponent {exponent:g} in place of 0 or more")
    return replace(row, exponent=exponent)


def _numbers(value: Any, *, finite: bool = True) -> Vector:
    if not isinstance(value, list) or len(value) != 3:
        raise ValueError(f"{quoted(value)} in place of three numbers")
    x, y, z = (
        one if not finite and isinstance(one, float) and math.isnan(one) else number(one)
        for one in value
    )
    return x, y, z


def row_as_json(row: LampRow) -> dict[str, Any]:
    """What `rows_of_json` reads."""
    made: dict[str, Any] = {"picture": row.picture}
    made["position" if row.near else "direction"] = list(row.place)
    if not all(map(math.isnan, row.color)):
        made["color"] = [None if math.isnan(value) else value for value in row.color]
    if row.near and (row.exponent or row.axis != LampRow.axis):
        made |= {"axis": list(row.axis), "exponent": row.exponent}
    return made
