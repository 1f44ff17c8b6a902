"""Drawings of a scene from above and from the side."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pbrfit.report.surroundings import plan_view
from pbrfit.result.drawing import as_svg
from pbrfit.transport.scenery import Scenery
from small_worlds import ball_alone, box_room


def test_plans_have_one_scale_walls_camera_and_points() -> None:
    seen = box_room()
    found = Scenery(seen.depth, seen.normals, seen.mask, seen.segments, seen.fov)
    blocks = (*found.extents.blocks[:-1], False)
    figure = plan_view(found.with_extents(replace(found.extents, blocks=blocks)))
    assert len(as_svg(figure)) > 10_000
    scales = []
    for drawing in figure.axes:
        assert "units of depth" in drawing.get_xlabel()
        drawn = {str(line.get_label()): line for line in drawing.lines}
        assert {"closes the room", "lets light through", "things, as seen"} <= drawn.keys()
        assert drawn["lets light through"].get_linestyle() == "--"
        assert np.isfinite(drawn["things, as seen"].get_xydata()).all()
        scales.append(drawing.get_window_extent().width / np.ptp(drawing.get_xlim()))
        # The camera stands at the edge of what it sees: below it, then to the left of it.
        things = np.asarray(drawn["things, as seen"].get_xydata())
        assert (things[:, len(scales) % 2] > 0).mean() > 0.9
    assert scales[0] == pytest.approx(scales[1], rel=0.05)


def test_a_thing_without_walls_can_be_drawn() -> None:
    seen = ball_alone()
    figure = plan_view(Scenery(seen.depth, seen.normals, seen.mask, None, seen.fov))
    assert "nan" not in as_svg(figure)
