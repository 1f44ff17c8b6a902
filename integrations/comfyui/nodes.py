"""Nodes: materials from a batch of pictures of one view, relit, and as EXR files with layers.

ComfyUI's IMAGE is a float32 tensor (B, H, W, C) in [0, 1], by convention encoded by sRGB's curve;
its MASK is (B, H, W) or (H, W). Here albedo and relit pictures are encoded so; roughness, metallic,
height and normals, n = 2v - 1, are data, as they are. Outside the mask maps have the values of the
nearest pixel inside. PBRFIT_RESULT is a `pbrfit.Result`.

Only `_image` imports torch, and only functions import ComfyUI's modules. What cannot be used raises
`pbrfit.InputError`: ComfyUI shows its one line.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit import DirectionalLight, Environment, InputError, Result, Scene, decompose, relight
from pbrfit.acquire.depth import with_offset
from pbrfit.display.tone import encoded
from pbrfit.export.displacement import Displacement
from pbrfit.io.color import decode_srgb, encode_srgb
from pbrfit.io.images import read_channels
from pbrfit.io.normal_files import Convention
from pbrfit.io.output import new_file
from pbrfit.model.materials import nearest_inside, write_materials
from pbrfit.values.checks import any_array
from pbrfit.values.quoting import listed

Array = NDArray[np.floating[Any]]
Inputs = dict[str, dict[str, Any]]

RESULT = "PBRFIT_RESULT"


def _number(default: float, least: float, most: float, said: str) -> tuple[str, dict[str, Any]]:
    limits = {"default": default, "min": least, "max": most, "step": 0.01}
    return "FLOAT", {**limits, "tooltip": said}


def _choice(*names: str, said: str) -> tuple[list[str], dict[str, Any]]:
    return list(names), {"default": names[0], "tooltip": said}


EXPOSURE = _number(0.0, -20.0, 20.0, "stops by which the picture is brightened")


class _Node:
    """What all nodes share, unless they say otherwise."""

    CATEGORY = "pbrfit"
    FUNCTION = "run"
    RETURN_TYPES: tuple[str, ...] = ("IMAGE",)


class Decompose(_Node):
    """Recover materials and lights from pictures of one view under different lights."""

    RETURN_TYPES = ("IMAGE",) * 5 + (RESULT,)
    RETURN_NAMES = ("albedo", "roughness", "metallic", "normal", "height", "result")

    @classmethod
    def INPUT_TYPES(cls) -> Inputs:  # noqa: N802 - ComfyUI's names, here and below
        """Pictures, and what is known of the view."""
        return {
            "required": {
                "images": ("IMAGE", {"tooltip": "two or more pictures of one view, in one batch"}),
                "encoding": _choice("sRGB", "linear", said="of the pictures"),
                "fov": _number(60.0, 0.0, 179.0, "horizontal, in degrees; 0 = orthographic"),
                "fov_known": ("BOOLEAN", {"default": False, "tooltip": "else it is fitted"}),
                "light": _choice("auto", "sh", "lamps", said="sh: all around; lamps: one each"),
                "model": _choice("paper", "principled", said="of reflection; or Blender's"),
            },
            "optional": {
                "normals": ("IMAGE", {"tooltip": "needed but for three pictures under lamps"}),
                "normal_axes": _choice("opengl", "directx", said="Y up, or down"),
                "depth": ("IMAGE", {"tooltip": "grey; needs normals"}),
                "depth_kind": _choice(
                    *("inverse relative", "relative", "distance"),
                    said="inverse relative: as Depth Anything gives it, near is bright; relative: "
                    "as Marigold; distance: along the camera's axis",
                ),
                "mask": ("MASK", {"tooltip": "use pixels of 0.5 and more"}),
            },
        }

    def run(
        self,
        images: Any,
        encoding: str,
        fov: float,
        fov_known: bool,
        light: str,
        model: str,
        normals: Any = None,
        normal_axes: str = "opengl",
        depth: Any = None,
        depth_kind: str = "inverse relative",
        mask: Any = None,
    ) -> tuple[Any, ...]:
        """Fit, and give maps of batches of one. Raises InputError as `pbrfit.decompose` does."""
        pictures = _array(images)[..., :3]
        given: Any = None
        distances, used = None, None
        if encoding == "sRGB":
            pictures = decode_srgb(pictures)
        if normals is not None:
            codes = 2 * _array(normals)[0, ..., :3] - 1
            length = np.linalg.norm(codes, axis=-1, keepdims=True)
            given = Convention(normal_axes).to_camera(codes / np.maximum(length, 1e-6))
        if depth is not None:
            if given is None:
                raise InputError("depth: expected normals beside it, found none")
            distances = _array(depth)[0, ..., :3].mean(axis=-1)
            distances = any_array("depth", distances, given.shape[:2])
            if depth_kind != "distance":
                inverse = depth_kind == "inverse relative"
                distances, _ = with_offset(distances, given, fov, disparity=inverse)
        if mask is not None:
            masks = _array(mask)
            used = (masks if masks.ndim == 2 else masks[0]) >= 0.5
        scene = Scene(
            images=pictures.astype(np.float32),
            normals=given,
            depth=distances,
            mask=used,
            fov=fov,
            fov_known=fov_known,
        )
        result = decompose(scene, light=light, model=model)
        inside = nearest_inside(result.mask)
        maps = result.materials
        relief, height = Displacement.of(result), np.zeros(result.mask.shape)
        if relief is not None:
            height = (relief.height - relief.low) / (relief.high - relief.low)
        return (
            _image(encode_srgb(maps.albedo[inside])),
            _image(maps.roughness[inside]),
            _image(maps.metallic[inside]),
            _image((result.normals[inside] + 1) / 2),
            _image(height),
            result,
        )


class RelightLamp(_Node):
    """Show a result under a lamp far away."""

    @classmethod
    def INPUT_TYPES(cls) -> Inputs:  # noqa: N802
        """Where the lamp is, and how bright."""
        return {
            "required": {
                "result": (RESULT,),
                "azimuth": _number(45.0, -180.0, 180.0, "degrees; 0 = from the viewer, 90 = right"),
                "elevation": _number(30.0, -90.0, 90.0, "degrees above the horizon"),
                "softness": _number(0.0, 0.0, 45.0, "angular radius in degrees; the sun's is 0.27"),
                "exposure": EXPOSURE,
            }
        }

    def run(
        self, result: Result, azimuth: float, elevation: float, softness: float, exposure: float
    ) -> tuple[Any]:
        """At exposure 0 a white matt surface that faces the lamp is white."""
        lamp = DirectionalLight(azimuth, elevation, softness=softness)
        return (_image(encoded(relight(result, lamp), exposure)),)


class RelightPanorama(_Node):
    """Show a result under a panorama."""

    @classmethod
    def INPUT_TYPES(cls) -> Inputs:  # noqa: N802
        """A file, and how it is turned."""
        return {
            "required": {
                "result": (RESULT,),
                "panorama": ("STRING", {"default": "", "tooltip": "file: .hdr or .exr, 2 : 1"}),
                "rotation": _number(0.0, -360.0, 360.0, "degrees, from the viewer to the right"),
                "exposure": EXPOSURE,
            }
        }

    def run(self, result: Result, panorama: str, rotation: float, exposure: float) -> tuple[Any]:
        """Raises InputError or OSError if the file is no panorama or cannot be read."""
        light = Environment.read(_in_folder("input", panorama), rotation)
        return (_image(encoded(relight(result, light), exposure)),)


class SaveEXR(_Node):
    """Write all maps of a result into one EXR file of float32 layers, in the output folder."""

    OUTPUT_NODE = True
    RETURN_TYPES = ("STRING",)
    RETURN_NAMES = ("file",)

    @classmethod
    def INPUT_TYPES(cls) -> Inputs:  # noqa: N802
        """A result, and how the file's name begins."""
        prefix = ("STRING", {"default": "pbrfit"})
        return {"required": {"result": (RESULT,), "filename_prefix": prefix}}

    def run(self, result: Result, filename_prefix: str) -> dict[str, Any]:
        """Layers are those of `materials.exr` (docs/formats.md); no file is replaced."""
        import folder_paths

        folder, name, number, *_ = folder_paths.get_save_image_path(
            filename_prefix, folder_paths.get_output_directory()
        )
        path = Path(folder) / f"{name}_{number:05}_.exr"
        layers = result.further_layers(), result.whole_layers()
        with new_file(path) as temporary:
            write_materials(temporary, result.materials, result.normals, result.mask, *layers)
        return {"ui": {"text": [str(path)]}, "result": (str(path),)}


