"""Files that say where the lamps of pictures are: found in a scene folder, read, paired, written.

`.lp` is the form of reflectance transformation imaging: a count, then a line a picture with its
file name and a direction. `.relight` is RelightLab's. All have X right, Y up, Z to the viewer.
"""

from __future__ import annotations

import csv
import logging
import math
import re
import unicodedata
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from pbrfit.io.input_files import LIST_BYTES, read_text, unexpected
from pbrfit.io.json_files import expecting, number, read_json, table, text, unfit, write_json
from pbrfit.values.quoting import listed, quoted, shown

log = logging.getLogger("pbrfit")

LAMP_FILES = ("lights.json", "lights.csv", "light_directions.txt")
"""Names in a scene folder, beside any `*.lp`; the last is that of DiLiGenT (Shi et al. 2016)."""

NAMES = {".txt": "filenames.txt", ".json": "*.sfm"}
"""Patterns of files that tell whose lamps are: names of DiLiGenT, views of Meshroom."""

VERSION = 1
"""Of `lights.json`."""

LAMPS_MAX = 10_000
"""Lamps of a file: a hundred for each of a hundred pictures."""

LENGTH_OFF_MAX = 0.02
"""Largest excess of a direction's length that is rounding; beyond, a file has places on a dome."""

BEHIND_MAX = 0.5
"""Share of directions that may point away from the viewer: above, the file has another Z axis."""

KEYS = ("picture", "direction", "position", "color", "axis", "exponent")

COLUMNS = ("picture", "x", "y", "z", "r", "g", "b", "kind")
"""Columns of a table, in the order that they have without a header."""

SYNONYMS = dict.fromkeys(("file", "filename", "image", "imagename", "name"), "picture") | {
    f"{before}{axis}": axis for before in ("l", "d", "light", "dir") for axis in "xyz"
}

QUOTES = "\"'`´“”„‟‘’‚‛«»‹›"
"""Marks that writers of names with spaces put around them."""

_is_row = re.compile(r"\s*[^#\s]").match
_EXTENSION = r"\.(?=\w*[^\W\d])\w{1,5}"
"""Up to five letters and digits, not digits alone: those of `scan.001` tell scans apart."""

_MORE_NUMBERS = re.compile(
    rf"(\s[-+]?\d*\.\d+(\s+[-+]?[\d.]+){{2}}|{_EXTENSION}(\s+[-+]?\d*\.\d+)+)$"
)
"""End of a name with more columns of `.lp` in it: three numbers, or some behind a suffix."""

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


def find_lamps(folder: Path) -> list[Path]:
    """The file with lamps that a scene folder has, then those of `NAMES` beside it.

    All but JSON may also lie beside the pictures. Raises InputError if there are several.
    """
    found = [
        path
        for below, names in ((folder, LAMP_FILES), (folder / "images", LAMP_FILES[1:]))
        if below.is_dir()
        for path in sorted(below.iterdir())
        if path.name in names or re.fullmatch(r"[^.].*\.(lp|relight)", path.name, re.IGNORECASE)
    ]
    if len(found) > 1:
        every = listed(path.relative_to(folder).as_posix() for path in found)
        raise unexpected(folder, "one file with lamps", every)
    return [*found, *(beside for path in found for beside in _names(path))]


def _names(path: Path) -> list[Path]:
    """Files of `NAMES` beside one with lamps."""
    pattern = NAMES.get(path.suffix.lower())
    return sorted(path.parent.glob(pattern)) if pattern else []


def read_lamps(path: Path) -> tuple[list[LampRow], str]:
    """Lamps of a file, far ones with unit vectors, and in words what was assumed, if anything.

    Raises InputError if the file is of another form, or has vectors that are no directions.
    """
    readers = {".lp": _of_lp, ".csv": _of_csv, ".txt": _of_csv}
    readers |= dict.fromkeys((".json", ".relight"), _of_json)
    read = readers.get(path.suffix.lower())
    if read is None:
        raise unexpected(path, f"lamps in {', '.join(readers)}", "another form")
    try:
        rows = read(path)
    except csv.Error as error:
        raise unfit(path, "lamps", error) from None
    if not rows:
        raise unexpected(path, "lamps", "none")
    far = [row.place for row in rows if not row.near]
    behind = sum(z < 0 for _, _, z in far)
    if behind > BEHIND_MAX * len(far):
        found = f"{behind} of {len(far)} directions with negative z: likely Z away from the viewer"
        raise unexpected(path, "Z towards the viewer", found)
    lengths = [math.hypot(*place) for place in far]
    said = ""
    if any(abs(length - 1) > LENGTH_OFF_MAX for length in lengths):
        said = (
            f"vectors of length {min(lengths):.3g} to {max(lengths):.3g} are taken as places on a "
            "dome, of which only the direction counts"
        )
    return [row if row.near else replace(row, place=unit(row.place)) for row in rows], said


