"""MaterialX: a sound document whose files are there, and what MaterialX itself makes of it.

The latter skips without a Python with the MaterialX wheel, PBRFIT_MATERIALX_PYTHON.
"""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pbrfit import Result, decompose
from pbrfit.export import export_result
from pbrfit.export.maps import NormalConvention
from pbrfit.synthetic import make_scene

VARIABLE = "PBRFIT_MATERIALX_PYTHON"
READER = Path(__file__).parents[2] / "support" / "materialx_reader.py"

CASES: list[tuple[NormalConvention, bool]]
CASES = [("opengl", False), ("opengl", True), ("directx", True)]


@pytest.fixture(scope="module")
def result() -> Result:
    return decompose(make_scene("room", size=12, lights=3, held_out=1), iterations=1)


def exported(result: Result, folder: Path, normals: NormalConvention, masked: bool) -> Path:
    if masked:
        mask = result.mask.copy()
        mask[:3] = False
        result = dataclasses.replace(result, mask=mask)
    export_result(result, folder / "out", format="mtlx", normals=normals)
    return folder / "out" / "material.mtlx"


@pytest.mark.parametrize(("normals", "masked"), CASES)
def test_the_document_is_sound_and_its_files_are_there(
    result: Result, tmp_path: Path, normals: NormalConvention, masked: bool
) -> None:
    path = exported(result, tmp_path, normals, masked)
    document = ET.parse(path).getroot()
    assert document.tag == "materialx"
    assert document.get("colorspace") == "lin_rec709"
    names = [node.get("name") for node in document.iter() if node.tag not in ("input", "output")]
    assert len(names) == len(set(names))
    files = {}
    for image in document.iter("image"):
        [file] = [one for one in image.iter("input") if one.get("name") == "file"]
        value = file.get("value", "")
        assert (path.parent / value).is_file()
        files[value] = (image.get("type"), file.get("colorspace"))
    expected: dict[str, Any] = {
        "png/base_color.png": ("color3", "srgb_texture"),
        "png/roughness.png": ("float", None),
        "png/metallic.png": ("float", None),
        f"png/normal_{normals}.png": ("vector3", None),
    }
    assert files == expected | ({"png/mask.png": ("float", None)} if masked else {})
    # Every connection leads somewhere, with the type that is there.
    [graph] = document.iter("nodegraph")
    nodes = {node.get("name"): node.get("type") for node in (*document, *graph)}
    outputs = {node.get("name"): node.get("type") for node in graph.iter("output")}
    for one in [*document.iter("input"), *graph.iter("output")]:
        if one.get("nodename"):
            assert nodes[one.get("nodename")] == one.get("type")
        elif one.get("output"):
            assert outputs[one.get("output")] == one.get("type")
        else:
            assert one.get("value")
    materials = [node.get("name") for node in document.iter("surfacematerial")]
    assert materials == ["pbrfit", "pbrfit_gltf"]


@pytest.mark.skipif(not os.environ.get(VARIABLE), reason=f"{VARIABLE} is not set")
@pytest.mark.parametrize(("normals", "masked"), CASES)
def test_materialx_finds_every_definition_and_makes_shaders(
    result: Result, tmp_path: Path, normals: NormalConvention, masked: bool
) -> None:
    path = exported(result, tmp_path, normals, masked)
    done = subprocess.run(
        [os.environ[VARIABLE], READER, path],
        capture_output=True,
        text=True,
        check=False,
        env={"PATH": os.environ.get("PATH", "")},
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["valid"], found["message"]
    definitions = found["definitions"]
    assert all(definitions.values()), definitions
    assert definitions["surface"] == "ND_standard_surface_surfaceshader"
    assert definitions["gltf_surface"] == "ND_gltf_pbr_surfaceshader"
    assert definitions["maps/normal"].startswith("ND_normalmap")
    for material in ("pbrfit", "pbrfit_gltf"):
        shader = found["shaders"][material]
        assert shader["decodes_srgb"]
        assert set(shader["files"]) >= {
            str(path.parent / f"png/{name}.png")
            for name in ("base_color", "roughness", "metallic", f"normal_{normals}")
        }
    if normals == "directx":
        assert np.allclose(found["normal_scale"], [1, -1])
