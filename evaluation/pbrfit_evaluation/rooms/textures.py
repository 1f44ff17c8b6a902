"""Sets of texture maps: found in a folder, read, and averaged for every distance.

A set is the maps of one material. Their roles are known by the ends of their names, which may
begin with the name of the set or be the whole name (then the folder names the set):

    albedo, base_color, basecolor, color, col, diffuse, diff      sRGB unless the file says else
    roughness, rough                                              stored values
    metallic, metalness, metal                                    stored values; absent: 0
    orm, arm, occlusionroughmetal, roughnessmetallic, ...         G roughness, B metallic
    normal, nor, nrm, each also with gl or dx                     2v - 1; absent: smooth

A resolution such as 1k may follow. Normals have Y up in the picture (OpenGL) unless the name says
dx. Maps of the name X_shared belong to every set whose name begins with X. Other pictures are left
alone.

**On primitives.** Planes and the sides of boxes are mapped flat, the sides of cylinders and frusta
are unrolled, and spheres have longitude and latitude. A whole number of tiles goes round what is
round, so that nothing shows where they close.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io import images
from pbrfit.io.resampling import averaged_channels
from pbrfit.synthetic.geometry import Cylinder, Primitive, Sphere
from pbrfit_evaluation.arrays import Array
from pbrfit_evaluation.rooms.parts import Frustum


@dataclass(frozen=True)
class Chart:
    """Coordinates at P points."""

    u: Array
    v: Array
    """`u` and `v`: (P,) in tiles."""
    right: Array
    up: Array
    """`right` and `up`: (P, 3) unit vectors in object space along which u and v grow; with the
    normal they are orthogonal and right-handed."""
    squeeze: Array
    """(P,) how many times smaller a tile is there than its nominal size."""


def chart(primitive: Primitive, points: Array, normals: Array, tile: float) -> Chart:
    """Map tiles of `tile` metres onto a primitive; points and normals (P, 3) in object space."""
    flat = _flat(points, normals, tile)
    match primitive:
        case Sphere(radius=radius):
            latitude = np.arctan2(points[:, 1], np.hypot(points[:, 0], points[:, 2]))
            return _round(points, normals, tile, radius, radius * latitude)
        case Cylinder(radius=radius):
            side = _round(points, normals, tile, radius, points[:, 1])
        case Frustum(bottom=bottom, top=top):
            # The sides' normal has the cosine of their slope as its length in the xz plane.
            cosine = np.maximum(np.hypot(normals[:, 0], normals[:, 2]), 1e-6)
            side = _round(points, normals, tile, max(bottom, top), points[:, 1] / cosine)
        case _:
            return flat
    cap = np.abs(normals[:, 1]) == 1.0
    return Chart(
        u=np.where(cap, flat.u, side.u),
        v=np.where(cap, flat.v, side.v),
        right=np.where(cap[:, None], flat.right, side.right),
        up=np.where(cap[:, None], flat.up, side.up),
        squeeze=np.where(cap, 1.0, side.squeeze),
    )


def _flat(points: Array, normals: Array, tile: float) -> Chart:
    """Map along the object's axes, for the axis that the normal is closest to."""
    axis = np.argmax(np.abs(normals), axis=-1)
    sign = np.sign(np.take_along_axis(normals, axis[:, None], axis=-1))[:, 0]
    right = np.zeros_like(points)
    right[:, 0] = np.where(axis == 2, sign, np.where(axis == 1, 1.0, 0.0))
    right[:, 2] = np.where(axis == 0, -sign, 0.0)
    up = np.cross(normals, right)
    return Chart(
        u=np.einsum("pi,pi->p", points, right) / tile,
        v=np.einsum("pi,pi->p", points, up) / tile,
        right=right,
        up=up,
        squeeze=np.ones(len(points)),
    )


def _round(points: Array, normals: Array, tile: float, radius: float, height: Array) -> Chart:
    """Unroll about the y axis: u is the azimuth from +z towards +x, v the height along the side."""
    x, _, z = points.T
    distance = np.maximum(np.hypot(x, z), 1e-12)
    right = np.stack([z / distance, np.zeros_like(x), -x / distance], axis=-1)
    repeats = max(1, round(2 * np.pi * radius / tile))
    natural = repeats * tile / (2 * np.pi)  # the radius at which a tile has its nominal width
    return Chart(
        u=np.arctan2(x, z) / (2 * np.pi) * repeats,
        v=height / tile,
        right=right,
        up=np.cross(normals, right),
        squeeze=np.clip(natural / distance, 1.0, 1e3),
    )


