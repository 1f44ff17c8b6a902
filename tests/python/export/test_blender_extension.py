"""The Blender extension: what is in its .zip, and that Cycles shows what `relight` does.

What runs in Blender skips without bpy (`make cycles-env`, or PBRFIT_CYCLES_PYTHON).
"""

from __future__ import annotations

import ast
import io
import subprocess
import sys
import tomllib
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest
from numpy.typing import NDArray

from blender_card import planted
from blender_extension import Import, imported
from pbrfit import Result, relight
from pbrfit.export import export_result
from pbrfit.export.blender import ZIP_FILE, extension
from pbrfit.io import images
from pbrfit.model import panorama
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import Model
from pbrfit.result.relighting import DirectionalLight, turned
from pbrfit.synthetic import make_scene
from pbrfit_evaluation.cycles import why_not
from pbrfit_evaluation.cycles.process import find_python
from scene_files import lights_of, truth_of

SIZE = 32
SUN = DirectionalLight(-50.0, 35.0)

needs_bpy = pytest.mark.skipif(why_not() is not None, reason=str(why_not()))


def members() -> dict[str, str]:
    with ZipFile(io.BytesIO(extension())) as archive:
        assert archive.testzip() is None
        return {name: archive.read(name).decode() for name in archive.namelist()}


def test_the_zip_has_manifest_code_and_geometry_and_is_always_the_same() -> None:
    found = members()
    assert list(found) == ["blender_manifest.toml", "__init__.py", "view_mesh.py"]
    assert extension() == extension()
    manifest = tomllib.loads(found["blender_manifest.toml"])
    assert manifest["version"] == version("pbrfit")
    assert (manifest["id"], manifest["type"]) == ("pbrfit", "add-on")
    assert tuple(map(int, manifest["blender_version_min"].split("."))) >= (4, 2, 0)
    assert manifest["license"] == ["SPDX:MIT", "SPDX:Apache-2.0"]


def test_the_extension_imports_what_blender_has() -> None:
    blenders = {"bpy", "bpy_extras", "mathutils", "numpy"}
    for name, content in members().items():
        if not name.endswith(".py"):
            continue
        for node in ast.walk(ast.parse(content)):
            if isinstance(node, ast.Import):
                modules = [one.name for one in node.names]
            elif isinstance(node, ast.ImportFrom):
                modules = [str(node.module)] if node.level == 0 else []
                assert node.level == 0 or f"{node.module}.py" in members()
            else:
                continue
            for module in modules:
                root = module.partition(".")[0]
                assert root in blenders or root in sys.stdlib_module_names, (name, module)


def room(model: Model) -> Result:
    """A room with its true materials and normals, a corner masked."""
    made = make_scene("room", size=SIZE, lights=3, held_out=1, model=model)
    mask = made.valid.copy()
    mask[:5, :9] = False
    true = truth_of(made).materials
    materials = Materials(true.albedo.copy(), true.roughness.copy(), true.metallic.copy())
    normals = made.normals.astype(np.float64)
    return planted(materials, normals, mask, fov=made.fov, lighting=lights_of(made), model=model)


@dataclass(frozen=True)
class Shown:
    """A result, what Blender says of its imports, and what Cycles shows."""

    result: Result
    facts: dict[str, Any]
    pictures: dict[str, NDArray[np.float32]]

    def error(self, name: str, light: Any, of: NDArray[np.bool_] | None = None) -> float:
        """RMSE over RMS radiance."""
        inside = self.result.mask if of is None else self.result.mask & of
        expected = relight(self.result, light)[inside]
        found = self.pictures[name][..., :3][inside]
        return float(np.sqrt(np.mean((found - expected) ** 2) / np.mean(expected**2)))


def shown(folder: Path, result: Result, runs: list[Import], **options: Any) -> Shown:
    export_result(result, folder / "out", preset="blender", **options)
    own = folder / "own.exr"  # the last light as a panorama of the user's own
    radiance = panorama.radiance(result.lighting[-1], 64)
    images.write_exr(own, {c: radiance[..., i] for i, c in enumerate("RGB")})
    runs = [
        replace(run, then=run.then | {"panorama": str(own)}) if "panorama" in run.then else run
        for run in runs
    ]
    return Shown(result, *imported(folder / "job", folder / "out", runs))


@pytest.fixture(scope="module")
def principled(tmp_path_factory: pytest.TempPathFactory) -> Shown:
    runs = [
        Import("first"),
        Import("last, turned", {"light": "light_02", "rotation": 40.0}),
        Import("own panorama", then={"panorama": ""}),
        Import("sun", {"sun": True, "azimuth": -50.0, "elevation": 35.0}, samples=16),
        Import("sun and back", {"sun": True}, then={"light": "light_01"}),
        Import("relief", {"geometry": "RELIEF"}, samples=64),
        Import("shadows", {"as_relit": False}, samples=0),
        Import("no such", {"light": "elsewhere"}, samples=0),
    ]
    return shown(tmp_path_factory.mktemp("principled"), room("principled"), runs)