class LoadEXR(_Node):
    """Read a layer of an EXR file as an image."""

    @classmethod
    def INPUT_TYPES(cls) -> Inputs:  # noqa: N802
        """A file, and which of its layers."""
        said = "sRGB: encode colours; linear: as it is; normal: from -1 to 1"
        return {
            "required": {
                "file": ("STRING", {"default": "", "tooltip": "path, or within the output folder"}),
                "layer": ("STRING", {"default": "albedo"}),
                "encoding": _choice("sRGB", "linear", "normal", said=said),
            }
        }

    @classmethod
    def IS_CHANGED(cls, file: str, layer: str, encoding: str) -> float:  # noqa: ARG003, N802
        """When the file was last written."""
        path = _in_folder("output", file)
        return path.stat().st_mtime if path.is_file() else 0.0

    def run(self, file: str, layer: str, encoding: str) -> tuple[Any]:
        """Raises InputError or OSError if there is no such layer of one or three channels."""
        path = _in_folder("output", file)
        channels = read_channels(path)
        names = [f"{layer}.{letter}" for letter in "RGBXYZ" if f"{layer}.{letter}" in channels]
        names = names or [name for name in channels if name == layer]
        if len(names) not in (1, 3):
            found = listed(sorted({name.rpartition(".")[0] or name for name in channels}))
            expected = f"expected a layer {layer!r} of one or three channels"
            raise InputError(f"{path}: {expected}, found {found}")
        values = np.stack([channels[name] for name in names], axis=-1).astype(np.float64)
        if encoding == "sRGB":
            values = encode_srgb(np.clip(values, 0, 1))
        return (_image((values + 1) / 2 if encoding == "normal" else values),)


