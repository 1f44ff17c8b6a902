"""Results among surroundings: what they keep, what is built from it again, and relighting."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pbrfit import DirectionalLight, InputError, Result, Scene, decompose, relight
from pbrfit.batch.scenes import details
from pbrfit.fit import compare, settings
from pbrfit.fit import transport as fit_transport
from pbrfit.report.inspection import facts
from pbrfit.result.data import SEGMENT_MAX
from pbrfit.scene.arrays import storable_ids
from pbrfit.transport.decision import Transport
from pbrfit.transport.scenery import Scenery
from relit import even, shaded_ball
from scene_files import known
from small_worlds import box_room

FEW: dict[str, Any] = {"iterations": 2, "uncertainty": False, "equal_exposures": False}


def room_scene() -> Scene:
    """The box room under three lights from above, with what blocks them; a part has no pixels."""
    seen = box_room(28)
    mask = seen.mask.copy()
    mask[:, :4] = False
    depth = -seen.points[..., 2].astype(np.float32)
    scenery = Scenery(depth, seen.normals, seen.mask, seen.segments, 65.0)
    shape = mask.shape
    materials = even(seen.mask, 0.6)
    rng = np.random.default_rng(3)
    lights = np.zeros((4, 16, 3))
    lights[:, 0] = 3.0
    lights[:, 1:4] = rng.normal(0, 1.5, (4, 3, 1))
    lights[:, 4:9] = rng.normal(0, 0.5, (4, 5, 1))
    pictures = scenery.render(
        materials, seen.normals, lights, Transport("occlusion"), model="principled"
    )
    assert pictures.shape == (4, *shape, 3)
    return Scene(
        images=np.maximum(np.nan_to_num(pictures), 1e-3).astype(np.float32),
        normals=np.where(mask[..., None], seen.normals, np.nan),
        mask=mask,
        fov=65.0,
        depth=depth,
        segments=seen.segments,
        model="principled",
    )


@pytest.fixture(scope="module")
def made() -> tuple[Scene, Result, list[Scenery]]:
    """A fit among surroundings that were not searched for long, and the scenery that it chose."""
    chosen = []
    real = fit_transport.search

    def search(*arguments: object) -> fit_transport.Surrounded:
        found = real(*arguments)  # type: ignore[arg-type]
        chosen.append(found.scenery)
        return found

    scene = room_scene()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(settings, "COMPARE_KEPT_MIN", 1 << 20)  # nothing is compared
        patch.setattr(settings, "TRANSPORT_PIXELS", 40)
        patch.setattr(settings, "GLOBAL_ROUNDS_MAX", 1)
        patch.setattr(fit_transport, "candidates", lambda _: [])
        patch.setattr(compare, "search", search)
        result = decompose(scene, transport="occlusion", **FEW)
    return scene, result, chosen


@pytest.fixture
def loaded(made: tuple[Scene, Result, list[Scenery]], tmp_path: Path) -> Result:
    made[1].save(tmp_path / "result")
    return Result.load(tmp_path / "result")


def test_scenery_of_a_loaded_result_is_that_of_the_fit(
    made: tuple[Scene, Result, list[Scenery]], loaded: Result
) -> None:
    _, result, [chosen] = made
    for one in (result, loaded):
        for name in ("triangles", "starts", "kind"):
            found = getattr(known(one.scenery), name)
            np.testing.assert_array_equal(found, getattr(chosen, name))


def test_the_decision_is_kept(
    made: tuple[Scene, Result, list[Scenery]], loaded: Result, tmp_path: Path
) -> None:
    scene, result, _ = made
    assert result.transport.kind == "occlusion"
    assert loaded.transport == result.transport
    np.testing.assert_array_equal(known(loaded.segments), scene.segments)
    np.testing.assert_array_equal(loaded.depth, scene.depth)  # outside the mask, too
    content = json.loads((tmp_path / "result" / "result.json").read_text("utf-8"))
    assert content["transport"]["kind"] == "occlusion"
    words = content["assumed"]["surroundings"]
    assert words.startswith("block light (asked for)")
    assert "floor" in words
    assert not any(line.startswith("surroundings") for line in loaded.left_out)


def test_relit_by_its_lights_the_pictures_come_back(
    made: tuple[Scene, Result, list[Scenery]], loaded: Result
) -> None:
    scene, _, _ = made
    true = np.where(scene.valid[..., None], scene.images, np.nan)
    among, without = (relight(loaded, loaded.lighting, shadows=one) for one in (True, False))
    off = [float(np.sqrt(np.nanmean((one - true) ** 2))) for one in (among, without)]
    assert off[0] == pytest.approx(loaded.metrics["recon_rmse"], rel=0.02)
    assert off[0] < 0.2 * off[1]
    assert np.isnan(among[:, ~loaded.mask]).all()
    at_once = known(loaded.scenery).render(
        *(loaded.materials, loaded.normals, loaded.lighting, loaded.transport), model=loaded.model
    )
    np.testing.assert_allclose(among, at_once, atol=1e-5)
    np.testing.assert_allclose(relight(loaded, loaded.lighting[1]), among[1], atol=1e-12)


def test_unusable_light_is_refused_among_surroundings(loaded: Result) -> None:
    with pytest.raises(InputError, match="lighting: expected shape"):
        relight(loaded, np.zeros((3, 9)))
    with pytest.raises(InputError, match="finite"):
        relight(loaded, np.full((16, 3), np.nan))


def test_a_ball_throws_its_shadow_away_from_a_lamp() -> None:
    result = shaded_ball()
    lamp = DirectionalLight(azimuth=-80.0, elevation=45.0)  # from the left
    lit, bare = relight(result, lamp), relight(result, lamp, shadows=False)
    segments = known(result.segments)
    floor = segments == 1
    dark = floor & (lit[..., 1] == 0) & (bare[..., 1] > 0)
    share = dark.sum() / floor.sum()
    assert 0.01 < share < 0.3
    ball_at = np.nonzero(segments == 2)[1].mean()
    assert np.nonzero(dark)[1].mean() > ball_at + 3
    open_floor = floor & ~dark
    np.testing.assert_array_equal(lit[open_floor], bare[open_floor])


def test_ids_too_large_for_float32_are_counted_anew() -> None:
    small = np.array([[0, 7, 9]])
    np.testing.assert_array_equal(storable_ids(small, SEGMENT_MAX), small)
    at = np.array([[0, SEGMENT_MAX]])
    np.testing.assert_array_equal(storable_ids(at, SEGMENT_MAX), at)
    large = np.array([[7, SEGMENT_MAX + 1, 0, -3]])
    np.testing.assert_array_equal(storable_ids(large, SEGMENT_MAX), [[2, 3, 0, 1]])
    np.testing.assert_array_equal(storable_ids(large[:, :2], SEGMENT_MAX), [[1, 2]])


def test_what_was_decided_is_said_and_what_was_found_before(
    made: tuple[Scene, Result, list[Scenery]],
) -> None:
    scene, result, _ = made
    [said] = [line for line in details(result) if line.startswith("surroundings")]
    assert said.startswith("surroundings: block light (asked for): things up to")
    found = dict(facts(scene))["surroundings"]
    assert "floor" in found
    assert dict(facts(dataclasses.replace(scene, depth=None)))["surroundings"].startswith("unknown")
