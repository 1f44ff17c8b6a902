"""A result as a binary glTF 2.0 file.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

import json
import struct
from typing import Any

from numpy.typing import NDArray

from pbrfit.export.maps import BASE_COLOR, NORMAL, Bits, Maps, Texture
from pbrfit.export.view_mesh import Geometry, ViewMesh, camera, card, facets
from pbrfit.io import images

_FLOAT, _UNSIGNED_SHORT, _UNSIGNED_INT = 5126, 5123, 5125
_ARRAY_BUFFER, _ELEMENT_ARRAY_BUFFER = 34962, 34963
_LINEAR, _LINEAR_MIPMAP_LINEAR, _CLAMP_TO_EDGE = 9729, 9987, 33071

_METALLIC_ROUGHNESS = Texture("metallic_roughness", ("unused", "roughness", "metallic"), bits=8)
_NORMAL = Texture("normal", NORMAL, bits=16)
"""16 bits, because 8 have no code for 0: the flat normal (128, 128, 255) leans by 0.3 degrees."""


def glb(maps: Maps, fov: float, bits: Bits | None = None, geometry: Geometry = "card") -> bytes:
    """Encode the maps of a result as a `.glb` file; `fov` horizontal, degrees, 0 = orthographic.

    `bits` are of all textures; None: normals 16, the others 8. The geometry "card" is a rectangle;
    the normals are a texture, and pixels outside the mask cut out by alpha. "facets": a rectangle
    for each pixel inside the mask, turned to its normal.
    """
    from pbrfit import __version__

    height, width = maps.mask.shape
    cut = geometry == "card" and not maps.mask.all()
    base_color = Texture("base_color", (*BASE_COLOR, *(["mask"] if cut else [])), True, 8)
    textures = [base_color, _METALLIC_ROUGHNESS]
    material: dict[str, Any] = {
        "name": "pbrfit",
        "pbrMetallicRoughness": {
            "baseColorTexture": {"index": 0},
            "metallicRoughnessTexture": {"index": 1},
        },
    }
    if cut:
        material |= {"alphaMode": "MASK", "alphaCutoff": 0.5}
    if geometry == "card":
        textures.append(_NORMAL)
        material["normalTexture"] = {"index": 2}
        mesh = card(height, width)
    else:
        mesh = facets(maps.normals, maps.mask, fov)
    buffer = _Buffer()
    primitive = _primitive(buffer, mesh)
    # Untagged: use tells encoding, and PNG chunks are ignored (specification, 3.8.3).
    pictures = [
        {
            "name": texture.name,
            "mimeType": "image/png",
            "bufferView": buffer.view(
                images.encode_png(maps.integers(texture, bits or texture.bits), tag=None)
            ),
        }
        for texture in textures
    ]
    view, distance = camera(height, width, fov)
    document = {
        "asset": {
            "version": "2.0",
            "generator": f"pbrfit {__version__}",
            "extras": {
                "color_space": "Rec.709 primaries, D65: base color sRGB-encoded, all else linear",
                "fov": fov,
                "picture": [width, height],
                "axes": "the plane's X, Y, Z are pbrfit's camera space: right, up, to the viewer",
            },
        },
        "scene": 0,
        "scenes": [{"name": "pbrfit", "nodes": [0, 1]}],
        "nodes": [
            {"name": "view card", "mesh": 0},
            {"name": "camera", "camera": 0, "translation": [0, 0, distance]},
        ],
        "cameras": [view],
        "meshes": [{"name": "view card", "primitives": [primitive]}],
        "materials": [material],
        "textures": [{"sampler": 0, "source": i} for i in range(len(textures))],
        "images": pictures,
        "samplers": [
            {
                "magFilter": _LINEAR,
                "minFilter": _LINEAR_MIPMAP_LINEAR,
                "wrapS": _CLAMP_TO_EDGE,
                "wrapT": _CLAMP_TO_EDGE,
            }
        ],
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.content)}],
    }
    json_text = json.dumps(document, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    text = json_text.encode()
    text += b" " * (-len(text) % 4)
    chunks = b"".join(
        struct.pack("<I4s", len(content), kind) + content
        for kind, content in ((b"JSON", text), (b"BIN\0", buffer.content))
    )
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


class _Buffer:
    """The binary chunk as it grows. Everything in it begins on a multiple of 4 bytes."""

    def __init__(self) -> None:
        self.content = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def view(self, content: bytes, target: int | None = None) -> int:
        """Append bytes; index of their buffer view."""
        view = {"buffer": 0, "byteOffset": len(self.content), "byteLength": len(content)}
        self.views.append(view if target is None else view | {"target": target})
        self.content += content + bytes(-len(content) % 4)
        return len(self.views) - 1

    def accessor(self, values: NDArray[Any], kind: str, component: int, target: int) -> int:
        """Append an array, (N, components); index of its accessor."""
        view = self.view(values.tobytes(), target)
        self.accessors.append(
            {
                "bufferView": view,
                "componentType": component,
                "count": len(values),
                "type": kind,
                "min": values.min(axis=0).tolist(),
                "max": values.max(axis=0).tolist(),
            }
        )
        return len(self.accessors) - 1


def _primitive(buffer: _Buffer, mesh: ViewMesh) -> dict[str, Any]:
    attributes = {
        name: buffer.accessor(values.astype("<f4"), f"VEC{values.shape[1]}", _FLOAT, _ARRAY_BUFFER)
        for name, values in mesh.attributes.items()
    }
    # The largest 16-bit index is reserved (specification, 3.7.2.1).
    short = mesh.triangles.max() < 0xFFFF
    indices = buffer.accessor(
        mesh.triangles.reshape(-1, 1).astype("<u2" if short else "<u4"),
        "SCALAR",
        _UNSIGNED_SHORT if short else _UNSIGNED_INT,
        _ELEMENT_ARRAY_BUFFER,
    )
    return {"attributes": attributes, "indices": indices, "material": 0}
