"""What the page says and shows of lamps and of a height."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from page_reader import Page, written
from pbrfit import Result
from pbrfit.model.lamps import Lamps
from pbrfit.report.lamp_sheet import draw_directions
from pbrfit.report.lamps import seen
from pbrfit.result.drawing import new_figure
from under_lamps import ball_under_lamps


@pytest.fixture(scope="module")
def result() -> Result:
    return ball_under_lamps()


@pytest.fixture(scope="module")
def page(result: Result, tmp_path_factory: pytest.TempPathFactory) -> Page:
    return written(result, tmp_path_factory.mktemp("page") / "page.html")


def test_lamps_have_a_section_in_the_place_of_lights(page: Page) -> None:
    sections = [e.attributes["id"] for e in page.all("section")]
    assert sections == ["summary", "maps", "pictures", "lamps", "history", "origin"]
    assert "lit by 2 far lamps" in page.text
    assert "light2 far lamps" in page.text


def test_the_table_has_directions_strengths_and_the_ambient_share(page: Page) -> None:
    # (-0.48, 0.6, 0.64): atan2(-0.48, 0.64) and asin(0.6); luminance of (1.2, 1, 0.7).
    rows = [e.text for e in page.all("tr")]
    [first] = [row for row in rows if row.startswith("1a")]
    assert first.startswith("1a−37°37°1 1.00, 0.83, 0.58")
    assert any(row.startswith("2bno lamp") for row in rows)
    ambient = 0.2 / (2 * np.sqrt(np.pi))
    strength = 0.2126 * 1.2 + 0.7152 + 0.0722 * 0.7
    shares = [float(e.attributes["value"]) for e in page.all("data")]
    assert any(abs(share - ambient / (ambient + strength)) < 1e-9 for share in shares)
    assert 1.0 in shares  # of the picture without a lamp


def test_the_map_has_equal_angles_equally_long_and_a_number_a_lamp() -> None:
    """A far lamp in front, a near one in front and a far one behind."""
    directions = np.array([(-0.48, 0.6, 0.64), (0, 0, 1), (0.6, 0, -0.8)])
    axes = new_figure(4, 4).subplots()
    draw_directions(axes, ["1", "2", "3"], directions, np.array([False, True, False]))
    marks = {str(line.get_label()): line for line in axes.lines[1:]}
    assert [(name, line.get_marker()) for name, line in marks.items()] == [
        *(("near", "s"), ("far", "o"), ("far, behind", "o"))
    ]
    assert marks["far, behind"].get_markerfacecolor() == "none"
    # 50 degrees from the viewer, to the upper left; 143 degrees, to the right.
    along = np.degrees(np.arccos(0.64)) * np.array((-0.48, 0.6)) / np.hypot(0.48, 0.6)
    np.testing.assert_allclose(np.ravel(marks["far"].get_xydata()), along)
    behind = np.ravel(marks["far, behind"].get_xydata())
    np.testing.assert_allclose(behind, (np.degrees(np.arccos(-0.8)), 0))
    assert [text.get_text() for text in axes.texts][-3:] == ["1", "2", "3"]


def test_near_lamps_are_seen_from_the_middle_of_the_surface(result: Result, tmp_path: Path) -> None:
    depth = np.where(result.mask, 5.0, np.nan).astype(np.float32)
    lamps = Lamps(
        np.array([1]), np.array([(3.0, 0.0, -1.0)]), np.array([True]), np.full((1, 3), 50.0)
    )
    near = dataclasses.replace(result, depth=depth, lamps=lamps)
    [lamp] = seen(near)[1]
    assert lamp.distance == pytest.approx(5)
    assert lamp.strength == pytest.approx(2)
    np.testing.assert_allclose(lamp.direction, (0.6, 0, 0.8), atol=1e-12)
    page = written(near, tmp_path / "page.html")
    assert "1 near lamp" in page.text


def test_many_lamps_are_folded(result: Result, tmp_path: Path) -> None:
    count = 30
    many = dataclasses.replace(
        result,
        pictures=tuple(f"p{i}" for i in range(count)),
        lighting=np.zeros((count, 16, 3)),
        lamps=Lamps(
            np.arange(count), np.tile((0.0, 0.0, 1.0), (count, 1)), colors=np.ones((count, 3))
        ),
    )
    page = written(many, tmp_path / "page.html")
    assert "All 30 lamps in numbers" in page.text


def test_the_height_has_a_map_with_pixels_on_its_scale(page: Page) -> None:
    titles = [e.text for e in page.all("h3")]
    assert "Height" in titles
    assert "height in pixels" in page.text
    alts = [e.attributes.get("alt") for e in page.all("img")]
    assert "Map of the height" in alts
    assert "Normals and height were found from the pictures" in page.text
    assert "found from the pictures, in camera space" in page.text


def test_a_flat_height_and_no_ambient_light_are_no_failure(result: Result, tmp_path: Path) -> None:
    flat = dataclasses.replace(
        result,
        height=np.where(result.mask, np.float32(0), np.float32(np.nan)),
        lighting=np.zeros((3, 16, 3)),
        lamps=result.lamps.of_pictures([1, 1, 1]) if result.lamps else None,
    )
    assert "no lamps" in written(flat, tmp_path / "page.html").text