def write_lamps(path: Path, entries: Sequence[Any]) -> None:
    """Write `lights.json`, of entries as `rows_of_json` reads them."""
    write_json(path, {"version": VERSION, "lamps": entries})


def unit(vector: Vector) -> Vector:
    """The vector at length 1; one that has it to 1e-12 stays as it is, to the bit."""
    length = math.hypot(*vector)
    x, y, z = vector if abs(length - 1) < 1e-12 else (one / length for one in vector)
    return x, y, z


def _lines(path: Path) -> list[str]:
    """Lines of a text file that hold something, comments among them."""
    lines = read_text(path, LIST_BYTES, "cp1252").splitlines()
    return [line for line in lines if re.search(r'[^\s,;"]', line)]


def _of_lp(path: Path) -> list[LampRow]:
    lines = list(filter(_is_row, _lines(path)))
    if not lines or not re.fullmatch(r"\s*\d{1,9}\s*", lines[0]):
        found = quoted(lines[0]) if lines else "an empty file"
        expected = "a count, then lines of file name, x, y, z"
        raise unexpected(path, expected, f"{found} in place of the count")
    count = int(lines.pop(0).strip())  # of more than `int` takes for blank
    if count != len(lines):
        raise unexpected(path, f"{count} lamps, as it says", len(lines))
    rows = []
    for i, line in enumerate(lines):
        # Names may have in them what divides columns; after a direction there may be a colour.
        spaced = line.rstrip(" \t,;").replace(";", " ").replace(", ", "  ")
        parts = spaced.rsplit(maxsplit=3)
        name = line[: len(parts[0])].strip()
        if len(parts) != 4 or _MORE_NUMBERS.search(name):
            raise unexpected(f"{path}: lamp {i + 1}", "file name, x, y, z", quoted(line))
        rows.append((name, *parts[1:]))
    return _of_rows(path, COLUMNS[:4], rows)


def _of_csv(path: Path) -> list[LampRow]:
    expected = f"a table with the columns {', '.join(COLUMNS[:4])}, and maybe r, g, b and kind"
    lines = _lines(path)
    told = re.fullmatch(r'"?sep\s*=\s*([;,|\t ])"?\s*', lines[0], re.IGNORECASE) if lines else None
    lines = lines[bool(told) :]
    first = next((i for i, line in enumerate(lines) if _is_row(line)), None)
    if first is None:
        raise unexpected(path, expected, "an empty file")
    # Decimal commas may outnumber what divides columns.
    likely = (of for of in "\t;, " if len(_cells(lines[first], of)) >= 3)
    separator = told[1] if told else next(likely, ",")
    rows = [_cells(line, separator) for line in filter(_is_row, lines)]
    # A header may have the sign of a comment.
    bare = (_cells(line.lstrip("# \t"), separator) for line in lines[: first + 1])
    named = (",".join(re.sub(r"[\W_]", "", one.casefold()) for one in of) for of in bare)
    heads = [tuple(SYNONYMS.get(n, n) for n in of.rstrip(",").split(",")) for of in named]
    header = next((head for head in heads if {"x", "y", "z"} <= set(head)), ())
    hint, wide, titled = "", max(map(len, rows)), bool(header)
    if not header and not any(map(re.compile(r"\d").search, rows[0])):
        header = heads[-1]  # of other columns
    if separator == "," and not any("." in cell for row in rows for cell in row[1:]):
        hint = "; numbers with decimal commas need semicolons or tabs between columns"
    if header:
        if not set(header) <= set(COLUMNS) or len(set(header)) < len(header):
            raise unexpected(path, expected, listed(header))
        rows = rows[1:] if header is heads[-1] else rows
    else:
        header = {3: COLUMNS[1:4], 4: COLUMNS[:4], 7: COLUMNS[:7], 8: COLUMNS}.get(wide, ())
        # 0,6 in two cells is two whole numbers.
        split = (all(re.fullmatch(r"[-+−]?\d+", cell) for cell in row[-6:]) for row in rows)
        if not header or (hint and wide == 7 and any(split)):
            raise unexpected(path, expected, f"{wide} columns without a header{hint}")
    for i, row in enumerate(rows):
        while len(row) > len(header) and not row[-1]:  # spreadsheets' empty columns
            row.pop()
        if len(row) != len(header):
            raise unexpected(f"{path}: lamp {i + 1}", f"{len(header)} values", f"{len(row)}{hint}")
    lamps = _of_rows(path, header, rows)
    if not titled and _maybe_angles([lamp.place for lamp in lamps if not lamp.near]):
        found = "none, and numbers that may be azimuth and elevation"
        raise unexpected(path, "a header with x, y, z", found)
    for beside in _names(path):
        names = [line.strip() for line in _lines(beside)]
        if len(names) != len(lamps):
            expected = f"a name for each of the {len(lamps)} lamps in {path.name}"
            raise unexpected(beside, expected, len(names))
        lamps = [replace(lamp, picture=name) for lamp, name in zip(lamps, names, strict=True)]
    return lamps