Maps = NDArray[np.float32]

_ROLES = {
    "albedo": r"albedo|base_?colou?r|colou?r|col|diffuse|diff",
    "packed": r"orm|arm|(?:occlusion|ao)?rough(?:ness)?metal(?:lic|ness)?"
    r"|metal(?:lic|ness)?rough(?:ness)?|metallic_roughness|roughness_metallic",
    "roughness": r"roughness|rough",
    "metallic": r"metallic|metalness|metal",
    "normal": r"normal|nor|nrm",
}
_NAME = {
    role: re.compile(
        rf"^(?:(?P<name>.*?)[_\-. ])?(?:{words})"
        r"(?P<kind>[_\-. ]?(?:gl|dx|opengl|directx))?(?:[_\-. ]\d+k)?$",
        re.IGNORECASE,
    )
    for role, words in _ROLES.items()
}
_PICTURES = {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr", ".hdr"}
_FINEST = 512  # texels along the side of the finest maps kept
_CHANNELS = 8  # albedo (3), roughness, metallic, normal (3)


@dataclass(frozen=True)
class MaterialSet:
    """The maps of one material, square, each level half the size of the one before."""

    name: str
    """Folder or file name that the maps share."""
    levels: tuple[Maps, ...]
    """(T, T, 8) float32 each, T a power of two down to 1: albedo in linear Rec.709, roughness,
    metallic, and the mean normal in tangent space, not of unit length (x right, y up in the
    picture). Row 0 is the top. A texel is the mean of the four finer ones that it covers."""
    relief: bool
    """Whether there is a normal map."""

    @property
    def repeats(self) -> bool:
        """Whether the maps may cover a wall: no seam to speak of, and even brightness.

        The step of the albedo across a border is at most 3 times the steps inside, and the
        standard deviation of the brightness over 4 x 4 fields at most a quarter of its mean.
        """
        maps = self.levels[max(0, len(self.levels) - 8)][..., :3]  # 128 x 128 or less
        for axis in (0, 1):
            steps = np.abs(np.diff(maps, axis=axis)).mean()
            border = np.abs(maps.take(0, axis) - maps.take(-1, axis)).mean()
            if border > 3 * steps + 1e-3:
                return False
        fields = self.levels[max(0, len(self.levels) - 3)][..., :3].mean(axis=-1)
        return bool(fields.std() <= 0.25 * fields.mean())

    @property
    def mean(self) -> Array:
        """(8,) mean of all maps."""
        return np.asarray(self.levels[-1][0, 0], dtype=np.float64)

    @property
    def metallic(self) -> float:
        """Mean metallic."""
        return float(self.mean[4])

    def sample(self, u: Array, v: Array, texels: Array) -> Array:
        """(P, 8): the maps, averaged over what a pixel covers; they repeat.

        At coordinates (P,), 1 = the whole map, u to the right and v up, of pixels that are so many
        of the finest texels (P,) wide. Linear between texels and between levels.
        """
        level = np.log2(np.maximum(texels, 1.0)).clip(0.0, len(self.levels) - 1)
        lower = np.minimum(level.astype(np.int64), max(len(self.levels) - 2, 0))
        found = np.zeros((len(u), _CHANNELS))
        for i, maps in enumerate(self.levels):
            for here, weight in (
                (np.flatnonzero(lower == i), 1 - (level - lower)),
                (np.flatnonzero(lower == i - 1), level - lower),
            ):
                if len(here):
                    found[here] += weight[here, None] * _bilinear(maps, u[here], v[here])
        return found


def _bilinear(maps: Maps, u: Array, v: Array) -> Array:
    side = len(maps)
    x, y = (u - np.floor(u)) * side - 0.5, (np.ceil(v) - v) * side - 0.5  # row 0 is the top
    i, j = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    a, b = (x - i)[:, None], (y - j)[:, None]
    i, j, right, below = i % side, j % side, (i + 1) % side, (j + 1) % side
    top = (1 - a) * maps[j, i] + a * maps[j, right]
    bottom = (1 - a) * maps[below, i] + a * maps[below, right]
    return np.asarray((1 - b) * top + b * bottom)


def load_textures(folder: Path) -> tuple[MaterialSet, ...]:
    """Read all sets of texture maps in a folder and the folders below it, in order of their paths.

    See the module for the names that are known.

    Raises InputError when there is no folder or no set in it, when a set lacks its albedo or its
    roughness, has two maps of one role, or a map cannot be read.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: expected a folder of texture maps, found none")
    found: dict[tuple[Path, str], dict[str, Path]] = {}
    for path in sorted(folder.rglob("*")):
        role, name = _role(path)
        if not role:
            continue
        maps = found.setdefault((path.parent, name), {})
        if role in maps:
            raise InputError(f"{path}: expected one {role} map of a set, found a second")
        maps[role] = path
    for (parent, name), shared in list(found.items()):
        if name.endswith("_shared"):
            del found[parent, name]
            for (other, member), maps in found.items():
                if other == parent and member.startswith(name.removesuffix("shared")):
                    maps.update(shared | maps)
    # A lone normal map belongs to something else than a material.
    sets = [
        _load_set(name or parent.name, parent, maps)
        for (parent, name), maps in found.items()
        if set(maps) != {"normal"}
    ]
    if not sets:
        raise InputError(
            f"{folder}: expected texture maps such as NAME_albedo.png and NAME_roughness.png, "
            "found none"
        )
    return tuple(sets)


def _role(path: Path) -> tuple[str, str]:
    """Role and name of the set, both empty for a file that is no texture map."""
    if path.suffix.lower() in _PICTURES:
        for role, pattern in _NAME.items():
            if match := pattern.match(path.stem):
                return role, match["name"] or ""
    return "", ""


def _load_set(name: str, parent: Path, paths: dict[str, Path]) -> MaterialSet:
    if "albedo" not in paths:
        raise InputError(f"{parent}: expected an albedo or base colour map of {name}, found none")
    if "roughness" not in paths and "packed" not in paths:
        raise InputError(f"{parent}: expected a roughness map of {name}, found none")
    # In the order of the channels; one texel where there is no map.
    absent = {"albedo": [0, 0, 0], "roughness": [0], "metallic": [0], "normal": [0, 0, 1]}
    layers = {role: np.array([[texel]], dtype=np.float32) for role, texel in absent.items()}
    if "packed" in paths:
        packed = _read(paths["packed"], "occlusion, roughness and metallic", 3)
        layers |= {"roughness": packed[..., 1:2], "metallic": packed[..., 2:]}
    layers["albedo"] = _reduced(images.read_picture(paths["albedo"]).pixels)
    for role in ("roughness", "metallic"):
        if role in paths:
            layers[role] = _read(paths[role], role, 1)
    if "normal" in paths:
        vectors = 2 * _read(paths["normal"], "normals", 3) - 1
        vectors[..., 2] = np.maximum(vectors[..., 2], 0.05)  # a surface that faces outwards
        match = _NAME["normal"].match(paths["normal"].stem)
        if match and (match["kind"] or "").lower().endswith(("dx", "directx")):
            vectors[..., 1] *= -1
        layers["normal"] = vectors
    largest = max(max(layer.shape[:2]) for layer in layers.values())
    side = min(_FINEST, 2 ** int(np.log2(largest)))
    resized = [averaged_channels(layer, (side, side)) for layer in layers.values()]
    levels = [np.concatenate(resized, axis=-1).astype(np.float32)]
    while len(levels[-1]) > 1:
        levels.append(averaged_channels(levels[-1], (len(levels[-1]) // 2,) * 2).astype(np.float32))
    return MaterialSet(name=name, levels=tuple(levels), relief="normal" in paths)


def _read(path: Path, what: str, channels: int) -> Maps:
    """(H, W, channels) of a map of data, not much finer than needed."""
    stored = images.read_data(path)
    if stored.shape[2] < channels:
        raise InputError(f"{path}: expected {what} in {channels} channels, found {stored.shape[2]}")
    return _reduced(stored[..., :channels])


def _reduced(layer: NDArray[Any]) -> Maps:
    """Average blocks of a large map, as long as it stays finer than the finest level."""
    factor = max(1, min(layer.shape[:2]) // _FINEST)
    height, width = (side // factor for side in layer.shape[:2])
    whole = layer[: height * factor, : width * factor]  # less what is left over at the far edges
    return averaged_channels(whole, (height, width)).astype(np.float32)
