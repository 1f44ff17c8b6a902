"""A result as a MaterialX document that reads the PNG files beside it.

Specification: https://materialx.org/Specification.html, version 1.38, the first with `gltf_pbr`.

`material.mtlx` of this room has the maps once, as a node graph, and two materials that take them,
because tools know one or the other surface shader: `standard_surface` (Arnold, Houdini, Maya) and
`gltf_pbr`. Texture coordinates are the card's, its normal, tangent and bitangent the axes of the
camera. It is that of a result with a mask and normal maps that point downwards.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from importlib.resources import files

from pbrfit.export.presets import Preset

HOLDS = "MaterialX: standard_surface and gltf_pbr with the maps of png/"

OF_MASK = ["opacity_file", "opacity_color", "opacity_out", "opacity_color_out", "opacity"]
OF_MASK += ["alpha", "alpha_mode"]
"""Names of the elements that are about a mask."""

OF_DOWNWARD_NORMALS = ["scale"]
"""Names of the elements that turn the green of normal maps upwards."""


def mtlx(planned: Preset) -> str:
    """The document of an export that writes the textures of no preset as PNG."""
    text = files(__package__).joinpath("material.mtlx").read_text("utf-8")
    document = ET.fromstring(text.replace("normal_directx", f"normal_{planned.normals}"))
    left_out = [] if planned.normals == "directx" else OF_DOWNWARD_NORMALS
    if all(texture.name != "mask" for texture in planned.textures):
        left_out = [*left_out, *OF_MASK]
    for element in [*document.iter()]:
        for part in [*element]:
            if part.get("name") in left_out:
                element.remove(part)
    ET.indent(document)
    return f'<?xml version="1.0"?>\n{ET.tostring(document, encoding="unicode")}\n'
