"""A strict reader of .glb files, by the letter of the glTF 2.0 specification."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

COMPONENTS: dict[int, np.dtype[Any]] = {
    5123: np.dtype("<u2"),
    5125: np.dtype("<u4"),
    5126: np.dtype("<f4"),
}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
VERTICES, INDICES = 34962, 34963


@dataclass(frozen=True)
class Glb:
    """A file that has passed: its JSON and binary chunk, arrays by accessor, images by name."""

    document: dict[str, Any]
    binary: bytes
    arrays: list[NDArray[Any]]
    images: dict[str, bytes]


def read(content: bytes) -> Glb:
    """Read and check; AssertionError where the specification is not met."""
    assert struct.unpack_from("<4sII", content) == (b"glTF", 2, len(content))
    chunks, at = [], 12
    while at < len(content):
        length, kind = struct.unpack_from("<I4s", content, at)
        assert length % 4 == 0, "chunks end on a multiple of 4 bytes"
        chunks.append((kind, content[at + 8 : at + 8 + length]))
        assert len(chunks[-1][1]) == length
        at += 8 + length
    (first, text), (second, binary) = chunks
    assert (first, second) == (b"JSON", b"BIN\0")
    document = json.loads(text.decode("utf-8"), parse_constant=_refuse)
    assert text.rstrip(b" ").endswith(b"}"), "JSON is padded with spaces"
    assert not text.startswith(b"\xef\xbb\xbf")
    assert document["asset"]["version"] == "2.0"
    _check_buffers(document, binary)
    arrays = [_array(document, binary, accessor) for accessor in document["accessors"]]
    _check_references(document)
    for mesh in document["meshes"]:
        for primitive in mesh["primitives"]:
            _check_primitive(document, primitive, arrays)
    for camera in document["cameras"]:
        _check_camera(camera)
    images = {}
    for image in document["images"]:
        assert image["mimeType"] == "image/png"
        view = document["bufferViews"][image["bufferView"]]
        assert "target" not in view
        images[image["name"]] = _bytes(binary, view)
        assert images[image["name"]].startswith(b"\x89PNG\r\n\x1a\n")
    return Glb(document, binary, arrays, images)


def _refuse(constant: str) -> None:
    raise AssertionError(f"{constant} is no JSON")


def _check_buffers(document: dict[str, Any], binary: bytes) -> None:
    [buffer] = document["buffers"]
    assert "uri" not in buffer
    assert 0 <= len(binary) - buffer["byteLength"] <= 3
    assert not any(binary[buffer["byteLength"] :]), "the buffer is padded with zeros"
    end = 0
    for view in document["bufferViews"]:
        assert view["buffer"] == 0
        assert view["byteLength"] > 0
        assert end <= view["byteOffset"] < end + 4, "views lie one after the other"
        end = view["byteOffset"] + view["byteLength"]
        assert end <= buffer["byteLength"]


def _bytes(binary: bytes, view: dict[str, Any]) -> bytes:
    return binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]


def _array(document: dict[str, Any], binary: bytes, accessor: dict[str, Any]) -> NDArray[Any]:
    component = COMPONENTS[accessor["componentType"]]
    view = document["bufferViews"][accessor["bufferView"]]
    assert "byteStride" not in view, "an array a view"
    assert accessor.get("byteOffset", 0) == 0
    assert view["byteOffset"] % component.itemsize == 0
    width = WIDTHS[accessor["type"]]
    assert view["byteLength"] == accessor["count"] * width * component.itemsize
    values: NDArray[Any] = np.frombuffer(_bytes(binary, view), component).reshape(-1, width)
    assert np.isfinite(values).all()
    for name, of in (("min", values.min(axis=0)), ("max", values.max(axis=0))):
        assert accessor[name] == of.tolist(), f"{name} is exact"
    return values


def _check_references(document: dict[str, Any]) -> None:
    """Indices are in range, and nothing is left that nobody refers to."""
    used: dict[str, set[int]] = {
        "scenes": {document["scene"]},
        "nodes": {i for scene in document["scenes"] for i in scene["nodes"]},
        "meshes": {node["mesh"] for node in document["nodes"] if "mesh" in node},
        "cameras": {node["camera"] for node in document["nodes"] if "camera" in node},
        "images": {texture["source"] for texture in document["textures"]},
        "samplers": {texture["sampler"] for texture in document["textures"]},
        "bufferViews": {
            of["bufferView"] for kind in ("accessors", "images") for of in document[kind]
        },
    }
    primitives = [p for mesh in document["meshes"] for p in mesh["primitives"]]
    used["materials"] = {p["material"] for p in primitives}
    used["accessors"] = {i for p in primitives for i in (*p["attributes"].values(), p["indices"])}
    used["textures"] = {
        of["index"]
        for material in document["materials"]
        for of in (
            material.get("normalTexture"),
            material["pbrMetallicRoughness"]["baseColorTexture"],
            material["pbrMetallicRoughness"]["metallicRoughnessTexture"],
        )
        if of is not None
    }
    for kind, indices in used.items():
        assert indices == set(range(len(document[kind]))), kind


def _check_primitive(
    document: dict[str, Any], primitive: dict[str, Any], arrays: list[NDArray[Any]]
) -> None:
    attributes = primitive["attributes"]
    kinds = {"POSITION": "VEC3", "NORMAL": "VEC3", "TANGENT": "VEC4", "TEXCOORD_0": "VEC2"}
    optional = set() if "normalTexture" in document["materials"][0] else {"TANGENT"}
    assert set(kinds) - optional <= set(attributes) <= set(kinds)
    for name, index in attributes.items():
        accessor = document["accessors"][index]
        assert (accessor["type"], accessor["componentType"]) == (kinds[name], 5126)
        assert document["bufferViews"][accessor["bufferView"]]["target"] == VERTICES
        assert len(arrays[index]) == len(arrays[attributes["POSITION"]])
    for name in {"NORMAL", "TANGENT"} & set(attributes):
        vectors = arrays[attributes[name]][:, :3]
        np.testing.assert_allclose(np.linalg.norm(vectors, axis=-1), 1, rtol=1e-6)
    if "TANGENT" in attributes:
        assert set(np.abs(arrays[attributes["TANGENT"]][:, 3])) == {1.0}
    accessor = document["accessors"][primitive["indices"]]
    assert accessor["type"] == "SCALAR"
    assert accessor["componentType"] in (5123, 5125)
    if accessor["componentType"] == 5123:
        assert accessor["max"][0] < 65535, "65535 restarts primitives"
    assert document["bufferViews"][accessor["bufferView"]]["target"] == INDICES
    indices = arrays[primitive["indices"]]
    assert len(indices) % 3 == 0
    assert indices.max() < len(arrays[attributes["POSITION"]])


def _check_camera(camera: dict[str, Any]) -> None:
    of = camera[camera["type"]]
    assert {"perspective", "orthographic"} & set(camera) == {camera["type"]}
    if camera["type"] == "perspective":
        assert 0 < of["yfov"] < np.pi
        assert of["aspectRatio"] > 0
        assert 0 < of["znear"] < of["zfar"]
    else:
        assert of["xmag"] > 0
        assert of["ymag"] > 0
        assert 0 <= of["znear"] < of["zfar"]
