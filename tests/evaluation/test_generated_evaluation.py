"""`pbrfit evaluate generated`: damages are what they say, files are written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blender_card import relief
from pbrfit import relight
from pbrfit.export import export_result
from pbrfit.scene.scene import Scene
from pbrfit_evaluation import cycles
from pbrfit_evaluation.cycles.process import rendered_export
from pbrfit_evaluation.generated.measure import (
    LEVELS,
    given,
    reviewed,
    room,
    stand_ins,
)
from pbrfit_evaluation.review.pictures import codes

SEED, SIZE, PICTURES = 8701, 48, 13


@pytest.fixture(scope="module")
def truth() -> Scene:
    return room(SEED, SIZE, PICTURES, by_cycles=False)


def test_levels_build_upon_each_other(truth: Scene) -> None:
    exact, toned_, drifted_, repainted = (stand_ins(truth, level, SEED) for level in LEVELS)
    np.testing.assert_array_equal(exact[0], truth.images)
    assert [of[1].count("drift") for of in (exact, toned_, drifted_, repainted)] == [0, 0, 3, 3]
    assert repainted[1].count("repaint") == 2
    assert repainted[1].count("another") == 1
    assert set(toned_[1]) == {"honest"}
    for before, after in ((toned_, drifted_), (drifted_, repainted)):
        changed = [bool(np.any(a != b)) for a, b in zip(before[0], after[0], strict=True)]
        more = [a != b for a, b in zip(before[1], after[1], strict=True)]
        assert changed == more
    np.testing.assert_array_equal(codes(repainted[0][0]), codes(truth.images[0]))  # the photo


def test_files_tell_which_samples_are_clipped(truth: Scene) -> None:
    pictures = stand_ins(truth, "toned", SEED)[0]
    scene = given(truth, pictures, as_files=True)
    np.testing.assert_allclose(scene.images, pictures, atol=1e-6)
    assert scene.limits is not None
    white = codes(pictures)[:, scene.valid] == 255
    np.testing.assert_array_equal(scene.limits[:, scene.valid][white] > 0, True)


def test_the_review_refuses_a_picture_of_another_room(truth: Scene) -> None:
    pictures, kinds = stand_ins(truth, "repainted", SEED)
    kept = reviewed(pictures)
    assert kept[0] == 0
    assert kinds.index("another") not in kept


@pytest.mark.skipif(bool(cycles.why_not()), reason=str(cycles.why_not()))
def test_an_export_opened_in_blender_is_lit_from_where_pbrfit_lights_it(tmp_path: Path) -> None:
    result = relief(48, 48)
    exported = export_result(result, tmp_path / "out", format="gltf")
    lights = [tmp_path / "out" / "lights" / of.file for of in exported.panoramas]
    glb = tmp_path / "out" / "material.glb"
    found = rendered_export(tmp_path / "job", glb, 48, lights, samples=64)
    relit = relight(result, result.lighting)

    def off(one: Any, other: Any) -> float:
        squares = np.square(one - other)[result.mask]
        return float(np.sqrt(squares.mean()) / other[result.mask].mean())

    for i in range(len(lights)):
        assert off(found[i], relit[i]) < 0.5 * off(found[i], relit[i - 1])
