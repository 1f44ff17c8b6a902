"""A result as a MaterialX document that reads the PNG files beside it.

Specification: https://materialx.org/Specification.html

It has the maps once, as a node graph, and two materials that take them, because tools know one or
the other surface shader: `standard_surface` (Arnold, Houdini, Maya) and `gltf_pbr`. Texture
coordinates are the card's, its normal, tangent and bitangent the axes of the camera.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import Literal

from pbrfit.export.presets import Plan

HOLDS = "MaterialX: standard_surface and gltf_pbr with the maps of png/"

VERSION = "1.38"
"""Version of the specification: the first with `gltf_pbr`."""

Kind = Literal["color3", "float", "vector3"]

_MAPS: dict[str, tuple[str, Kind]] = {
    "base_color": ("base_color", "color3"),
    "roughness": ("roughness", "float"),
    "metallic": ("metallic", "float"),
    "normal_opengl": ("normal_map", "vector3"),
    "normal_directx": ("normal_map", "vector3"),
    "mask": ("opacity", "float"),
}
"""Node and type of each texture that a material reads."""


def mtlx(planned: Plan) -> str:
    """The document of an export that writes these textures as PNG."""
    document = ET.Element("materialx", version=VERSION, colorspace="lin_rec709")
    graph = ET.SubElement(document, "nodegraph", name="maps")
    outputs: list[tuple[str, str, str]] = []
    for texture in planned.textures:
        if texture.name not in _MAPS:
            continue
        name, kind = _MAPS[texture.name]
        image = ET.SubElement(graph, "image", name=f"{name}_file", type=kind)
        file = _input(image, "file", "filename", f"png/{texture.name}.png")
        if texture.color:
            file.set("colorspace", "srgb_texture")
        for axis in "uv":
            _input(image, f"{axis}addressmode", "string", "clamp")
        if name == "opacity":
            _input(image, "filtertype", "string", "closest")
        outputs.append((name, kind, f"{name}_file"))
    normal = ET.SubElement(graph, "normalmap", name="normal", type="vector3")
    ET.SubElement(normal, "input", name="in", type="vector3", nodename="normal_map_file")
    if planned.normals == "directx":
        _input(normal, "scale", "vector2", "1, -1")
    outputs = [one for one in outputs if one[0] != "normal_map"] + [("normal", "vector3", "normal")]
    masked = any(name == "opacity" for name, _, _ in outputs)
    if masked:
        convert = ET.SubElement(graph, "convert", name="opacity_color", type="color3")
        ET.SubElement(convert, "input", name="in", type="float", nodename="opacity_file")
        outputs.append(("opacity_color", "color3", "opacity_color"))
    for output, of, node in outputs:
        ET.SubElement(graph, "output", name=f"{output}_out", type=of, nodename=node)

    surface = ET.SubElement(document, "standard_surface", name="surface", type="surfaceshader")
    _input(surface, "base", "float", "1")
    gltf = ET.SubElement(document, "gltf_pbr", name="gltf_surface", type="surfaceshader")
    of_surface, of_gltf = ("metalness", "specular_roughness"), ("metallic", "roughness")
    for element, (metallic, roughness) in ((surface, of_surface), (gltf, of_gltf)):
        _connected(element, "base_color", "color3", "base_color")
        _connected(element, metallic, "float", "metallic")
        _connected(element, roughness, "float", "roughness")
        _connected(element, "normal", "vector3", "normal")
    if masked:
        _connected(surface, "opacity", "color3", "opacity_color")
        _connected(gltf, "alpha", "float", "opacity")
        _input(gltf, "alpha_mode", "integer", "1")  # cut off
    for title, shader in (("pbrfit", "surface"), ("pbrfit_gltf", "gltf_surface")):
        material = ET.SubElement(document, "surfacematerial", name=title, type="material")
        ET.SubElement(
            material, "input", name="surfaceshader", type="surfaceshader", nodename=shader
        )
    ET.indent(document)
    return f'<?xml version="1.0"?>\n{ET.tostring(document, encoding="unicode")}\n'


def _input(of: ET.Element, name: str, kind: str, value: str) -> ET.Element:
    return ET.SubElement(of, "input", name=name, type=kind, value=value)


def _connected(of: ET.Element, name: str, kind: Kind, output: str) -> None:
    ET.SubElement(of, "input", name=name, type=kind, nodegraph="maps", output=f"{output}_out")