NODE_CLASS_MAPPINGS = {
    "PbrfitDecompose": Decompose,
    "PbrfitRelightLamp": RelightLamp,
    "PbrfitRelightPanorama": RelightPanorama,
    "PbrfitSaveEXR": SaveEXR,
    "PbrfitLoadEXR": LoadEXR,
}
NODE_DISPLAY_NAME_MAPPINGS = {
    "PbrfitDecompose": "Decompose into materials and lights",
    "PbrfitRelightLamp": "Relight with a lamp",
    "PbrfitRelightPanorama": "Relight with a panorama",
    "PbrfitSaveEXR": "Save materials as EXR",
    "PbrfitLoadEXR": "Load a layer of an EXR",
}


def _array(tensor: Any) -> Array:
    return np.asarray(tensor.cpu(), np.float64)


def _image(values: Array) -> Any:
    """A batch of one, (1, H, W, 3), of (H, W), (H, W, 1) or (H, W, 3); black where unknown."""
    import torch

    planes = values.reshape(*values.shape[:2], -1)
    pixels = np.broadcast_to(np.nan_to_num(planes), (*values.shape[:2], 3))
    return torch.from_numpy(pixels[None].astype(np.float32))


def _in_folder(kind: str, file: str) -> Path:
    """A path as it is, or within ComfyUI's folder for input or output."""
    import folder_paths

    return Path(getattr(folder_paths, f"get_{kind}_directory")()) / file
