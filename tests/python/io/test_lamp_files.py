"""Files of lamps: `.lp`, `lights.csv`, `lights.json`, and what is refused in them."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pbrfit import InputError
from pbrfit.io.lamp_files import LampRow, find_lamps, matched, read_lamps, write_lamps

NAMES = ("a", "b", "c")
THIRD = 1 / math.sqrt(3)
LP = "3\na.jpg 0.6 0 0.8\nb.jpg 0 0.6 0.8\nc.jpg 0 0 1\n"
TABLE = "picture,x,y,z\na,0.6,0,0.8\nb,0,0.6,0.8\nc,0,0,1\n"


def lamp(**changes: Any) -> dict[str, Any]:
    return {"picture": "a", "direction": [0, 0, 1]} | changes


def as_json(*lamps: dict[str, Any], version: int = 1) -> str:
    return json.dumps({"version": version, "lamps": lamps})


JSON = as_json(
    lamp(direction=[0.6, 0, 0.8]),
    lamp(picture="b", direction=[0, 0.6, 0.8]),
    lamp(picture="c"),
)


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("dome.lp", LP),
        ("dome.LP", LP.replace(" ", "\t").replace("\n", "\r\n")),
        ("lights.csv", TABLE),
        ("lights.csv", "\ufeff" + TABLE.replace(",", ";")),
        ("lights.csv", TABLE.partition("\n")[2]),
        ("lights.csv", "z,kind,Picture,X,y\n0.8,far,a,0.6,0\n0.8,,b,0,0.6\n1,FAR,c,0,0\n"),
        ("lights.json", JSON),
    ],
)
def test_each_form_gives_the_same_directions(tmp_path: Path, name: str, text: str) -> None:
    path = written(tmp_path, name, text)
    rows, said = read_lamps(path)
    assert not said
    np.testing.assert_allclose([r.place for r in rows], [(0.6, 0, 0.8), (0, 0.6, 0.8), (0, 0, 1)])
    assert not any(row.near for row in rows)
    assert np.isnan([row.color for row in rows]).all()
    assert matched(path, rows, NAMES) == ([0, 1, 2], True)


def test_places_on_a_dome_are_directions_and_it_says_so(tmp_path: Path) -> None:
    rows, said = read_lamps(written(tmp_path, "dome.lp", "2\na 30 0 40\nb 0 0 55\n"))
    np.testing.assert_allclose([row.place for row in rows], [(0.6, 0, 0.8), (0, 0, 1)])
    assert said.startswith("vectors of length 50 to 55 are taken as places on a dome")


@pytest.mark.parametrize(("length", "told"), [(1.0199, False), (1.0201, True), (0.9799, True)])
def test_lengths_are_rounding_up_to_the_threshold(
    tmp_path: Path, length: float, told: bool
) -> None:
    rows, said = read_lamps(written(tmp_path, "d.lp", f"1\na 0 0 {length}\n"))
    assert rows[0].place == (0.0, 0.0, 1.0)
    assert bool(said) == told


def test_colors_and_near_lamps_of_a_table(tmp_path: Path) -> None:
    text = "a,1,2,-3,0.5,0.25,1,near\nb,0,0,1,,,,far\n"
    near, far = read_lamps(written(tmp_path, "lights.csv", text))[0]
    assert near == LampRow("a", (1, 2, -3), True, (0.5, 0.25, 1))
    assert (far.near, far.place) == (False, (0, 0, 1))
    assert np.isnan(far.color).all()


def test_near_lamps_of_lights_json_come_back(tmp_path: Path) -> None:
    rows = [
        LampRow("a", (1.0, 2.0, -3.0), True, (0.5, 0.25, 1.0), (0.6, 0.0, -0.8), 2.5),
        LampRow("b", (0.0, 0.0, 1.0)),
        LampRow("b", (THIRD, THIRD, THIRD), color=(1.0, math.nan, 0.0)),
    ]
    write_lamps(tmp_path / "lights.json", rows)
    assert repr(read_lamps(tmp_path / "lights.json")[0]) == repr(rows)  # NaN is not itself


@pytest.mark.parametrize(
    ("written_as", "names"),
    [
        ("A.JPG", ("a", "b")),
        ("captures/a.tif", ("a", "b")),
        ("C:\\rig\\a", ("a", "b")),
        ("A.b", ("a.b", "b")),
    ],
)
def test_names_match_without_folder_suffix_and_case(
    written_as: str, names: tuple[str, ...]
) -> None:
    rows = [LampRow("B.png", (0, 0, 1)), LampRow(written_as, (0, 0, 1))]
    assert matched(Path("x.lp"), rows, names) == ([1, 0], True)


def test_names_that_differ_in_case_alone_are_told_apart() -> None:
    rows = [LampRow("A", (0, 0, 1)), LampRow("a", (0, 0, 1))]
    assert matched(Path("x.lp"), rows, ("a", "A")) == ([1, 0], True)


def test_without_any_name_the_order_counts() -> None:
    rows = [LampRow(f"IMG_{i}", (0, 0, 1)) for i in range(3)]
    assert matched(Path("x.lp"), rows, NAMES) == ([0, 1, 2], False)


BAD_MATCHES: dict[str, tuple[tuple[str, ...], str]] = {
    "another count": (
        ("x", "y"),
        r"x.lp: expected a lamp for each of the 3 pictures, found 2, .* \(such as x\)",
    ),
    "names not there": (
        ("a", "b", "c", "d", "e"),
        "x.lp: expected names of pictures, found d and 1 more, which no picture has",
    ),
    "a picture without a lamp": (
        ("a", "b", "a"),
        "x.lp: expected a lamp for every picture, found none for c$",
    ),
}


@pytest.mark.parametrize("name", BAD_MATCHES)
def test_files_of_other_pictures_are_refused(name: str) -> None:
    pictures, message = BAD_MATCHES[name]
    with pytest.raises(InputError, match=message):
        matched(Path("x.lp"), [LampRow(one, (0, 0, 1)) for one in pictures], NAMES)


BAD_FILES: dict[str, tuple[str, str, str]] = {
    "another form": ("lights.txt", LP, r"lights.txt: expected lamps in .lp, .csv, .json"),
    "no text": ("d.lp", "", "d.lp: expected a count, .* found an empty file in place of the count"),
    "no count": ("d.lp", "a.jpg 0 0 1\n", "found 'a.jpg 0 0 1' in place of the count"),
    "another count": ("d.lp", "3\na 0 0 1\n", "expected 3 lamps, as it says, found 1"),
    "no lamps": ("d.lp", "0\n", "d.lp: expected lamps, found none"),
    "a short line": ("d.lp", "1\n0 0 1\n", "lamp 1: expected file name, x, y, z, found '0 0 1'"),
    "words": ("d.lp", "1\na up 0 1\n", "lamp 1: expected numbers, found 'up 0 1'"),
    "NaN": ("d.lp", "1\na nan 0 1\n", "lamp 1: expected finite numbers, found NaN"),
    "infinity": ("d.lp", "1\na 0 0 inf\n", "lamp 1: expected finite numbers, found NaN or inf"),
    "a zero vector": ("d.lp", "2\na 0 0 1\nb 0 0 0\n", r"lamp 2: .*direction, found \(0, 0, 0\)"),
    "another Z": (
        "d.lp",
        "3\na 0 0 -1\nb 0.6 0 -0.8\nc 1 0 0\n",
        "expected Z towards the viewer, found 2 of 3 .*: likely Z away from the viewer",
    ),
    "an empty table": ("lights.csv", "\n;;;\n", "lights.csv: expected a table .*an empty file"),
    "another column": ("lights.csv", "x,y,z,w\n1,0,0,0\n", "expected a table .* found w, x, y, z"),
    "too many columns": ("lights.csv", "a,1,2,3,4\n", "found 5 columns without a header"),
    "a short row": ("lights.csv", TABLE + "d,1\n", "lamp 4: expected 4 values, found 2"),
    "another kind": (
        "lights.csv",
        "a,0,0,1,1,1,1,spot\n",
        "lamp 1: expected kind far or near, found 'spot'",
    ),
    "a negative color": (
        "lights.csv",
        "a,0,0,1,1,-1,1\n",
        "lamp 1: expected a color of 0 or more, found",
    ),
    "no JSON": ("lights.json", "[", "lights.json: expected JSON with version and lamps"),
    "a list": ("lights.json", "[]", "lights.json: expected JSON with version and lamps"),
    "another version": ("lights.json", as_json(version=2), "version 2 in place of 1"),
    "no picture": (
        "lights.json",
        as_json({"direction": [0, 0, 1]}),
        "lamp 1: expected picture and direction or position, found KeyError",
    ),
    "no place": ("lights.json", as_json({"picture": "a"}), "lamp 1: .*both or neither"),
    "two places": ("lights.json", as_json(lamp(position=[0, 0, 1])), "lamp 1: .*both or neither"),
    "two numbers": ("lights.json", as_json(lamp(direction=[0, 1])), "in place of three numbers"),
    "a text": ("lights.json", as_json(lamp(direction=[0, 0, "1"])), "in place of a number"),
    "another key": ("lights.json", as_json(lamp(colour=[1, 1, 1])), "key 'colour' in place of"),
    "a far axis": ("lights.json", as_json(lamp(axis=[0, 0, 1])), "lamp without position"),
    "a negative colour": ("lights.json", as_json(lamp(color=[0, 0, -1])), "color of 0 or more"),
    "a zero axis": (
        "lights.json",
        as_json({"picture": "a", "position": [0, 0, 1], "axis": [0, 0, 0]}),
        r"lamp 1: .*axis \(0, 0, 0\)",
    ),
    "a negative exponent": (
        "lights.json",
        as_json({"picture": "a", "position": [0, 0, 1], "exponent": -1}),
        "exponent -1 in place of 0 or more",
    ),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_files_are_refused_in_one_line(tmp_path: Path, name: str) -> None:
    file, text, message = BAD_FILES[name]
    with pytest.raises(InputError, match=message) as caught:
        read_lamps(written(tmp_path, file, text))
    assert "\n" not in str(caught.value)
    assert file in str(caught.value)


@pytest.mark.parametrize("name", ["d.lp", "lights.csv", "lights.json"])
def test_bytes_that_are_no_text_are_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(InputError, match=name):
        read_lamps(tmp_path / name)


def test_half_of_the_directions_may_come_from_behind(tmp_path: Path) -> None:
    assert len(read_lamps(written(tmp_path, "d.lp", "2\na 0 0 1\nb 0 0.6 -0.8\n"))[0]) == 2


def test_one_file_of_a_folder_is_found(tmp_path: Path) -> None:
    assert find_lamps(tmp_path) is None
    (tmp_path / "images").mkdir()
    path = written(tmp_path / "images", "Dome.LP", LP)
    assert find_lamps(tmp_path) == path
    written(tmp_path, "lights.json", JSON)
    with pytest.raises(InputError, match=r"one file with lamps, found images/Dome.LP, lights.json"):
        find_lamps(tmp_path)