def _maybe_angles(places: Sequence[Vector]) -> bool:
    """Whether x, y, z may be azimuth, elevation, radius, or a lamp's number and both, in degrees.

    Vectors have no one length then, as those to places on a dome have.
    """
    lengths = [math.hypot(*place) for place in places]
    if not places or max(lengths) <= (1 + LENGTH_OFF_MAX) * min(lengths):
        return False
    x, y, z = zip(*places, strict=True)
    numbered = all(after - before == 1 for before, after in pairwise(x))
    azimuths, elevations = (y, z) if numbered else (x, y)
    upper = min(elevations) >= 0 and 0 < max(elevations) <= 90
    return upper and max(map(abs, azimuths)) <= 360 and (numbered or len(set(z)) == 1)


def _cells(line: str, separator: str) -> list[str]:
    """Cells of a line of a table."""
    reader = csv.reader([line.strip(" ")], delimiter=separator, skipinitialspace=True)
    return [cell.strip() for cell in next(reader)]


def _of_rows(path: Path, columns: Sequence[str], table: Sequence[Sequence[str]]) -> list[LampRow]:
    """Lamps of a table."""
    rows = [dict(zip(columns, cells, strict=True)) for cells in table]
    numbers = [row.get(name, "") for row in rows for name in COLUMNS[1:7]]
    commas = [cell for cell in numbers if "," in cell]
    # 1,234 alone may be a thousand or one; 0,5 or 1,25 beside it tell that commas are decimal.
    thousands = all(re.fullmatch(r"[-+−]?[1-9]\d{0,2}(,\d{3})+", cell) for cell in commas)
    if commas and (thousands or any("." in cell for cell in numbers)):
        raise unexpected(path, "numbers as 0.5 or all as 0,5", quoted(commas[0]))
    return rows_of_json(path, rows, _as_json)


def _as_json(row: dict[str, str]) -> dict[str, Any]:
    """A row of a table as an entry of `lights.json`."""
    kind = row.get("kind", "").lower()
    if kind not in ("far", "near", ""):
        raise ValueError(f"kind {quoted(kind)} in place of far or near")
    known = {key: cell for key, cell in row.items() if cell.lower() not in ("", "nan")}
    x, y, z, r, g, b = (
        float(known[key].replace(",", ".").replace("−", "-")) if key in known else None
        for key in COLUMNS[1:7]
    )
    place = "position" if kind == "near" else "direction"
    return {"picture": row.get("picture", ""), place: [x, y, z], "color": [r, g, b]}


