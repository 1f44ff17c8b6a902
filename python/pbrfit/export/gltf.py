"""A result as a binary glTF 2.0 file: a picture-shaped plane and the camera that sees it.

The plane is 1 wide and H/W high, in z = 0, and faces +Z; +X is the right of the picture. So its
tangent space is camera space, and the normals go into the normal texture as they are. With the
camera at distance d on the Z axis, the point that pixel (i, j) shows is seen along

    −v ∝ ( (2j + 1 − W)/(2W),  (H − 1 − 2i)/(2W),  −d )

which is what `geometry.view_directions` has, times 1/(2 tan(fov/2)), if

    d = 1 / (2 tan(fov/2)),      yfov = 2 atan(tan(fov/2) · H/W).

A field of view of 0 becomes an orthographic camera.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

import json
import math
import struct
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit import images
from pbrfit.export.maps import BASE_COLOR, NORMAL, Bits, Maps, Texture

_FLOAT, _UNSIGNED_SHORT = 5126, 5123
_ARRAY_BUFFER, _ELEMENT_ARRAY_BUFFER = 34962, 34963
_LINEAR, _LINEAR_MIPMAP_LINEAR, _CLAMP_TO_EDGE = 9729, 9987, 33071

_METALLIC_ROUGHNESS = Texture("metallic_roughness", ("unused", "roughness", "metallic"), bits=8)
_NORMAL = Texture("normal", NORMAL, bits=16)
"""16 bits, because 8 have no code for 0: the flat normal (128, 128, 255) leans by 0.3 degrees."""


def glb(maps: Maps, fov: float, bits: Bits | None = None) -> bytes:
    """Encode a result as a `.glb` file.

    Parameters
    ----------
    maps
        Of the result.
    fov
        Horizontal, degrees, 0 = orthographic.
    bits
        Of all textures; None: normals 16, the others 8.
    """
    height, width = maps.mask.shape
    masked = not maps.mask.all()
    base_color = Texture("base_color", (*BASE_COLOR, *(["mask"] if masked else [])), True, 8)
    buffer = _Buffer()
    textures = (base_color, _METALLIC_ROUGHNESS, _NORMAL)
    attributes, indices = _plane(buffer, height / width)
    # Untagged: what a texture is used for says how it is encoded, and what PNG chunks say is to be
    # ignored (specification, 3.8.3).
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
    material: dict[str, Any] = {
        "name": "pbrfit",
        "pbrMetallicRoughness": {
            "baseColorTexture": {"index": 0},
            "metallicRoughnessTexture": {"index": 1},
        },
        "normalTexture": {"index": 2},
    }
    if masked:
        material |= {"alphaMode": "MASK", "alphaCutoff": 0.5}
    camera, distance = _camera(height, width, fov)
    document = {
        "asset": {
            "version": "2.0",
            "generator": f"pbrfit {version('pbrfit')}",
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
        "cameras": [camera],
        "meshes": [
            {
                "name": "view card",
                "primitives": [{"attributes": attributes, "indices": indices, "material": 0}],
            }
        ],
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
    text = json.dumps(document, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return _container(text.encode(), bytes(buffer.content))


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


def _plane(buffer: _Buffer, aspect: float) -> tuple[dict[str, int], int]:
    """Two triangles, counter-clockwise as seen from +Z. v of the texture grows downwards."""
    corners = np.array([[0, 1], [1, 1], [1, 0], [0, 0]])  # u, v; from the lower left
    position = np.zeros((4, 3))
    position[:, 0] = corners[:, 0] - 0.5
    position[:, 1] = (0.5 - corners[:, 1]) * aspect
    normal = np.tile([0, 0, 1], (4, 1))
    # X, and bitangent = cross(normal, tangent) · 1 = Y: up, as normal maps have it in glTF.
    tangent = np.tile([1, 0, 0, 1], (4, 1))
    attributes = {
        name: buffer.accessor(values.astype("<f4"), f"VEC{values.shape[1]}", _FLOAT, _ARRAY_BUFFER)
        for name, values in (
            ("POSITION", position),
            ("NORMAL", normal),
            ("TANGENT", tangent),
            ("TEXCOORD_0", corners),
        )
    }
    triangles = np.array([[0], [1], [2], [0], [2], [3]], dtype="<u2")
    indices = buffer.accessor(triangles, "SCALAR", _UNSIGNED_SHORT, _ELEMENT_ARRAY_BUFFER)
    return attributes, indices


def _camera(height: int, width: int, fov: float) -> tuple[dict[str, Any], float]:
    """The camera, and its distance from the plane."""
    if fov == 0:
        distance = 1.0
        orthographic = {"xmag": 0.5, "ymag": 0.5 * height / width, "znear": 0.01, "zfar": 100.0}
        return {"name": "view", "type": "orthographic", "orthographic": orthographic}, distance
    half_width = math.tan(math.radians(fov) / 2)
    distance = 0.5 / half_width
    perspective = {
        "aspectRatio": width / height,
        "yfov": 2 * math.atan(half_width * height / width),
        "znear": 0.01 * distance,
        "zfar": 100 * distance,
    }
    return {"name": "view", "type": "perspective", "perspective": perspective}, distance


def _container(text: bytes, binary: bytes) -> bytes:
    """Header and two chunks: JSON padded with spaces, the buffer with zeros."""
    text += b" " * (-len(text) % 4)
    chunks = b"".join(
        struct.pack("<I4s", len(content), kind) + content
        for kind, content in ((b"JSON", text), (b"BIN\0", binary))
    )
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
