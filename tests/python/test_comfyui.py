"""The nodes for ComfyUI: types as it documents them, and what they give."""

from __future__ import annotations

import importlib
import json
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pbrfit import InputError, Scene, decompose
from pbrfit.io.color import decode_srgb, encode_srgb
from pbrfit.io.images import write_exr
from pbrfit.synthetic import make_scene
from scene_files import known, world

FOLDER = Path(__file__).resolve().parents[2] / "integrations" / "comfyui"

OF_COMFYUI = {
    "LoadImage": ([], ["IMAGE", "MASK"]),
    "ImageBatch": (["IMAGE", "IMAGE"], ["IMAGE"]),
    "PreviewImage": (["IMAGE"], []),
}
"""Types of what goes into its own nodes, and comes out."""


class Tensor(np.ndarray):
    """What of a tensor the nodes use."""

    def cpu(self) -> Tensor:
        return self


def tensor(values: Any) -> Tensor:
    return np.asarray(values, np.float32).view(Tensor)


@pytest.fixture
def nodes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> dict[str, Any]:
    """Node classes by name, with stand-ins for PyTorch and ComfyUI's folders."""
    folders = SimpleNamespace(
        get_output_directory=lambda: tmp_path,
        get_input_directory=lambda: tmp_path,
        get_save_image_path=lambda name, to: (to, name, len(list(tmp_path.iterdir())), "", name),
    )
    monkeypatch.setitem(sys.modules, "torch", SimpleNamespace(from_numpy=tensor))
    monkeypatch.setitem(sys.modules, "folder_paths", folders)
    monkeypatch.syspath_prepend(FOLDER.parent)
    module = importlib.import_module("comfyui")
    assert module.NODE_CLASS_MAPPINGS.keys() == module.NODE_DISPLAY_NAME_MAPPINGS.keys()
    return dict(module.NODE_CLASS_MAPPINGS)


def inputs_of(node: Any) -> dict[str, Any]:
    return {name: one for part in node.INPUT_TYPES().values() for name, one in part.items()}


def run(node: Any, **given: Any) -> Any:
    """Run a node with the defaults of its widgets, as ComfyUI fills them in."""
    described = {name: of[-1] for name, of in inputs_of(node).items() if len(of) > 1}
    values = {name: one["default"] for name, one in described.items() if "default" in one}
    return getattr(node(), node.FUNCTION)(**values | given)


def test_the_workflow_has_nodes_and_slots_that_are_there(nodes: dict[str, Any]) -> None:
    work = json.loads((FOLDER / "example_workflows" / "three_lamps.json").read_text())
    there = {one["id"]: one for one in work["nodes"]}
    for one in there.values():
        if one["type"] in OF_COMFYUI:
            into, out = OF_COMFYUI[one["type"]]
        else:
            node = nodes[one["type"]]
            kinds = [of[0] for of in inputs_of(node).values()]
            into = [kind for kind in kinds if kind in ("IMAGE", "MASK", "PBRFIT_RESULT")]
            out = list(node.RETURN_TYPES)
            assert len(one["widgets_values"]) == len(kinds) - len(into)
            assert node.CATEGORY == "pbrfit"
        assert [slot["type"] for slot in one["inputs"]] == into
        assert [slot["type"] for slot in one["outputs"]] == out
    for number, start, slot, end, place, kind in work["links"]:
        source, sink = there[start]["outputs"][slot], there[end]["inputs"][place]
        assert source["type"] == sink["type"] == kind
        assert number in source["links"]
        assert number == sink["link"]


def test_pictures_become_maps_that_are_relit_saved_and_read_again(
    nodes: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = partial(decompose, iterations=3)
    monkeypatch.setattr(sys.modules["comfyui.nodes"], "decompose", quick)
    scene = make_scene("room", size=20, lights=3, held_out=1, seed=3)
    *maps, result = run(
        nodes["PbrfitDecompose"],
        images=tensor(encode_srgb(np.clip(scene.images / scene.images.max(), 0, 1))),
        normals=tensor((scene.normals[None] * [1, -1, 1] + 1) / 2),
        normal_axes="directx",
        light="sh",
        fov_known=True,
        mask=tensor(np.arange(20) >= np.full((1, 20, 1), 2)),
    )
    inside = result.mask
    assert not inside[:, :2].any()
    assert inside[:, 2:].all()
    for picture in maps:
        assert picture.shape == (1, 20, 20, 3)
        assert picture.dtype == np.float32
        assert 0 <= picture.min() <= picture.max() <= 1
    np.testing.assert_allclose(2 * maps[3][0][inside] - 1, scene.normals[inside], atol=0.02)
    albedo = result.materials.albedo[inside]
    np.testing.assert_allclose(decode_srgb(maps[0][0])[inside], albedo, atol=1e-5)

    write_exr(tmp_path / "sky.exr", dict.fromkeys("RGB", np.ones((8, 16))))
    for name, light in (("Lamp", {}), ("Panorama", {"panorama": "sky.exr"})):
        dark, bright = (
            run(nodes[f"PbrfitRelight{name}"], result=result, exposure=stops, **light)[0]
            for stops in (-1.0, 0.0)
        )
        assert 0 < dark.mean() < bright.mean() < 1

    saved, other = (run(nodes["PbrfitSaveEXR"], result=result)["result"][0] for _ in range(2))
    assert saved != other
    for given, expected in (
        ({"layer": "albedo"}, maps[0]),
        ({"layer": "roughness", "encoding": "linear"}, maps[1]),
        ({"layer": "normal", "encoding": "normal"}, maps[3]),
    ):
        [read] = run(nodes["PbrfitLoadEXR"], file=saved, **given)
        np.testing.assert_allclose(read, expected, atol=1e-5)
    with pytest.raises(InputError, match=r"expected a layer 'gloss' of one or three channels, fo"):
        run(nodes["PbrfitLoadEXR"], file=saved, layer="gloss")


@pytest.mark.parametrize("kind", ["inverse relative", "relative", "distance"])
def test_depth_is_placed_by_the_normals(
    nodes: dict[str, Any], kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    true, normals = world("room", 3, 32, 32, 60.0)[:2]
    shown = {"inverse relative": 1 / true - 0.1, "relative": true - 1}.get(kind, true)
    given: dict[str, Any] = {"images": tensor(np.ones((3, 32, 32, 3))), "depth_kind": kind}
    given["depth"] = tensor(shown[None, ..., None])
    with pytest.raises(InputError, match="depth: expected normals beside it, found none"):
        run(nodes["PbrfitDecompose"], **given)

    def stopped(scene: Scene, **_: Any) -> None:
        ratio = known(scene.depth) / true
        raise InputError(f"off by {np.ptp(ratio) / ratio.mean():.0%}")

    monkeypatch.setattr(sys.modules["comfyui.nodes"], "decompose", stopped)
    with pytest.raises(InputError, match=r"off by [0-4]%"):
        run(nodes["PbrfitDecompose"], **given, normals=tensor((normals[None] + 1) / 2))
