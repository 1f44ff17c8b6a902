"""Lamps of a scene folder, and folders without normals."""

from __future__ import annotations

import dataclasses
import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from command_runs import done
from pbrfit import InputError, Scene
from pbrfit.model.lamps import Lamps
from pbrfit.registration.placement import Placement, Registration, put_back
from pbrfit.report import inspection
from pbrfit.scene import folder as scene_folder
from scene_files import SIZE, known, room

LP = "3\nlight_01.jpg 0.6 0 0.8\nlight_00.jpg 0 0.6 0.8\nlight_02.jpg 0 0 1\n"


def lamps(**changes: Any) -> Lamps:
    arguments: dict[str, Any] = {"pictures": np.arange(3), "places": np.eye(3)}
    return Lamps(**(arguments | changes))


def with_lamps(given: Any) -> Scene:
    return dataclasses.replace(room(), lamps=given)


def test_a_folder_s_lamps_are_read_and_are_inputs(folder: Path) -> None:
    assert Scene.load(folder).lamps is None
    (folder / "dome.lp").write_text(LP)
    scene = Scene.load(folder)
    assert scene.lamps is not None
    np.testing.assert_allclose(scene.lamps.places, [(0, 0.6, 0.8), (0.6, 0, 0.8), (0, 0, 1)])
    np.testing.assert_array_equal(scene.lamps.pictures, [0, 1, 2])
    assert not scene.lamps.colored
    assert scene.assumed["lamps"] == "known, 3 far lamps, colours unknown, from dome.lp"
    assert scene_folder.digests(folder) == scene.inputs
    assert "dome.lp" in scene.inputs


def test_matching_by_order_and_a_dome_are_told(folder: Path) -> None:
    (folder / "images" / "dome.lp").write_text("3\nx 3 0 4\ny 0 3 4\nz 0 0 5\n")
    assert Scene.load(folder).assumed["lamps"] == (
        "known, 3 far lamps, colours unknown, from dome.lp; matched to the pictures by order, as "
        "no name in it is that of a picture; vectors of length 5 to 5 are taken as places on a "
        "dome, of which only the direction counts"
    )


def test_lamps_are_saved_and_come_back(tmp_path: Path) -> None:
    given = lamps(
        pictures=np.array([0, 1, 1, 2]),
        places=np.array([[0, 0, 1], [0.6, 0, 0.8], [1, 2, -3], [0, 1, 0]]),
        near=np.array([False, False, True, False]),
        colors=np.array([[1, 2, 3], [np.nan] * 3, [0.1, 0.2, 0.3], [1, np.nan, 0]]),
        axes=np.array([[0, 0, -1], [0, 0, -1], [0.6, 0, -0.8], [0, 0, -1]]),
        exponents=np.array([0, 0, 1.5, 0]),
    )
    with_lamps(given).save(tmp_path / "saved")
    scene = Scene.load(tmp_path / "saved")
    for name, value in vars(given).items():
        np.testing.assert_array_equal(getattr(known(scene.lamps), name), value, name)
    assert scene.assumed["lamps"].startswith(
        "known, 3 far and 1 near lamps, colours known in part, from lights.json"
    )


def test_lamps_of_pictures_that_are_left_out_go_with_them() -> None:
    placements = tuple(
        Placement(name, np.zeros((2, 3)), left_out="far off" if i == 1 else "")
        for i, name in enumerate(room().names)
    )
    found = known(put_back(with_lamps(lamps()), Registration(placements)).lamps)
    np.testing.assert_array_equal(found.pictures, [0, 1])
    np.testing.assert_array_equal(found.places, np.eye(3)[[0, 2]])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (lamps(pictures=np.array([0, 1, 3])), "lamps: expected indices of 3 pictures, found 3"),
        ("dome.lp", "lamps: expected Lamps, found 'dome.lp'"),
    ],
)
def test_lamps_of_no_picture_are_refused(given: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        with_lamps(given)


def test_inspect_tells_of_lamps(folder: Path) -> None:
    facts = dict(inspection.facts(Scene.load(folder)))
    assert facts["lamps"] == "unknown"
    (folder / "dome.lp").write_text(LP)
    # Directions (0.6, 0, 0.8) and (0, 0.6, 0.8) are acos 0.64 apart, and acos 0.8 from the viewer.
    assert (
        "lamps             3 far lamps, colours unknown; far ones up to 50 degrees apart, 0 to 37 "
        "from the viewer" in done("inspect", folder)
    )
    near = with_lamps(lamps(near=np.ones(3, bool)))
    without = "3 near lamps, colours unknown; no fit of near ones without depth, and none is given"
    assert dict(inspection.facts(near))["lamps"] == without
    deep = dataclasses.replace(near, depth=np.ones((SIZE, SIZE)))
    assert dict(inspection.facts(deep))["lamps"] == "3 near lamps, colours unknown"


# Without normals


def test_three_pictures_need_no_normals(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    (folder / "normals.exr").unlink()
    with caplog.at_level(logging.WARNING, "pbrfit"):
        scene = Scene.load(folder)
        reduced = Scene.load(folder, max_size=SIZE // 2)
    assert not caplog.records
    for one in (scene, reduced):
        assert not one.normals_known
        assert one.assumed["normals"] == "none given: found from the pictures"
        np.testing.assert_array_equal(one.normals[one.valid], [[0, 0, 1]] * one.valid.sum())
    assert room().normals_known


def test_arrays_without_normals() -> None:
    assert not Scene(images=room().images).normals_known
    with pytest.raises(InputError, match=r"normals: expected unit vectors, found none; 3 or more"):
        Scene(images=room().images[:2])


def test_inspect_tells_that_there_are_no_normals(folder: Path, tmp_path: Path) -> None:
    (folder / "normals.exr").unlink()
    said = done("inspect", folder, "--preview", tmp_path / "preview.png")
    assert "assumed normals   none given: found from the pictures" in said
    assert "facing away       unknown: no normals are given" in said
    assert "normal error      none given" in said
