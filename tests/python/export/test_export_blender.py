"""An exported .glb in Blender: what it becomes there, and that Cycles lights it as we do.

Needs a Python with bpy (`make cycles-env`, or PBRFIT_CYCLES_PYTHON) and skips without.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from blender_card import TURN, InBlender, Rendering, in_blender, relief, to_camera_space
from pbrfit import Result
from pbrfit.export import export_result
from pbrfit.kernel import render, sh_basis, view_directions
from pbrfit.model.lighting import rotated
from pbrfit_evaluation.cycles import why_not

HEIGHT, WIDTH = 36, 48
pytestmark = pytest.mark.skipif(why_not() is not None, reason=str(why_not()))


@pytest.fixture(scope="module")
def result() -> Result:
    return relief(HEIGHT, WIDTH)


@pytest.fixture(scope="module")
def blender(result: Result, tmp_path_factory: pytest.TempPathFactory) -> InBlender:
    """The whole way: the exported card under the exported light."""
    folder = tmp_path_factory.mktemp("card")
    exported = export_result(result, folder / "out", format="gltf")
    assert [light.difference for light in exported.panoramas] == [0, 0, 0]
    light = folder / "out" / "lights" / exported.panoramas[0].file
    return in_blender(
        folder / "job",
        folder / "out" / "material.glb",
        (WIDTH, HEIGHT),
        [
            Rendering("flat", light, diffuse=True, flat=True, samples=512),
            Rendering("diffuse", light, diffuse=True),
            Rendering("default", light),
            Rendering("green flipped", light, flip_green=True, diffuse=True, samples=64),
        ],
    )


@pytest.fixture(scope="module")
def facets(result: Result, tmp_path_factory: pytest.TempPathFactory) -> InBlender:
    """The same with a rectangle for each pixel."""
    folder = tmp_path_factory.mktemp("facets")
    exported = export_result(result, folder / "out", format="gltf", geometry="facets")
    light = folder / "out" / "lights" / exported.panoramas[0].file
    return in_blender(
        folder / "job",
        folder / "out" / "material.glb",
        (WIDTH, HEIGHT),
        [
            Rendering("diffuse", light, diffuse=True),
            Rendering("default", light),
            Rendering("GGX", light, distribution="GGX"),
            Rendering("rotated by 30", light, turn=TURN - 30, diffuse=True),
            Rendering("not turned", light, turn=0.0, diffuse=True, samples=64),
            Rendering("turned back", light, turn=90.0, diffuse=True, samples=64),
            Rendering("mirrored", light, scale=(-1, 1, 1), diffuse=True, samples=64),
        ],
        camera_only=True,
    )


def diffuse(
    result: Result, normals: NDArray[np.float64], rotate: float = 0.0
) -> NDArray[np.float64]:
    """A Diffuse BSDF under the first light, turned: albedo/π Σ A_l Y(n) L."""
    light = rotated(result.lighting[0], rotate)
    transfer = np.repeat([np.pi, 2 * np.pi / 3, np.pi / 4, 0.0], [1, 3, 5, 7])
    irradiance = np.full(normals.shape, np.nan)
    irradiance[result.mask] = sh_basis(normals[result.mask]) * transfer @ light
    return np.asarray(result.albedo / np.pi * irradiance)


def difference(found: NDArray[Any], expected: NDArray[Any], of: NDArray[np.bool_]) -> float:
    """RMSE over the mean."""
    residual = found[..., :3][of] - expected[of]
    return float(np.sqrt(np.mean(residual**2)) / expected[of].mean())


def test_blender_reads_sockets_color_spaces_and_camera(blender: InBlender) -> None:
    inputs = blender.facts["inputs"]
    assert inputs["Base Color"] == [["TEX_IMAGE", "Color", "base_color", "sRGB"]]
    packed = ["TEX_IMAGE", "Color", "metallic_roughness", "Non-Color"]
    assert inputs["Metallic"] == [["SEPARATE_COLOR", "Blue"], packed]
    assert inputs["Roughness"] == [["SEPARATE_COLOR", "Green"], packed]
    assert inputs["Normal"] == [
        ["NORMAL_MAP", "Normal"],
        ["TEX_IMAGE", "Color", "normal", "Non-Color"],
    ]
    assert inputs["Alpha"][-1] == ["TEX_IMAGE", "Alpha", "base_color", "sRGB"]
    assert blender.facts["camera"] == "PERSP"


def test_what_blender_sees_is_the_result(blender: InBlender, result: Result) -> None:
    seen, inside = blender.seen, result.mask
    np.testing.assert_array_equal(blender.pictures["default"][..., 3] > 0.5, inside)
    for name, expected in (
        ("albedo", result.albedo),
        ("roughness", result.roughness),
        ("metallic", result.metallic),
    ):
        np.testing.assert_allclose(seen[name][inside], expected[inside], atol=0.006, err_msg=name)
    normals = to_camera_space(seen["normals"])
    np.testing.assert_allclose(normals[inside], result.normals[inside], atol=1e-4)
    camera = np.array([0, 0, 0.5 / np.tan(np.radians(result.fov) / 2)])
    towards = camera - to_camera_space(seen["positions"])
    views = towards / np.linalg.norm(towards, axis=-1, keepdims=True)
    np.testing.assert_allclose(
        views[inside], view_directions(HEIGHT, WIDTH, result.fov)[inside], atol=1e-5
    )


def test_a_flat_diffuse_card_agrees_within_one_percent(blender: InBlender, result: Result) -> None:
    flat = np.broadcast_to([0.0, 0.0, 1.0], result.normals.shape)
    assert difference(blender.pictures["flat"], diffuse(result, flat), result.mask) < 0.01


def test_relief_agrees_but_for_light_from_behind_the_plane(
    blender: InBlender, facets: InBlender, result: Result
) -> None:
    """Cycles lights a card by nothing that lies behind its plane; facets have none."""
    expected = diffuse(result, result.normals)
    on_card = difference(blender.pictures["diffuse"], expected, result.mask)
    on_facets = difference(facets.pictures["diffuse"], expected, result.mask)
    assert on_facets < 0.01
    assert 2 * on_facets < on_card < 0.03


def test_rotating_the_light_is_turning_the_world_further(facets: InBlender, result: Result) -> None:
    """`pbrfit relight --rotate 30` is −120° in the Mapping node."""
    expected = diffuse(result, result.normals, rotate=30)
    assert difference(facets.pictures["rotated by 30"], expected, result.mask) < 0.01
    back = diffuse(result, result.normals, rotate=-30)
    assert difference(facets.pictures["rotated by 30"], back, result.mask) > 0.1


def test_facets_have_the_normals_of_the_result(facets: InBlender, result: Result) -> None:
    normals = to_camera_space(facets.seen["normals"])
    np.testing.assert_allclose(normals[result.mask], result.normals[result.mask], atol=2e-3)
    np.testing.assert_array_equal(facets.pictures["default"][..., 3] > 0.5, result.mask)
    assert facets.facts["inputs"]["Normal"] == []


def test_whole_materials_agree_within_the_gap_of_the_model(
    blender: InBlender, facets: InBlender, result: Result
) -> None:
    """docs/export.md and docs/model.md say what is left: the lobe of rough metals."""
    expected = render(
        result.materials, result.normals, result.lighting[0], result.fov, model=result.model
    )
    metal = result.mask & (result.metallic > 0.5)
    dielectric = result.mask & (result.metallic <= 0.5)
    for picture, matt, shiny in (
        (blender.pictures["default"], 0.03, 0.11),
        (facets.pictures["default"], 0.02, 0.11),
        (facets.pictures["GGX"], 0.02, 0.14),
    ):
        assert difference(picture, expected, dielectric) < matt
        assert difference(picture, expected, metal) < shiny


def test_a_wrong_axis_is_far_off(blender: InBlender, facets: InBlender, result: Result) -> None:
    expected = diffuse(result, result.normals)

    def off(of: InBlender, name: str) -> float:
        return difference(of.pictures[name], expected, result.mask)

    for wrong in ("not turned", "turned back", "mirrored"):
        assert off(facets, wrong) > 15 * off(facets, "diffuse"), wrong
    assert off(blender, "green flipped") > 2.5 * off(blender, "diffuse")
