"""Sheets and plots for people: sizes, places and colours of what is on them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pbrfit import Scene, decompose
from pbrfit.preview import normals_preview, plot_history, preview
from pbrfit.sheet import CAPTION, MARGIN, PANEL_SIDE, Panel, sheet
from pbrfit.synthetic import make_scene

SIZES = [(1, 1), (1, 24), (24, 1), (7, 24), (24, 24)]


def part(height: int, width: int, *, truth: bool = False) -> Scene:
    made = make_scene("room", size=24, lights=2, held_out=1)
    return Scene(
        images=made.images[:, :height, :width],
        normals=made.normals[:height, :width],
        truth=made.truth if truth else None,
    )


@pytest.mark.parametrize(("height", "width"), SIZES)
def test_a_preview_of_any_shape_of_picture(height: int, width: int) -> None:
    scene = part(height, width)
    result = decompose(scene, iterations=1, uncertainty=False)
    step = PANEL_SIDE[0] + MARGIN
    row = CAPTION + MARGIN + max(1, round(PANEL_SIDE[0] * height / max(height, width)))
    assert preview(result, scene).shape == (row + MARGIN, 6 * step + MARGIN, 3)
    assert preview(result).shape == (row + MARGIN, 5 * step + MARGIN, 3)
    assert normals_preview(scene).shape == (row + MARGIN, 3 * step + MARGIN, 3)


def test_truth_and_errors_add_rows() -> None:
    scene = part(24, 24, truth=True)
    result = decompose(scene, iterations=1, uncertainty=False)
    assert preview(result, scene).shape[0] == 3 * (192 + CAPTION + MARGIN) + MARGIN


def test_uncertainty_adds_a_row() -> None:
    scene = part(24, 24)
    result = decompose(scene, iterations=1)
    assert preview(result, scene).shape[0] == 2 * (192 + CAPTION + MARGIN) + MARGIN


def test_panels_lie_where_they_should_and_large_ones_are_averaged() -> None:
    red, blue = np.zeros((2, 24, 24, 3))
    red[..., 0] = blue[..., 2] = 1.0
    made = sheet([[Panel("red", red), None], [None, Panel("blue", blue)]])
    step, down = PANEL_SIDE[0] + MARGIN, PANEL_SIDE[0] + CAPTION + MARGIN
    center = MARGIN + PANEL_SIDE[0] // 2
    assert tuple(made[center + CAPTION, center]) == (255, 0, 0)
    assert tuple(made[center + CAPTION + down, center + step]) == (0, 0, 255)
    assert tuple(made[center + CAPTION, center + step]) == (255, 255, 255)
    stripes = np.zeros((1536, 1536, 3))
    stripes[::2] = 1.0
    made = sheet([[Panel("stripes", stripes)]])
    assert made.shape[1] == PANEL_SIDE[1] + 2 * MARGIN
    assert abs(int(made[200, 200, 0]) - 128) <= 1


def test_normals_that_face_away_are_orange_and_masked_pixels_grey() -> None:
    normals = np.zeros((24, 24, 3))
    normals[..., 2] = 1.0
    normals[:, 12:, 2] = -1.0
    mask = np.ones((24, 24), bool)
    mask[:12] = False
    scene = Scene(images=np.ones((2, 24, 24, 3)), normals=normals, mask=mask, fov=0.0)
    made = normals_preview(scene)
    facing = made[CAPTION + MARGIN :, MARGIN + 2 * (PANEL_SIDE[0] + MARGIN) :]
    assert tuple(facing[150, 50]) == (255, 255, 255)
    assert tuple(facing[150, 150]) == (214, 94, 0)
    assert tuple(facing[50, 50]) == tuple(facing[50, 150]) == (217, 217, 217)


@pytest.mark.parametrize("truth", [False, True])
def test_a_history_plot_even_of_no_iterations(tmp_path: Path, truth: bool) -> None:
    for iterations in (0, 3):
        result = decompose(part(24, 24, truth=truth), iterations=iterations)
        plot_history(result, tmp_path / "plot.png")
        with Image.open(tmp_path / "plot.png") as picture:
            assert picture.size == (960, 540)
