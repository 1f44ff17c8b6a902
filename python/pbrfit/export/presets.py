"""Which textures a tool expects: their names, channels and normal convention."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from pbrfit._core import InputError
from pbrfit.export.maps import (
    BASE_COLOR,
    BASE_COLOR_DEVIATION,
    GREEN,
    NORMAL,
    Bits,
    NormalConvention,
    Texture,
)
from pbrfit.export.view_mesh import Geometry
from pbrfit.values.checks import one_of

Format = Literal["gltf", "exr", "png", "mtlx", "lp", "ptm", "rti", "openlime"]
PresetName = Literal["blender", "unreal", "unity"]


@dataclass(frozen=True)
class Preset:
    """What a tool expects."""

    formats: tuple[Format, ...]
    """Written unless one is asked for."""
    normals: NormalConvention
    """Convention of normal maps unless one is asked for."""
    textures: tuple[Texture, ...]
    """Texture files. "{normals}" in a name becomes the convention, and green follows it."""
    opacity: Texture | Literal["alpha"]
    """What a mask that leaves pixels out adds: a texture, or alpha of the first one."""
    displacement: str = "displacement"
    """Name of the texture with the height, of results that have one."""
    deviations: tuple[Texture, ...] = ()
    """Texture files beside these, of results that have deviations."""


_SEPARATE = (
    Texture("base_color", BASE_COLOR, color=True),
    Texture("roughness", ("roughness",)),
    Texture("metallic", ("metallic",)),
    Texture("normal_{normals}", NORMAL),
)
_MASK = Texture("mask", ("mask",), bits=8)

_DEVIATIONS = (
    Texture("base_color_deviation", BASE_COLOR_DEVIATION),
    Texture("roughness_deviation", ("deviation of roughness",)),
    Texture("metallic_deviation", ("deviation of metallic",)),
)

PLAIN = Preset(("gltf", "exr", "png", "mtlx"), "opengl", _SEPARATE, _MASK, deviations=_DEVIATIONS)
"""Without a preset: all formats, a map a file."""

PRESETS: dict[PresetName, Preset] = {
    "blender": Preset(("gltf", "png"), "opengl", _SEPARATE, _MASK),
    # Engines compress textures on import; 16-bit sources only make projects large.
    "unreal": Preset(
        ("png",),
        "directx",
        (
            Texture("T_BaseColor", BASE_COLOR, color=True, bits=8),
            Texture("T_ORM", ("occlusion, none", "roughness", "metallic"), bits=8),
            Texture("T_Normal", NORMAL, bits=8),
        ),
        Texture("T_OpacityMask", ("mask",), bits=8),
        "T_Displacement",
    ),
    "unity": Preset(
        ("png",),
        "opengl",
        (
            Texture("BaseMap", BASE_COLOR, color=True, bits=8),
            Texture(
                "MaskMap",
                ("metallic", "occlusion, none", "detail mask, none", "smoothness = 1 − roughness"),
                bits=8,
            ),
            Texture("NormalMap", NORMAL, bits=8),
        ),
        "alpha",
        "HeightMap",
    ),
}


def plan(
    *,
    format: Format | None = None,  # noqa: A002
    preset: PresetName | None = None,
    normals: NormalConvention | None = None,
    bits: Bits | None = None,
    geometry: Geometry | None = None,
    masked: bool = False,
    uncertain: bool = False,
) -> Preset:
    """What to write, lights apart, from what was asked for: all of its textures are files.

    `masked`: the mask leaves pixels out; `uncertain`: there are deviations. Raises InputError if an
    option is unknown, or would have no effect beside the others.
    """
    for name, value, kind in (
        ("format", format, Format),
        ("preset", preset, PresetName),
        ("normals", normals, NormalConvention),
        ("bits", bits, Bits),
        ("geometry", geometry, Geometry),
    ):
        if value is not None:
            one_of(name, value, kind)
    if format in ("gltf", "mtlx") and preset is not None:
        raise InputError(
            f"preset: expected none with format {format}, which packs textures in one way, "
            f"found {preset}"
        )
    if format == "gltf" and normals == "directx":
        raise InputError("normals: expected opengl, the convention of format gltf, found directx")
    if format == "exr" and bits is not None:
        raise InputError(f"bits: expected none with format exr, which is float32, found {bits}")
    if format in ("lp", "ptm", "rti", "openlime"):
        for name, value in (("preset", preset), ("normals", normals), ("bits", bits)):
            if value is not None:
                raise InputError(f"{name}: expected none with format {format}, found {value}")
    chosen = PLAIN if preset is None else PRESETS[preset]
    formats: tuple[Format, ...] = (format,) if format else chosen.formats
    if format == "mtlx":
        formats = ("png", "mtlx")  # it is about files
    if geometry is not None and "gltf" not in formats:
        raise InputError(
            f"geometry: expected none where no glTF is written but {' and '.join(formats)}, "
            f"found {geometry}"
        )
    convention = normals or chosen.normals
    textures = [
        replace(
            t,
            name=t.name.format(normals=convention),
            channels=tuple(GREEN[convention] if c == GREEN["opengl"] else c for c in t.channels),
        )
        for t in chosen.textures
    ]
    if masked and chosen.opacity == "alpha":
        textures[0] = replace(textures[0], channels=(*textures[0].channels, "mask"))
    elif masked and isinstance(chosen.opacity, Texture):
        textures.append(chosen.opacity)
    textures += chosen.deviations if uncertain else ()
    return replace(chosen, formats=formats, normals=convention, textures=tuple(textures))