def _of_json(path: Path) -> list[LampRow]:
    expected = "JSON with version and lamps, each with picture and direction or position"
    content = read_json(path, expected)
    with expecting(path, expected):
        content = table(content)
        if "lights" in content:
            return _of_meshroom(path, content["lights"])
        if "images" in content:  # a project of RelightLab
            seen = [one for one in map(table, content["images"]) if not one.get("skip")]
            lamps = [(one["filename"], [one["direction"][c] for c in "xyz"]) for one in seen]
            return rows_of_json(path, [{"picture": p, "direction": d} for p, d in lamps])
        version, lamps = content["version"], list(content["lamps"])
        if version != VERSION:
            raise ValueError(f"version {quoted(version)} in place of {VERSION}")
    return rows_of_json(path, lamps)


def _of_meshroom(path: Path, lights: Any) -> list[LampRow]:
    """Lamps of Meshroom's light calibration: by number of a view, of which an .sfm file has paths.

    Its axes are X right, Y down and Z into the picture; numbers may be texts.
    """
    expected, views = "one .sfm file beside it with the paths of its views", _names(path)
    if len(views) != 1:
        raise unexpected(path, expected, len(views))
    content = read_json(views[0], expected)
    with expecting(views[0], "views with viewId and path"):
        found = [table(view) for view in table(content)["views"]]
        names = {str(view["viewId"]): text(view["path"]) for view in found}

    def entry(light: Any) -> dict[str, Any]:
        x, y, z = map(float, light["direction"])
        return {"picture": names[str(light["viewId"])], "direction": [x, -y, -z]}

    return rows_of_json(path, list(lights), entry)


def rows_of_json(
    path: Path, lamps: Sequence[Any], entry: Callable[[Any], Any] = table
) -> list[LampRow]:
    """Lamps of a list, or of what `entry` makes of each; InputError names the file and which."""
    rows = []
    if len(lamps) > LAMPS_MAX:
        raise unexpected(path, f"at most {LAMPS_MAX} lamps", len(lamps))
    for i, lamp in enumerate(lamps):
        with expecting(f"{path}: lamp {i + 1}", "picture and direction or position"):
            rows.append(_from_json(entry(lamp)))
    return rows


def _from_json(lamp: dict[str, Any]) -> LampRow:
    unknown = [key for key in lamp if key not in KEYS]
    if unknown:
        raise ValueError(f"key {quoted(unknown[0])} in place of {', '.join(KEYS)}")
    near = "position" in lamp
    if near == ("direction" in lamp):
        raise ValueError("both or neither of direction and position")
    if not near and {"axis", "exponent"} & set(lamp):
        raise ValueError("axis or exponent of a lamp without position")
    place = _numbers(lamp["position" if near else "direction"])
    color = UNKNOWN if lamp.get("color") is None else _numbers(lamp["color"], known=False)
    axis = _numbers(lamp["axis"]) if "axis" in lamp else LampRow.axis
    exponent = number(lamp.get("exponent", 0.0))
    for name, vector in (("direction", place), ("axis", axis)):
        if not any(vector) and name in lamp:
            raise ValueError(f"{name} (0, 0, 0)")
    for name, values in (("color", color), ("exponent", (exponent,))):
        if any(value < 0 for value in values):
            raise ValueError(f"{name} {quoted(lamp[name])} in place of 0 or more")
    return LampRow(text(lamp["picture"]), place, near, color, unit(axis), exponent)


def _numbers(value: Any, *, known: bool = True) -> Vector:
    """Three numbers; null is NaN where they need not all be known."""
    if not isinstance(value, list) or len(value) != 3:
        raise ValueError(f"{quoted(value)} in place of three numbers")
    x, y, z = (math.nan if one is None and not known else number(one) for one in value)
    return x, y, z


