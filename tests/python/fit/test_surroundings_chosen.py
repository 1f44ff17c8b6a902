"""Which surroundings a fit takes its pictures to be among, on rooms that the package renders."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import pbrfit
from pbrfit import InputError, Scene
from pbrfit.fit import settings, transport
from pbrfit.model.materials import Materials
from pbrfit.synthetic.lights import random_lights
from pbrfit.transport import scenery
from pbrfit.transport.decision import Transport
from pbrfit.transport.scenery import Scenery
from small_worlds import box_room

SIZE, FOV, PICTURES = 24, 70.0, 8


@pytest.fixture(scope="module")
def room() -> dict[str, Any]:
    """A room, its materials by segment, its lights."""
    return room_of(3)


def room_of(seed: int) -> dict[str, Any]:
    """A room with other materials and lights."""
    seen = box_room(SIZE)
    rng = np.random.default_rng(seed)
    kinds = int(seen.segments.max()) + 1
    albedo = rng.uniform(0.15, 0.8, (kinds, 3))
    roughness = rng.uniform(0.3, 0.9, kinds)
    metallic = (np.arange(kinds) % 4 == 3).astype(float)
    maps = Materials(albedo[seen.segments], roughness[seen.segments], metallic[seen.segments])
    lights = random_lights(PICTURES, np.random.default_rng(seed + 1))
    normals = seen.normals.astype(np.float32)
    depth = -seen.points[..., 2].astype(np.float32)
    given = {
        "normals": normals,
        "fov": FOV,
        "mask": seen.mask,
        "segments": seen.segments,
        "depth": depth,
        "model": "principled",
    }
    what_blocks = Scenery(depth, normals, seen.mask, seen.segments, FOV)
    return {"maps": maps, "lights": lights, "given": given, "scenery": what_blocks}


def scene_of(room: dict[str, Any], kind: str | None) -> Scene:
    """Pictures of the room: open to the sky, or among its surroundings."""
    maps, lights, given = room["maps"], room["lights"], room["given"]
    if kind is None:
        images = pbrfit.kernel.render(maps, given["normals"], lights, FOV, model="principled")
    else:
        # With the rays of a fit, and all that is reflected: else the true room does not fit.
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(scenery, "BOUNCES", 8)
            patch.setattr(scenery, "BOUNCE_RAYS", scenery.RAYS)
            images = room["scenery"].render(
                maps,
                given["normals"],
                lights,
                Transport(kind=kind),  # type: ignore[arg-type]
                model="principled",
            )
    return Scene(images=np.nan_to_num(images).astype(np.float32), **given)


def error(found: pbrfit.Result, maps: Materials, name: str) -> float:
    difference = getattr(found, name) - getattr(maps, name)
    return float(np.sqrt(np.nanmean(np.square(difference))))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["occlusion", "bounce"])
def test_pictures_among_surroundings_are_explained_by_them(room: dict[str, Any], kind: str) -> None:
    scene = scene_of(room, kind)
    found = pbrfit.decompose(scene, uncertainty=False)
    assert found.transport.kind == kind
    assert found.held_out is not None
    assert "surroundings block light" in found.held_out.chosen
    open_to_light = [one for one in found.held_out.candidates if "surroundings" not in one.what]
    assert min(one.error for one in open_to_light) > 10 * found.held_out.error
    without = pbrfit.decompose(scene, uncertainty=False, transport="none")
    assert without.transport.kind == "none"
    for name in ("albedo", "roughness"):
        assert error(found, room["maps"], name) < error(without, room["maps"], name)
    assert found.metrics["recon_rmse"] < 0.3 * without.metrics["recon_rmse"]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 13, 23, 33, 43])
def test_materials_are_found_by_the_light_that_they_send_each_other(seed: int) -> None:
    room = room_of(seed)
    found = pbrfit.decompose(
        scene_of(room, "bounce"), uncertainty=False, transport="bounce", light="sh"
    )
    assert error(found, room["maps"], "albedo") < 2e-3
    assert error(found, room["maps"], "roughness") < 0.05


@pytest.mark.slow
def test_surroundings_are_taken_on_pictures_among_them(
    room: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(settings, "TRANSPORT_PIXELS", 60)
    monkeypatch.setattr(settings, "GLOBAL_ROUNDS_MAX", 1)
    monkeypatch.setattr(transport, "candidates", lambda _: [])
    for kind, taken in (("occlusion", "occlusion"), (None, "none")):
        found = pbrfit.decompose(
            scene_of(room, kind), uncertainty=False, refine_normals="off", light="sh", iterations=5
        )
        assert found.transport.kind == taken
        assert ("left_out_occlusion" in found.transport.figures) == (kind is not None)


@pytest.mark.slow
def test_pictures_without_shadows_are_left_without(room: dict[str, Any]) -> None:
    scene = scene_of(room, None)
    found = pbrfit.decompose(scene, uncertainty=False, refine_normals="off")
    assert found.transport.kind == "none"
    without = pbrfit.decompose(replace(scene, depth=None), uncertainty=False, refine_normals="off")
    np.testing.assert_array_equal(found.albedo, without.albedo)
    np.testing.assert_array_equal(found.lighting, without.lighting)


def test_surroundings_need_depth(room: dict[str, Any]) -> None:
    scene = replace(scene_of(room, None), depth=None)
    with pytest.raises(InputError, match="transport: expected a scene with depth"):
        pbrfit.decompose(scene, transport="occlusion")
    with pytest.raises(InputError, match="transport: expected one of none, occlusion"):
        pbrfit.decompose(scene, transport="shadows")


@pytest.mark.slow
def test_relighting_has_the_shadows_that_were_found(room: dict[str, Any]) -> None:
    scene = scene_of(room, "occlusion")
    found = pbrfit.decompose(scene, uncertainty=False, transport="occlusion")
    light = room["lights"][0]
    with_them = pbrfit.relight(found, light)
    without = pbrfit.relight(found, light, shadows=False)
    shown = scene.images[0]
    valid = scene.valid
    assert np.abs(with_them - shown)[valid].mean() < 0.3 * np.abs(without - shown)[valid].mean()


@pytest.mark.slow
def test_holes_in_the_depth_block_nothing_and_break_nothing(room: dict[str, Any]) -> None:
    scene = scene_of(room, "occlusion")
    depth = scene.depth.copy()  # type: ignore[union-attr]
    depth[5:9, 4:12] = np.nan
    given = room["given"] | {"depth": depth}
    holed = Scene(images=scene.images, **given)
    found = pbrfit.decompose(holed, uncertainty=False)
    assert np.isfinite(found.albedo[found.mask]).all()
    assert found.transport.kind == "occlusion"
