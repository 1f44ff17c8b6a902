"""Files of lamps: `.lp`, `lights.csv`, `lights.json`, and what is refused in them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pbrfit import InputError
from pbrfit.io.lamp_files import LampRow, find_lamps, matched, read_lamps

NAMES = ("a", "b", "c")
LP = "3\na.jpg 0.6 0 0.8\nb.jpg 0 0.6 0.8\nc.jpg 0 0 1\n"
TABLE = "picture,x,y,z\na,0.6,0,0.8\nb,0,0.6,0.8\nc,0,0,1\n"


def lamp(**changes: Any) -> dict[str, Any]:
    return {"picture": "a", "direction": [0, 0, 1]} | changes


def as_json(*lamps: dict[str, Any], version: int = 1) -> str:
    return json.dumps({"version": version, "lamps": lamps})


JSON = as_json(
    lamp(direction=[0.6, 0, 0.8]), lamp(picture="b", direction=[0, 0.6, 0.8]), lamp(picture="c")
)


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


GERMAN = TABLE.replace(",", ";").replace(".", ",")
ROWS = "0 0.6 0.8\n0.6 0 0.8\n0 0 1\n"  # of b, a, c
VIEWS = json.dumps({"views": [
    {"viewId": view, "path": f"/photos/{name}.png"} for view, name in zip("897", NAMES, strict=True)
]})  # fmt: skip
MESHROOM = json.dumps({"lights": [
    {"viewId": view, "type": "directional", "direction": direction, "intensity": ["1", "1", "1"]}
    for view, direction in ((9, [0, "-0.6", -0.8]), ("8", ["0.6", "0", "-0.8"]), ("7", [0, 0, -1]))
]})  # fmt: skip
RELIGHT = json.dumps({"application": "RelightLab", "images": [
    {"filename": f"{name}.jpg", "skip": name == "d", "direction": {"x": x, "y": y, "z": z}}
    for name, x, y, z in (("b", 0, 0.6, 0.8), ("d", 0, 0, 0), ("a", 0.6, 0, 0.8), ("c", 0, 0, 1))
]})  # fmt: skip
FORMS: dict[str, tuple[str, str, str]] = {
    "lp": ("dome.lp", LP, "utf-8"),
    "lp, Windows": ("dome.LP", LP.replace(" ", "\t").replace("\n", "\r\n"), "utf-8-sig"),
    "lp, decimal commas": ("dome.lp", LP.replace("0.", "0,"), "utf-16"),
    "lp, semicolons": ("dome.lp", LP.replace(" ", "; "), "utf-8"),
    "lp, commas": ("dome.lp", LP.replace(" ", ", "), "utf-8"),
    "lp, comments": ("dome.lp", "# rig\n\n" + LP.replace("\nb", "\n\n# b\nb"), "utf-8"),
    "lp, old Mac": ("dome.lp", LP.replace("\n", "\r"), "utf-8"),
    "lp, minus": ("dome.lp", LP.replace(" 0 ", " \u22120 "), "utf-8"),
    "table": ("lights.csv", TABLE, "utf-8"),
    "semicolons": ("lights.csv", TABLE.replace(",", ";"), "utf-8-sig"),
    "no header": ("lights.csv", TABLE.partition("\n")[2], "utf-8"),
    "columns": (
        "lights.csv",
        "z,kind,Picture,X,y\n.8,far,a,.6,0\n.8,,b,0,.6\n1,FAR,c,0,0",
        "utf-8",
    ),
    "German Excel": ("lights.csv", "sep = ;\r\n" + GERMAN.replace("\n", "\r\n"), "utf-8-sig"),
    "German Excel, ANSI": ("lights.csv", f"# für später\n{GERMAN}", "cp1252"),
    "no header, decimal commas": ("lights.csv", GERMAN.partition("\n")[2], "utf-8"),
    "Unicode text": ("lights.csv", GERMAN.replace(";", "\t"), "utf-16"),
    "big endian": ("lights.csv", "\ufeff" + TABLE, "utf-16-be"),
    "quoted decimals": ("lights.csv", 'a,"0,6",0,"0,8"\nb,0,"0,6","0,8"\nc,0,0,1', "utf-8"),
    "sep of its own": ("lights.csv", '"sep=|"\n' + TABLE.replace(",", "|"), "utf-8"),
    "other header": ("lights.csv", TABLE.replace("picture,x", "# File Name, 'LX'"), "utf-8"),
    "light x": ("lights.csv", TABLE.replace("picture,x,y,z", "image,dx,dy,Light_z"), "utf-8"),
    "empty columns": ("lights.csv", TABLE.replace("\n", ",,\n") + ",,,,,\n", "utf-8"),
    "spaces": ("light_directions.txt", TABLE.replace(",", "  "), "utf-8"),
    "json": ("lights.json", JSON, "utf-8"),
    "json with a mark": ("lights.json", JSON, "utf-8-sig"),
    "lp, UTF-16 without a mark": ("dome.lp", LP, "utf-16-le"),
    "json, UTF-16": ("lights.json", JSON, "utf-16"),
    "DiLiGenT": ("light_directions.txt", ROWS, "utf-8"),
    "Meshroom": ("lights.json", MESHROOM, "utf-8"),
    "RelightLab": ("coin.relight", RELIGHT, "utf-8"),
}
BESIDE = {"DiLiGenT": ("filenames.txt", "b.png\na.png\nc.png\n"), "Meshroom": ("c.sfm", VIEWS)}


@pytest.mark.parametrize("form", FORMS)
def test_each_form_gives_the_same_directions(tmp_path: Path, form: str) -> None:
    name, text, encoding = FORMS[form]
    path = tmp_path / name
    path.write_bytes(text.encode(encoding))
    if form in BESIDE:
        written(tmp_path, *BESIDE[form])
    assert len(find_lamps(tmp_path)) == 1 + (form in BESIDE)
    rows, said = read_lamps(path)
    assert not said
    pictures, how = matched(path, [row.picture for row in rows], NAMES)
    assert (sorted(pictures), how) == ([0, 1, 2], "")
    places = [rows[k].place for k in np.argsort(pictures)]
    np.testing.assert_allclose(places, [(0.6, 0, 0.8), (0, 0.6, 0.8), (0, 0, 1)])
    assert not any(row.near for row in rows)
    assert np.isnan([row.color for row in rows]).all()


def test_directions_without_names(tmp_path: Path) -> None:
    path = written(tmp_path, "light_directions.txt", " 0.6   0 0.8 \n-0.6 0   0.8\n")
    found = [(row.picture, row.place) for row in read_lamps(path)[0]]
    assert found == [("", (0.6, 0, 0.8)), ("", (-0.6, 0, 0.8))]


def test_places_on_a_dome_are_directions_and_it_says_so(tmp_path: Path) -> None:
    rows, said = read_lamps(written(tmp_path, "dome.lp", "2\na 30 0 40\nb 0 0 55\n"))
    np.testing.assert_allclose([row.place for row in rows], [(0.6, 0, 0.8), (0, 0, 1)])
    assert said.startswith("vectors of length 50 to 55 are taken as places on a dome")


@pytest.mark.parametrize(("text", "refused"), [
    ("a,0,45,1.2\nb,360,90,1.2", True),
    ("a,0,45,1.2\nb,361,90,1.2", False),
    ("a,0,45,1.2\nb,360,91,1.2", False),
    ("a,0,45,1.2\nb,360,90,1.3", False),
    ("1,0,45\n2,360,90\n", True),
    ("1,0,45\n3,360,90\n", False),
    ("a,-9,-9,50\nb,9,9,50", False),  # one length
    ("a,-20,-9,50\nb,9,9,50", False),  # lamps above a table
    ("a,1,0,50\nb,-20,0,50", False),  # in a row
    ("x,y,z,picture\n0,45,1.2,a\n360,90,1.2,b", False),
])  # fmt: skip
def test_numbers_that_may_be_angles_need_a_header(tmp_path: Path, text: str, refused: bool) -> None:
    path = written(tmp_path, "lights.csv", text)
    if not refused:
        assert len(read_lamps(path)[0]) == 2
        return
    with pytest.raises(InputError, match=r"s.csv: expected a header with x, y, z, found none, and"):
        read_lamps(path)


@pytest.mark.parametrize(("length", "told"), [(1.0199, False), (1.0201, True), (0.9799, True)])
def test_lengths_are_rounding_to_the_threshold(tmp_path: Path, length: float, told: bool) -> None:
    rows, said = read_lamps(written(tmp_path, "d.lp", f"1\na 0 0 {length}\n"))
    assert rows[0].place == (0.0, 0.0, 1.0)
    assert bool(said) == told


def test_colors_and_near_lamps_of_a_table(tmp_path: Path) -> None:
    text = "a,1,2,-3,0.5,0.25,1,near\nb,0,0,1,,,,far\n"
    near, far = read_lamps(written(tmp_path, "lights.csv", text))[0]
    assert near == LampRow("a", (1, 2, -3), True, (0.5, 0.25, 1))
    assert (far.near, far.place) == (False, (0, 0, 1))
    assert np.isnan(far.color).all()


BY_NAME: dict[str, tuple[tuple[str, ...], tuple[str, ...], list[int]]] = {
    "case": (("B.png", "A.JPG"), ("a", "b"), [1, 0]),
    "case alone": (("A", "a"), ("a", "A"), [1, 0]),
    "a folder": (("B", "captures/a.tif"), ("a", "b"), [1, 0]),
    "a folder of Windows": (("B", '"C:\\my rig\\a"'), ("a", "b"), [1, 0]),
    "a point in the name": (("B.png", "A.b"), ("a.b", "b"), [1, 0]),
    "two extensions": (("b.NEF.jpg", "a.CR3"), ("a.tif", "b"), [1, 0]),
    "numbers after points": (("s.002.jpg", "s.001.jpg"), ("s.001", "s.002"), [1, 0]),
    "quotes": (('"b 1.png"', "'a 1.png'"), ("a 1", "b 1"), [1, 0]),
    "typographic quotes": (("“b 1.png”", "«a 1»"), ("a 1", "b 1"), [1, 0]),
    "forms of Unicode": (("u\u0308.png", "o\u0308.png"), ("\u00f6", "\u00fc"), [1, 0]),
    "hard and other spaces": (("b\u00a01.png ", " a 1.png"), ("a 1", "b\u00a01"), [1, 0]),
    "two lamps each": (("a", "b", "b", "a"), ("a", "b"), [0, 1, 1, 0]),
    "lamps of other pictures": (("z", "b", "", "a"), ("a", "b"), [-1, 1, -1, 0]),
    "strict before loose": (("A.jpg", "b.jpg", "a.jpg"), ("a", "b"), [-1, 1, 0]),
}


@pytest.mark.parametrize("name", BY_NAME)
def test_lamps_are_paired_by_name(name: str, caplog: pytest.LogCaptureFixture) -> None:
    given, names, pictures = BY_NAME[name]
    found, said = matched(Path("x.lp"), given, names)
    assert found == pictures
    assert said.startswith("some left out: no picture is called ") == (-1 in pictures)
    assert not caplog.records


COUNTED = tuple(sorted(f"img{i}" for i in range(1, 13)))
RAW = tuple(f"IMG_{i:04}.NEF" for i in range(1, 13))
SORTED = [COUNTED.index(f"img{i}") for i in range(1, 13)]
BY_SEQUENCE: dict[str, tuple[tuple[str, ...], tuple[str, ...], list[int], str]] = {
    "order": (("x", "y", "z"), NAMES, [0, 1, 2], "order"),
    "no names": (("", "", ""), NAMES, [0, 1, 2], "order"),
    "other numbers": (("IMG_7", "IMG_8", "IMG_9"), ("s1", "s2", "s3"), [0, 1, 2], "order"),
    "numbers": (RAW, COUNTED, SORTED, "the numbers in names"),
    "numbers, reversed": (("L3.cr2", "L2.cr2", "L1.cr2"), ("s01", "s02", "s03"), [2, 1, 0], "the"),
    "one number of two": (("L2", "L1"), ("dir_1_mip4", "dir_2_mip4"), [1, 0], "the numbers"),
}


@pytest.mark.parametrize("name", BY_SEQUENCE)
def test_without_any_name_numbers_or_order_count_with_a_warning(
    name: str, caplog: pytest.LogCaptureFixture
) -> None:
    given, names, pictures, how = BY_SEQUENCE[name]
    found, said = matched(Path("x.lp"), given, names)
    assert found == pictures
    assert said.startswith(f"matched to the pictures by {how}")
    [record] = caplog.records
    first = f": {given[0] or 'lamp 1'} with {names[pictures[0]]}, "
    assert record.getMessage().startswith("x.lp: lamps are matched to")
    assert first in record.getMessage()
    assert record.getMessage().endswith("and 9 more") == (len(given) == 12)


BAD_MATCHES: dict[str, tuple[tuple[str, ...], tuple[str, ...], str]] = {
    "another count": (("x", "y"), NAMES, r"each of the 3 pictures, found 2, .* \(such as x\)"),
    "a picture without a lamp": (("a", "b", "a"), NAMES, "for every picture, found none for c$"),
    "another name": (("a", "b", "d", "e"), NAMES, "for c; no picture is called 'd' and 1 more$"),
    "two folders": (("1/a", "2/a", "1/b"), ("a", "b"), "one name for picture a, found 1/a and 2/a"),
    "pictures not in order": (
        tuple("abcdefghijkl"),
        COUNTED,
        "names of pictures, found a and 11 more; .* as img12 comes before img2: rename",
    ),
    "no names, pictures not in order": (("",) * 12, COUNTED, "pictures, found none and 11 more; "),
    "lamps not in order": (("z", "y", "x"), NAMES, "as z comes before y: rename or pad"),
    "lamps that a program may sort": (("L8", "L9", "L10"), NAMES, "as L10 comes before L8: rename"),
}


@pytest.mark.parametrize("name", BAD_MATCHES)
def test_files_of_other_pictures_are_refused(name: str) -> None:
    given, names, message = BAD_MATCHES[name]
    with pytest.raises(InputError, match=f"x.lp: expected .*{message}"):
        matched(Path("x.lp"), given, names)


NEAR = {"picture": "a", "position": [0, 0, 1]}
BAD_FILES: dict[str, tuple[str, str, str]] = {
    "no project": ("d.relight", "{}", "d.relight: expected JSON with version and lamps"),
    "no direction": (
        "d.relight",
        '{"images": [{"filename": "a"}]}',
        "d.relight: expected .*direction",
    ),
    "another form": ("lights.xml", LP, r"lights.xml: expected lamps in .lp, .csv, .txt, .json"),
    "no text": ("d.lp", "", "d.lp: expected a count, .* found an empty file in place of the count"),
    "no count": ("d.lp", "a.jpg 0 0 1\n", "found 'a.jpg 0 0 1' in place of the count"),
    "another count": ("d.lp", "3\x1f\na 0 0 1\n", "expected 3 lamps, as it says, found 1"),
    "no lamps": ("d.lp", "0\n", "d.lp: expected lamps, found none"),
    "a short line": ("d.lp", "1\n0 0 1\n", "lamp 1: expected file name, x, y, z, found '0 0 1'"),
    "words": ("d.lp", "1\na up 0 1\n", "lamp 1: expected .* 'up'"),
    "NaN": ("d.lp", "1\na nan 0 1\n", "lamp 1: expected .* number"),
    "infinity": ("d.lp", "1\na 0 0 inf\n", "lamp 1: expected .* finite number"),
    "a zero vector": ("d.lp", "2\na 0 0 1\nb 0 0 0\n", r"lamp 2: .*direction \(0, 0, 0\)"),
    "another Z": (
        "d.lp",
        "3\na 0 0 -1\nb .6 0 -.8\nc 1 0 0\n",
        "Z towards the viewer, found 2 of 3 .*Z away",
    ),
    "an empty table": ("lights.csv", "\n;;;\n", "lights.csv: expected a table .*an empty file"),
    "another column": ("lights.csv", "x,y,z,w\n1,0,0,0\n", "expected a table .* found w, x, y, z"),
    "too many columns": ("lights.csv", "a,1,2,3,4\n", "found 5 columns without a header"),
    "a short row": ("lights.csv", TABLE + "d,1\n", "lamp 4: expected 4 values, found 2"),
    "another kind": (
        "lights.csv",
        "a,0,0,1,1,1,1,spot\n",
        "lamp 1: .*'spot' in place of far or near",
    ),
    "a negative color": ("lights.csv", "a,0,0,1,1,-.5,1\n", "lamp 1: expected .*color"),
    "split numbers": ("lights.csv", "a,0,6,0,0,0,8\n", "header; numbers with decimal commas need"),
    "decimal commas below": ("lights.csv", TABLE.replace(".", ","), "found 6; numbers with"),
    "some numbers split": (
        "lights.csv",
        "a,0,6,0,0,0,8\nb,1,0,0\n",
        "found 7 columns without a header;",
    ),
    "two decimal marks": ("d.lp", "1\na 0,6 0 0.8\n", "numbers as 0.5 or all as 0,5, found '0,6'"),
    "thousands": ("lights.csv", "a;1,200;0;900\n", "numbers as 0.5 or all as 0,5, found '1,200'"),
    "strengths in .lp": ("d.lp", "1\na.jpg 0.1 0 0.9 1.0\n", "expected file name, x, y, z, found"),
    "angles": (
        "lights.csv",
        "a,azimuth,elevation\nb,1,2\n",
        "expected a table .* found a, azimuth",
    ),
    "colours in .lp": ("d.lp", "1\na.jpg 0.1 0 0.9 1 1 1\n", "expected file name, x, y, z, found"),
    "too many": ("lights.csv", "a,0,0,1\n" * 10_001, "expected at most 10000 lamps, found 10001"),
    "no JSON": ("lights.json", "[", "^[^:]*lights.json: expected JSON .*, found JSONDecodeError"),
    "a list": ("lights.json", "[]", "lights.json: expected JSON with version and lamps"),
    "another version": ("lights.json", as_json(version=2), "version 2 in place of 1"),
    "no picture": (
        "lights.json",
        as_json({"direction": [0, 0, 1]}),
        "lamp 1: .*position, found KeyError",
    ),
    "no place": ("lights.json", as_json({"picture": "a"}), "lamp 1: .*both or neither"),
    "two places": ("lights.json", as_json(lamp(position=[0, 0, 1])), "lamp 1: .*both or neither"),
    "two numbers": ("lights.json", as_json(lamp(direction=[0, 1])), "in place of three numbers"),
    "a text": ("lights.json", as_json(lamp(direction=[0, 0, "1"])), "in place of a number"),
    "another key": ("lights.json", as_json(lamp(colour=[1, 1, 1])), "key 'colour' in place of"),
    "a far axis": ("lights.json", as_json(lamp(axis=[0, 0, 1])), "lamp without position"),
    "a negative colour": (
        "lights.json",
        as_json(lamp(color=[0, 0, -1])),
        "lamp 1: expected .*color",
    ),
    "a zero axis": (
        "lights.json",
        as_json(NEAR | {"axis": [0, 0, 0]}),
        r"lamp 1: .*axis \(0, 0, 0\)",
    ),
    "a negative exponent": (
        "lights.json",
        as_json(NEAR | {"exponent": -1}),
        "exponent -1 in place of 0 or",
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


def test_a_hundred_lamps_each_of_a_hundred_pictures_are_read(tmp_path: Path) -> None:
    assert len(read_lamps(written(tmp_path, "lights.csv", "a,0,0,1\n" * 10_000))[0]) == 10_000


def test_half_of_the_directions_may_come_from_behind(tmp_path: Path) -> None:
    assert len(read_lamps(written(tmp_path, "d.lp", "2\na 0 0 1\nb 0 0.6 -0.8\n"))[0]) == 2


def test_one_file_of_a_folder_is_found(tmp_path: Path) -> None:
    assert not find_lamps(tmp_path)
    (tmp_path / "images").mkdir()
    path = written(tmp_path / "images", "Dome.LP", LP)
    assert find_lamps(tmp_path) == [path]
    written(tmp_path, "lights.json", JSON)
    with pytest.raises(InputError, match=r"one file with lamps, found images/Dome.LP, lights.json"):
        find_lamps(tmp_path)


@pytest.mark.parametrize(("name", "content", "beside", "names", "message"), [
    ("light_directions.txt", ROWS, "filenames.txt", "a.png\n", "the 3 lamps in .*txt, found 1"),
    ("lights.json", MESHROOM, "cameras.txt", VIEWS, r"lights.json: expected one \.sfm .* found 0"),
    ("lights.json", MESHROOM, "cameras.sfm", "{}", "cameras.sfm: expected views with viewId"),
    ("lights.json", MESHROOM, "cameras.sfm", VIEWS.replace('"8"', '"1"'), "lamp 2: .*'8'"),
    ("lights.json", MESHROOM.replace("viewId", "lightId"), "c.sfm", VIEWS, "lamp 1: .*viewId"),
    ("lights.json", MESHROOM.replace('"0.6"', '"nan"'), "c.sfm", VIEWS, "lamp 2: .*nan"),
])  # fmt: skip
def test_names_beside_lamps_that_are_none(
    tmp_path: Path, name: str, content: str, beside: str, names: str, message: str
) -> None:
    written(tmp_path, beside, names)
    with pytest.raises(InputError, match=message):
        read_lamps(written(tmp_path, name, content))
