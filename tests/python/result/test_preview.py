"""Sheets and plots for people: sizes, places and colours of what is on them."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest

from pbrfit import Result, Scene, decompose
from pbrfit.result import differences
from pbrfit.result.preview import contact_sheet, preview
from pbrfit.result.sheet import FONT, MARGIN, PANEL_SIDE
from pbrfit.result.verdict import LEVELS, PARAMETERS, Verdict
from pbrfit.synthetic import make_scene
from scene_files import known

LINE = round(1.6 * FONT[0])
TITLE = round(1.5 * LINE)
SIZES = [(1, 1), (1, 24), (24, 1), (7, 24), (24, 24)]


def part(height: int, width: int, *, truth: bool = False) -> Scene:
    made = make_scene("room", size=24, lights=2, held_out=1)
    return Scene(
        images=made.images[:, :height, :width],
        normals=made.normals[:height, :width],
        truth=made.truth if truth else None,
    )


@functools.cache
def whole() -> tuple[Scene, Result]:
    scene = part(24, 24)
    return scene, decompose(scene, iterations=1)


def panel_height(height: int, width: int) -> int:
    return max(1, round(PANEL_SIDE[0] * height / max(height, width)))


@pytest.mark.parametrize(("height", "width"), SIZES)
def test_a_preview_of_any_shape_of_picture(height: int, width: int) -> None:
    scene = part(height, width)
    result = decompose(scene, iterations=1, uncertainty=False)
    found, alone = preview(result, scene), preview(result)
    # Four columns, and the names of the rows at the left.
    assert found.shape[1] == alone.shape[1]
    assert 0 < found.shape[1] - 4 * (PANEL_SIDE[0] + MARGIN) < 150
    # Two rows with captions, a title, and with the pictures a residual, which needs a key.
    rows = 2 * (panel_height(height, width) + LINE + MARGIN)
    assert 0 < alone.shape[0] - rows < 3 * LINE
    assert 2 * LINE < found.shape[0] - alone.shape[0] < 4 * LINE
    row = panel_height(height, width) + MARGIN
    found = contact_sheet(scene)  # normals, pictures, and histograms without captions
    assert 0 < found.shape[0] - (3 * row + 2 * LINE) < 3 * LINE
    assert found.shape[1:] == (2 * (PANEL_SIDE[0] + MARGIN) + MARGIN, 3)


def test_a_preview_is_of_the_box_around_the_mask() -> None:
    scene, result = whole()
    mask = np.arange(24)[:, None] // 4 == np.full(24, 2)  # rows 8 to 11
    flat = preview(dataclasses.replace(result, mask=mask), scene)
    panels, rows = PANEL_SIDE[0] * (24 - 4) / 24, 3
    assert preview(result, scene).shape[0] - flat.shape[0] == pytest.approx(rows * panels, abs=rows)


def with_verdicts(result: Result, cause: str) -> Result:
    """A result whose maps have all levels."""
    levels = zip(PARAMETERS, LEVELS, strict=True)
    verdicts = {name: Verdict(level, 0.1, cause) for name, level in levels}
    uncertainty = dataclasses.replace(known(result.uncertainty), verdicts=verdicts)
    return dataclasses.replace(result, uncertainty=uncertainty)


def test_truth_with_its_errors_and_uncertainty_add_rows() -> None:
    scene = part(24, 24, truth=True)
    result = with_verdicts(decompose(scene, iterations=1), "")
    row, note = PANEL_SIDE[0] + MARGIN, round(1.1 * FONT[0])
    height = preview(result, scene).shape[0]
    without_truth = preview(result, dataclasses.replace(scene, truth=None)).shape[0]
    unsure = preview(dataclasses.replace(result, uncertainty=None), scene).shape[0]
    key = round(4.6 * FONT[0]) + MARGIN  # a bar a quantity
    assert (height - without_truth, height - unsure) == (2 * row + key, row + note + key)
    # Why a map is no better stands below it, in as many lines as it needs.
    explained = preview(with_verdicts(result, "few lights, all of them from one side"), scene)
    assert explained.shape[0] - height in (note, 2 * note)


def test_normals_that_face_away_are_orange_and_masked_pixels_grey() -> None:
    normals = np.zeros((24, 24, 3))
    normals[..., 2] = 1.0
    normals[:, 12:, 2] = -1.0
    mask = np.ones((24, 24), bool)
    mask[:12] = False
    scene = Scene(images=np.ones((2, 24, 24, 3)), normals=normals, mask=mask, fov=0.0)
    made = contact_sheet(scene)
    facing = made[TITLE + LINE + MARGIN :, MARGIN + (PANEL_SIDE[0] + MARGIN) :]
    assert tuple(facing[150, 50]) == (255, 255, 255)
    assert tuple(facing[150, 150]) == (214, 94, 0)
    assert tuple(facing[50, 50]) == tuple(facing[50, 150]) == (217, 217, 217)


def test_how_far_off_normals_may_be_is_a_panel_with_a_key() -> None:
    scene = part(24, 24)
    sigma = np.full((24, 24), 90.0)  # beyond the upper end of the scale
    sigma[:, :12] = 0.01  # beyond the lower
    without = contact_sheet(scene)
    found = contact_sheet(dataclasses.replace(scene, normal_sigma=sigma))
    assert found.shape[1] == without.shape[1] + PANEL_SIDE[0] + MARGIN
    assert found.shape[0] > without.shape[0] + LINE
    panel = found[TITLE + LINE + MARGIN :, MARGIN + 2 * (PANEL_SIDE[0] + MARGIN) :]
    low, high = (tuple(np.rint(255 * differences.PALETTE[i])) for i in (0, differences.STEPS - 1))
    assert tuple(panel[90, 40]) == low
    assert tuple(panel[90, 150]) == high
