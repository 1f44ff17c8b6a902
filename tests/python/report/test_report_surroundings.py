"""Drawings of a scene from above and from the side."""

from __future__ import annotations

import re
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np

from pbrfit.report.surroundings import LINE, SEEN, plan_view
from pbrfit.transport.scenery import Scenery
from small_worlds import ball_alone, box_room


def test_plans_are_drawings_with_walls_camera_and_points() -> None:
    seen = box_room()
    found = Scenery(seen.depth, seen.normals, seen.mask, seen.segments, seen.fov)
    blocks = (*found.extents.blocks[:-1], False)
    found = found.with_extents(replace(found.extents, blocks=blocks))
    views = plan_view(found, 400, "metres")
    for view in views:
        root = ET.fromstring(view)
        assert root.attrib["width"] == "400"
        assert "metres" in "".join(root.itertext())
        assert "NaN" not in view
        assert view.count("<circle") == 1
        assert f'stroke="{SEEN}"' in view
        assert "stroke-dasharray" in view
        assert re.search(f'fill="{LINE}" stroke="{LINE}" stroke-width="2.5"', view)
    above, side = (
        [float(x) for x in re.findall(r'<circle cx="(\S+)" cy="(\S+)"', v)[0]] for v in views
    )
    # The camera looks up in the first drawing, to the right in the second.
    assert above[1] > 200
    assert side[0] < 200


def test_a_thing_without_walls_can_be_drawn() -> None:
    seen = ball_alone()
    above, side = plan_view(Scenery(seen.depth, seen.normals, seen.mask, None, seen.fov))
    for view in (above, side):
        ET.fromstring(view)
        assert np.isfinite(float(re.findall(r'height="(\d+)"', view)[0]))
