"""The words beside verdicts: what is wrong with a scene, and what would help."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from pbrfit.fit import causes
from pbrfit.fit.discrepancy import Discrepancy
from pbrfit.fit.independent_lights import NUMBERS_MIN, Shown
from pbrfit.io.limits import AT_LEAST
from pbrfit.model.materials import Materials
from pbrfit.result.uncertainty import Uncertainty
from pbrfit.result.verdict import PARAMETERS, Verdict, level_of
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import make_scene
from pbrfit.transport.decision import Transport

NOISE = Discrepancy(1e-4, 0.0, np.zeros((0, 1, 16, 1)), 0.0)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return make_scene("room", size=8, lights=8, held_out=1, seed=3)


def around(count: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Lights from all sides in turn."""
    found = np.zeros((count, 16, 3))
    found[:, 0] = 1
    for i in range(count):
        found[i, 1 + i % 3] = (-1) ** i
    return found


def said(scene: Scene, error: float = 0.2, **facts: Any) -> dict[str, Verdict]:
    given: dict[str, Any] = {
        "normals": scene.normals,
        "discrepancy": NOISE,
        "shown": None,
        "transport": Transport(),
        "lighting": around(len(scene.images)),
        "albedo": np.full((8, 8, 3), 0.5),
    } | facts
    verdicts = {name: Verdict(level_of(name, error), error) for name in PARAMETERS}
    scale = given.pop("albedo_scale", (0.0, 0.0, 0.0))
    maps = Materials.of_planes(np.full((8, 8, 5), error))
    uncertainty = Uncertainty(maps, maps, maps, None, 1.0, scale, verdicts)
    return causes.with_causes(uncertainty, scene, **given)


def test_usable_maps_need_no_excuse(scene: Scene) -> None:
    assert all(not one.cause and not one.remedy for one in said(scene, 0.05).values())


def test_noise_is_what_is_left(scene: Scene) -> None:
    assert "noise" in said(scene)["roughness"].cause
    assert "would help" in said(scene)["roughness"].remedy


def test_misfit_above_noise_is_named(scene: Scene) -> None:
    off = dataclasses.replace(NOISE, shared=1.0)
    assert "does not explain" in said(scene, discrepancy=off)["metallic"].cause
    below = dataclasses.replace(NOISE, shared=1e-5)
    assert "noise" in said(scene, discrepancy=below)["metallic"].cause


def test_flat_normals_are_named(scene: Scene) -> None:
    normals = np.zeros_like(scene.normals)
    normals[..., 2] = 1
    flat = dataclasses.replace(scene, normals=normals)
    assert "face the camera" in said(flat)["metallic"].cause
    assert "face the camera" not in said(flat, normals=scene.normals)["metallic"].cause  # found


def test_light_from_one_side_is_named(scene: Scene) -> None:
    light = np.zeros((8, 16, 3))
    light[:, 0], light[:, 3] = 1, 0.8
    found = said(scene, lighting=light)["roughness"]
    assert found.cause == "light from one side, the right, in all pictures"
    assert found.remedy == "pictures lit from the left would help"
    assert "one side" not in said(scene)["roughness"].cause
    assert "one side" not in said(scene, lighting=None)["roughness"].cause


def test_few_pictures_are_counted(scene: Scene) -> None:
    few = dataclasses.replace(
        scene, images=scene.images[:3], names=scene.names[:3], lighting=None, truth=None
    )
    assert said(few, lighting=around(3))["roughness"].cause == "only 3 pictures"
    enough = causes.FEW_PICTURES
    many = dataclasses.replace(
        scene, images=scene.images[:enough], names=scene.names[:enough], truth=None
    )
    assert "only" not in said(many, lighting=around(enough))["roughness"].cause


@pytest.mark.parametrize(("numbers", "usable"), [(8.99, False), (9.01, True)])
def test_maps_are_usable_where_enough_is_spare(scene: Scene, numbers: float, usable: bool) -> None:
    shown = Shown((3, 3, 3), 9 / NUMBERS_MIN * 9 / numbers)
    found = said(scene, 0.05, shown=shown)
    assert all((one.level == "usable") == usable for one in found.values())
    assert usable or found["albedo"].cause == "only 3 independent lights in 8 pictures"


def test_clipping_is_named_from_a_share_on(scene: Scene) -> None:
    limits = np.zeros(scene.images.shape, np.uint8)
    limits[:4, :, :4] = AT_LEAST  # a quarter
    clipped = dataclasses.replace(scene, limits=limits)
    assert "clipped" in said(clipped)["roughness"].cause
    limits = np.zeros(scene.images.shape, np.uint8)
    limits[0, :2] = AT_LEAST  # a thirty-second
    assert "clipped" not in said(dataclasses.replace(scene, limits=limits))["roughness"].cause


def test_the_scale_is_named_beside_albedo_alone(scene: Scene) -> None:
    found = said(scene, albedo_scale=(0.4, 0.4, 0.4))
    assert "brightness of albedo is uncertain by 40 %" in found["albedo"].cause
    assert "option white" in found["albedo"].remedy
    assert "factor" not in found["roughness"].cause
    assert "factor" not in said(scene, albedo_scale=(0.1, 0.1, 0.1))["albedo"].cause
