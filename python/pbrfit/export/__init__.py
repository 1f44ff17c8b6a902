"""Results for other tools: glTF, EXR and PNG maps, lights as panoramas and coefficients.

`export_result` writes a folder:

    material.glb      glTF 2.0: the maps on a card, and the camera that sees it as the pictures do
    material.mtlx     MaterialX: materials that read png/
    blender_extension.zip  with the preset "blender": imports the folder in Blender
    exr/              materials.exr with all layers; a file a texture
    png/              a file a texture
    relit.ptm         where it is asked for: a polynomial texture map
    relit.rti         where it is asked for: hemispherical harmonics
    openlime/         where it is asked for: the same for web viewers
    lights/           a panorama a picture, and coefficients; of lamps their directions
    export.json       what each file holds

docs/export.md says how tools read them.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pbrfit.export import blender, lights, materialx, rti
from pbrfit.export.displacement import Displacement
from pbrfit.export.gltf import glb
from pbrfit.export.lights import LightPanorama
from pbrfit.export.maps import Bits, Maps, NormalConvention
from pbrfit.export.presets import Format, Preset, PresetName, plan
from pbrfit.export.view_mesh import Geometry
from pbrfit.io import images
from pbrfit.io.json_files import UNFIT, as_json, path_text, read_json, write_json
from pbrfit.io.output import FolderForm, new_folder
from pbrfit.model.materials import write_materials
from pbrfit.result.result import Result

__all__ = ["Exported", "ExportedFile", "LightPanorama", "export_result"]

MANIFEST = "export.json"

DIFFERENCE_WARNED = 0.1
"""Relative RMS difference from which on it is warned of: of surfaces under a panorama from those
under the SH light that it stands for."""

log = logging.getLogger("pbrfit")


def _listed(folder: Path) -> list[str]:
    """Files that an export says it holds; none where it cannot be read."""
    try:
        files = read_json(folder / MANIFEST, "a list of files")["files"]
        return [path_text(file["path"]) for file in files]
    except (OSError, *UNFIT):
        return []


EXPORT_FOLDER = FolderForm(contains=(MANIFEST,), holds=(MANIFEST,), listed=_listed)


_At = Callable[[str, str, str], Path]
"""Gives the place of a file, of its name, what it holds and how its values are encoded."""


@dataclass(frozen=True)
class ExportedFile:
    """A file of an export."""

    path: str
    """In the folder, with "/"."""
    holds: str
    """What a channel each is, or all of it, in words."""
    color_space: str
    """How its values are encoded, in words."""
    size: int
    """Bytes."""


@dataclass(frozen=True)
class Exported:
    """What was written: files, and the panoramas among them with what they lost."""

    files: tuple[ExportedFile, ...]
    panoramas: tuple[LightPanorama, ...]


def export_result(
    result: Result,
    path: str | Path,
    *,
    format: Format | None = None,  # noqa: A002
    preset: PresetName | None = None,
    normals: NormalConvention | None = None,
    bits: Bits | None = None,
    geometry: Geometry | None = None,
    height: bool = True,
    overwrite: bool = False,
) -> Exported:
    """Write a result for other tools: a new folder, whole or not at all.

    Parameters
    ----------
    result
        To be written. Pixels outside its mask are filled from the nearest inside.
    path
        The folder.
    format
        "gltf", "exr", "png", "mtlx" (with its PNG files), "lp", "ptm", "rti" or "openlime" alone.
        None: those of the preset; without one, all but the last three; and "lp" wherever each
        picture has one lamp.
    preset
        Textures as "blender", "unreal" or "unity" expects them: names, channels, normals. None: a
        file a map.
    normals
        Green of normal maps upwards ("opengl") or downwards ("directx"). None: as the preset says,
        else upwards. In `material.glb` always upwards, and `materials.exr` has vectors, Y up.
    bits
        8 or 16 of PNG files and of the textures in `material.glb`. None: as the preset says, else
        16 in PNG files; in `material.glb` 16 for normals, 8 for the others.
    geometry
        Of `material.glb`: "card" (None is the same), or "facets", a rectangle a pixel for path
        tracers, which light no card by what lies behind its plane.
    height
        Whether PNG and EXR have a height map. Of most results that is integrated from the normals,
        which takes a quarter of a minute for a megapixel.
    overwrite
        Replace an earlier export.

    Raises
    ------
    InputError
        If an option is unknown or would have no effect, the maps are not finite in the mask, or the
        result has not one lamp a picture for "lp".
    FileExistsError
        If the folder exists and `overwrite` is False, or it is no export.
    OSError
        If it cannot be written.
    """
    planned = plan(
        format=format,
        preset=preset,
        normals=normals,
        bits=bits,
        geometry=geometry,
        masked=not result.mask.all(),
        uncertain=result.uncertainty is not None,
    )
    said: dict[str, tuple[str, str]] = {}
    with new_folder(Path(path), overwrite=overwrite, form=EXPORT_FOLDER) as folder:
        maps = Maps.of(result)
        wanted = height and {"exr", "png"} & {*planned.formats}
        displacement = Displacement.of(result) if wanted else None

        def at(name: str, holds: str, color_space: str) -> Path:
            said[name] = holds, color_space
            (folder / name).parent.mkdir(exist_ok=True)
            return folder / name

        colors = "base color sRGB, all else linear"
        if "gltf" in planned.formats:
            of = geometry or "card"
            holds = f"{of} with textures, and the camera of the pictures"
            content = glb(maps, result.fov, bits, of)
            at("material.glb", holds, colors).write_bytes(content)
        if "exr" in planned.formats:
            _write_exr(at, maps, planned, result, displacement)
        if "png" in planned.formats:
            _write_png(at, maps, planned, bits, displacement)
        if "mtlx" in planned.formats:
            file = at("material.mtlx", materialx.HOLDS, colors)
            file.write_bytes(materialx.mtlx(planned).encode())
        if preset == "blender" and "png" in planned.formats:
            at(blender.ZIP_FILE, blender.ZIP_HOLDS, "none").write_bytes(blender.extension())
        for form, (make, holds) in rti.FILES.items():
            if form in planned.formats:
                content, white = make(result)
                at(f"relit.{form}", holds, _codes(white)).write_bytes(content)
        if "openlime" in planned.formats:
            of_web, white = rti.openlime(result)
            for name, one in of_web.items():
                file = at(f"{rti.WEB_FOLDER}/{name}", rti.WEB_HOLDS[name], _codes(white))
                file.write_bytes(one)
        if "lp" in planned.formats or rti.one_lamp_a_picture(result.lamps, len(result.pictures)):
            file = at(f"lights/{rti.LP_FILE}", rti.LP_HOLDS, "unit vectors")
            file.write_bytes(rti.lp(result).encode())
        for name, holds in lights.FILES.items():
            file = at(f"lights/{name}", holds, "linear, Rec.709 primaries, D65")
        panoramas = lights.write_lights(file.parent, result)
        for light in panoramas:
            holds = f"panorama of the light of {light.picture}"
            at(
                f"lights/{light.file}",
                f"{holds}; lights differently by {light.difference:.2%}",
                _LINEAR,
            )
        files = tuple(
            ExportedFile(name, *of, (folder / name).stat().st_size) for name, of in said.items()
        )
        _write_manifest(folder / MANIFEST, result, planned, files, displacement)
    much = [light for light in panoramas if light.difference >= DIFFERENCE_WARNED]
    if much:
        worst = max(much, key=lambda light: light.difference)
        log.warning(
            "%s: %d of %d lights are so negative in places that panoramas light by %g %% or more "
            "differently (%s by %.0f %%); lighting.json holds them as they are",
            *(Path(path) / "lights", len(much), len(panoramas), 100 * DIFFERENCE_WARNED),
            *(worst.picture, 100 * worst.difference),
        )
    return Exported(files, panoramas)


def _codes(white: float) -> str:
    return f"sRGB codes, white = radiance {white:.4g}"


def _write_exr(
    at: _At, maps: Maps, planned: Preset, result: Result, displacement: Displacement | None
) -> None:
    file = at("exr/materials.exr", "all maps as layers; normals as vectors, Y up", _LINEAR)
    layers = result.further_layers(), result.whole_layers()
    write_materials(file, result.materials, result.normals, result.mask, *layers)
    for texture in planned.textures:
        values = maps.floats(texture)
        letters = "Y" if values.shape[-1] == 1 else "RGBA"
        encoding = _LINEAR if texture.color else _DATA
        file = at(f"exr/{texture.name}.exr", "; ".join(texture.channels), encoding)
        images.write_exr(file, {letters[c]: values[..., c] for c in range(values.shape[-1])})
    if displacement is not None:
        holds = "height towards the viewer in picture widths"
        file = at(f"exr/{planned.displacement}.exr", holds, _DATA)
        images.write_exr(file, {"Y": displacement.height})


def _write_png(
    at: _At, maps: Maps, planned: Preset, asked: Bits | None, displacement: Displacement | None
) -> None:
    for texture in planned.textures:
        bits = asked or texture.bits
        holds, encoding = "; ".join(texture.channels), f"{texture.color_space}; {bits} bits"
        file = at(f"png/{texture.name}.png", holds, encoding)
        images.write_png(file, maps.integers(texture, bits), "srgb" if texture.color else "linear")
    if displacement is not None:
        bits = asked or 16
        limits = f"{displacement.low:.6g} (0) to {displacement.high:.6g}"
        holds = f"height towards the viewer, from {limits} picture widths (white)"
        file = at(f"png/{planned.displacement}.png", holds, f"data, linear; {bits} bits")
        images.write_png(file, displacement.integers(bits), "linear")


_LINEAR = "linear, Rec.709 primaries, D65; float32"
_DATA = "data, linear; float32"


def _write_manifest(
    path: Path,
    result: Result,
    planned: Preset,
    files: tuple[ExportedFile, ...],
    displacement: Displacement | None,
) -> None:
    from pbrfit import __version__

    content: dict[str, Any] = {
        "version": __version__,
        "fov": result.fov,
        "model": result.model,
        "normal_maps": planned.normals,
        "files": [
            {"path": of.path, "holds": of.holds, "color_space": of.color_space} for of in files
        ],
    }
    if result.uncertainty is not None:
        content["verdicts"] = as_json(result.verdicts)
    if displacement is not None:
        content["displacement"] = displacement.as_json()
    write_json(path, content)