@needs_bpy
def test_blenders_own_check_takes_the_zip(tmp_path: Path) -> None:
    (tmp_path / ZIP_FILE).write_bytes(extension())
    [cli] = (
        find_python().parents[1].glob("lib/*/site-packages/bpy/*/scripts/addons_core/bl_pkg/cli")
    )
    done = subprocess.run(
        [find_python(), cli / "blender_ext.py", "validate", tmp_path / ZIP_FILE],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


@needs_bpy
def test_blender_installs_enables_and_removes_it(principled: Shown) -> None:
    assert principled.facts["installed"] == ["FINISHED"]
    assert principled.facts["enabled"] == ["bl_ext.user_default.pbrfit"]
    assert principled.facts["gone"]


@needs_bpy
def test_the_import_sets_camera_size_colours_and_rays(principled: Shown) -> None:
    told = principled.facts["scenes"]["first"]
    kind, angle, _, *place = told["camera"]
    fov = np.radians(principled.result.fov)
    assert kind == "PERSP"
    np.testing.assert_allclose(angle, fov, rtol=1e-6)
    np.testing.assert_allclose(place, [0, -0.5 / np.tan(fov / 2), 0], atol=1e-6)
    assert told["size"] == [SIZE, SIZE]
    assert told["view"] == ["Standard", "None"]
    assert (told["bounces"], told["shadow"]) == (0, False)
    assert told["faces"] == np.count_nonzero(principled.result.mask)
    spaces = {name.partition(".")[0]: space for name, (space, _) in told["images"].items()}
    assert spaces == {"base_color": "sRGB", "roughness": "Non-Color", "metallic": "Non-Color"}
    freely = principled.facts["scenes"]["shadows"]
    assert freely["bounces"] > 0
    assert freely["shadow"]


@needs_bpy
def test_cycles_shows_what_relight_shows(principled: Shown) -> None:
    lights = principled.result.lighting
    assert principled.error("first", lights[0]) < 0.02
    assert principled.error("last, turned", turned(lights[2], 40)) < 0.02
    assert principled.error("own panorama", lights[2]) < 0.02
    assert principled.error("sun and back", lights[1]) < 0.02
    assert principled.error("sun", SUN) < 0.01
    # What would be a wrong light.
    assert principled.error("last, turned", turned(lights[2], -40)) > 0.1
    assert principled.error("first", lights[1]) > 0.1


@needs_bpy
def test_pixels_outside_the_mask_are_transparent(principled: Shown) -> None:
    alpha = principled.pictures["first"][..., 3]
    np.testing.assert_array_equal(alpha > 0.5, principled.result.mask)


@needs_bpy
def test_suns_of_earlier_choices_go(principled: Shown) -> None:
    assert principled.facts["scenes"]["sun"]["suns"] == 1
    assert principled.facts["scenes"]["sun and back"]["suns"] == 0


@needs_bpy
def test_a_relief_is_near(principled: Shown) -> None:
    """docs/export.md says what it lacks."""
    light = principled.result.lighting[0]
    assert principled.error("relief", light) < 0.25


@needs_bpy
def test_what_cannot_be_imported_is_said(principled: Shown, tmp_path: Path) -> None:
    said = principled.facts["scenes"]["no such"]["error"]
    assert "expected one of the pictures light_00, light_01, light_02, found elsewhere" in said
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / ZIP_FILE).write_bytes(extension())
    facts, _ = imported(tmp_path / "job", tmp_path / "out", [Import("nothing", samples=0)])
    assert "expected a folder that `pbrfit export" in facts["scenes"]["nothing"]["error"]


@needs_bpy
def test_a_view_without_perspective_and_green_downwards(tmp_path: Path) -> None:
    result = room("principled")
    y, x = np.mgrid[:SIZE, :SIZE] / SIZE
    normals = np.stack([0.1 * np.sin(7 * x), 0.1 * np.cos(5 * y + x), np.ones_like(x)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    normals[~result.mask] = np.nan
    leaning = replace(result, normals=normals, fov=0.0)
    runs = [Import("facets"), Import("light", samples=0)]
    of = shown(tmp_path, leaning, runs, normals="directx")
    assert of.facts["scenes"]["facets"]["camera"][0] == "ORTHO"
    assert of.facts["scenes"]["facets"]["camera"][2] == 1
    assert of.error("facets", leaning.lighting[0]) < 0.02


@pytest.fixture(scope="module")
def paper(tmp_path_factory: pytest.TempPathFactory) -> Shown:
    runs = [
        Import("own law"),
        Import("principled", {"own_law": False}),
        Import("sun", {"sun": True, "azimuth": -50.0, "elevation": 35.0}, samples=16),
    ]
    return shown(tmp_path_factory.mktemp("paper"), room("paper"), runs)


@needs_bpy
def test_the_papers_law_is_nearer_by_its_own_nodes(paper: Shown) -> None:
    light = paper.result.lighting[0]
    assert paper.error("own law", light) < 0.04
    assert paper.error("principled", light) > 1.5 * paper.error("own law", light)
    assert paper.error("sun", SUN) < 0.08  # by Principled