def matched(path: Path, given: Sequence[str], names: Sequence[str]) -> tuple[list[int], str]:
    """Index of the picture of each lamp of a file, -1 where there is none, and what was assumed.

    `given` are names in the file, empty where it has none; `names` are those of the pictures. They
    are compared without folder, quotes and surrounding spaces, with or without extension; then
    without case and forms of Unicode; then without up to two extensions. The way counts by which
    most pictures have a lamp. Where no name is a picture's, numbers in names tell, if both sides
    have the same; else order, if alphabet and numbers agree on it on both sides.

    Raises InputError if some picture has no lamp, or those of several names, or nothing pairs them.
    """
    ways = [[-1] * len(given)]
    for way in range(3):
        places = {_forms(name)[way][0]: i for i, name in enumerate(names)}
        if len(places) == len(names):  # else names differ in what is left out
            forms = (_forms(one)[way] for one in given)
            ways.append([next((places[f] for f in of if f in places), -1) for of in forms])
    best = max(ways, key=lambda found: len(set(found) - {-1}))
    if max(best) < 0:
        return _by_sequence(path, given, names)
    spare = [one for one, i in zip(given, best, strict=True) if i < 0]
    others = f"no picture is called {quoted(spare[0])}{_more(spare)}" if spare else ""
    first: dict[int, str] = {}
    for one, i in zip(given, best, strict=True):
        if first.setdefault(i, one) != one and i >= 0:  # a name may come again: several lamps
            found = f"{shown(first[i])} and {shown(one)}"
            raise unexpected(path, f"one name for picture {shown(names[i])}", found)
    without = [name for i, name in enumerate(names) if i not in first]
    if without:
        found = f"none for {shown(without[0])}{_more(without)}" + f"; {others}" * bool(others)
        raise unexpected(path, "a lamp for every picture", found)
    return best, f"some left out: {others}" * bool(others)


def _forms(name: str) -> tuple[tuple[str, ...], ...]:
    """What a name is compared by, strictest first: as written, folded, and without extensions."""
    last = re.split(r"[/\\]", name)[-1].strip(QUOTES + " \t\u00a0")
    written = last, re.sub(f"{_EXTENSION}$", "", last)
    folded = tuple(unicodedata.normalize("NFKC", one).casefold().strip() for one in written)
    return written, folded, (re.sub(f"({_EXTENSION}){{1,2}}$", "", folded[0]),)


def _by_sequence(path: Path, given: Sequence[str], names: Sequence[str]) -> tuple[list[int], str]:
    """As `matched`, where no name is that of a picture: a warning always lists the pairs."""
    if len(given) != len(names):
        found = f"{len(given)}, none with a picture's name"
        found += f" (such as {shown(given[0])})" if given[0] else ""
        raise unexpected(path, f"a lamp for each of the {len(names)} pictures", found)
    numbers, captured = _by_number(names), _by_number(given)
    # Copies of captures keep their numbers. A set of names that differ in one number alone, each
    # with the same numbers as the pictures, is named by them as it would be by words.
    if numbers and numbers.keys() == captured.keys():
        pictures, how = [numbers[one] for one in captured], "the numbers in names"
    else:
        for of in (names, [_forms(one)[0][0] for one in given]):
            # A program that sorts img10 before img2 may have made either sequence.
            for a, b in (*pairwise(of), *pairwise(sorted(of))):
                if _natural(b) < _natural(a):
                    found = f"{shown(given[0]) or 'none'}{_more(given)}; by order they cannot be "
                    found += f"paired, as {shown(a)} comes before {shown(b)}: rename or pad"
                    raise unexpected(path, "names of pictures", found)
        pictures, how = list(range(len(names))), "order"
    how = f"matched to the pictures by {how}, as no name in it is that of a picture"
    pairs = enumerate(zip(given[:3], pictures, strict=False), 1)
    some = ", ".join(f"{shown(one) or f'lamp {k}'} with {shown(names[i])}" for k, (one, i) in pairs)
    log.warning("%s: lamps are %s: %s%s", path, how, some, _more(given[2:]))
    return pictures, how


def _by_number(names: Sequence[str]) -> dict[str, int]:
    """Indices of names by number, in order; empty unless names differ in one number alone."""
    plain = [_forms(name)[2][0] for name in names]
    if len({re.sub(r"\d+", "0", name) for name in plain}) > 1:
        return {}
    columns = zip(*(re.findall(r"\d+", name) for name in plain), strict=True)
    varied = [column for column in columns if len(set(column)) > 1]
    found = {number.lstrip("0"): i for i, number in enumerate(varied[0])} if varied else {}
    return found if len(varied) == 1 and len(found) == len(names) else {}


def _natural(name: str) -> tuple[str, str]:
    """By what names are in the order of their numbers, which have at most 20 digits."""
    return re.sub(r"\d+", lambda digits: digits[0].zfill(20), name), name


def _more(names: Sequence[str]) -> str:
    return f" and {len(names) - 1} more" if len(names) > 1 else ""
