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
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pbrfit.export import blender, lights, materialx, rti
from pbrfit.export.displacement import Displacement
from pbrfit.export.gltf import glb
from pbrfit.export.lights import LightPanorama
from pbrfit.export.maps import Bits, Maps, NormalConvention
from pbrfit.export.presets import Format, Plan, PresetName, plan
from pbrfit.export.view_mesh import Geometry
from pbrfit.io import images
from pbrfit.io.json_files import UNFIT, path_text, read_json, write_json
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
    maps = Maps.of(result)
    wanted = height and {"exr", "png"} & {*planned.formats}
    displacement = Displacement.of(result) if wanted else None
    files: list[ExportedFile] = []
    with new_folder(Path(path), overwrite=overwrite, form=EXPORT_FOLDER) as folder:

        def put(name: str, content: bytes, holds: str, color_space: str) -> None:
            (folder / name).write_bytes(content)
            files.append(_file(folder, name, holds, color_space))

        colors = "base color sRGB, all else linear"
        if "gltf" in planned.formats:
            holds = f"{planned.geometry} with textures, and the camera of the pictures"
            content = glb(maps, result.fov, planned.bits, planned.geometry)
            put("material.glb", content, holds, colors)
        if "exr" in planned.formats:
            files += _write_exr(folder, maps, planned, result, displacement)
        if "png" in planned.formats:
            files += _write_png(folder, maps, planned, displacement)
        if "mtlx" in planned.formats:
            put("material.mtlx", materialx.mtlx(planned).encode(), materialx.HOLDS, colors)
        if preset == "blender" and "png" in planned.formats:
            put(blender.ZIP_FILE, blender.extension(), blender.ZIP_HOLDS, "none")
        for form, (make, holds) in rti.FILES.items():
            if form in planned.formats:
                content, white = make(result)
                put(f"relit.{form}", content, holds, _codes(white))
        if "openlime" in planned.formats:
            of_web, white = rti.openlime(result)
            (folder / rti.WEB_FOLDER).mkdir()
            for name, one in of_web.items():
                put(f"{rti.WEB_FOLDER}/{name}", one, rti.WEB_HOLDS[name], _codes(white))
        (folder / "lights").mkdir()
        if "lp" in planned.formats or rti.one_lamp_a_picture(result.lamps, len(result.pictures)):
            put(f"lights/{rti.LP_FILE}", rti.lp(result).encode(), rti.LP_HOLDS, "unit vectors")
        panoramas = lights.write_lights(folder / "lights", result)
        for name, holds in lights.FILES.items():
            file = f"lights/{name}"
            files.append(_file(folder, file, holds, "linear, Rec.709 primaries, D65"))
        for light in panoramas:
            holds = f"panorama of the light of {light.picture}"
            holds += f"; lights differently by {light.difference:.2%}"
            files.append(_file(folder, f"lights/{light.file}", holds, _LINEAR))
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
    return Exported(tuple(files), panoramas)


def _codes(white: float) -> str:
    return f"sRGB codes, white = radiance {white:.4g}"


def _write_exr(
    folder: Path, maps: Maps, planned: Plan, result: Result, displacement: Displacement | None
) -> Iterator[ExportedFile]:
    (folder / "exr").mkdir()
    path = "exr/materials.exr"
    layers = result.further_layers(), result.whole_layers()
    write_materials(folder / path, result.materials, result.normals, result.mask, *layers)
    yield _file(folder, path, "all maps as layers; normals as vectors, Y up", _LINEAR)
    for texture in planned.textures:
        path = f"exr/{texture.name}.exr"
        values = maps.floats(texture)
        letters = "Y" if values.shape[-1] == 1 else "RGBA"
        images.write_exr(
            folder / path, {letters[c]: values[..., c] for c in range(values.shape[-1])}
        )
        encoding = _LINEAR if texture.color else _DATA
        yield _file(folder, path, "; ".join(texture.channels), encoding)
    if displacement is not None:
        path = f"exr/{planned.displacement}.exr"
        images.write_exr(folder / path, {"Y": displacement.height})
        yield _file(folder, path, "height towards the viewer in picture widths", _DATA)


def _write_png(
    folder: Path, maps: Maps, planned: Plan, displacement: Displacement | None
) -> Iterator[ExportedFile]:
    (folder / "png").mkdir()
    for texture in planned.textures:
        bits = planned.bits or texture.bits
        path = f"png/{texture.name}.png"
        values = maps.integers(texture, bits)
        images.write_png(folder / path, values, "srgb" if texture.color else "linear")
        holds = "; ".join(texture.channels)
        yield _file(folder, path, holds, f"{texture.color_space}; {bits} bits")
    if displacement is not None:
        bits, path = planned.bits or 16, f"png/{planned.displacement}.png"
        images.write_png(folder / path, displacement.integers(bits), "linear")
        limits = f"{displacement.low:.6g} (0) to {displacement.high:.6g}"
        holds = f"height towards the viewer, from {limits} picture widths (white)"
        yield _file(folder, path, holds, f"data, linear; {bits} bits")


_LINEAR = "linear, Rec.709 primaries, D65; float32"
_DATA = "data, linear; float32"


def _file(folder: Path, path: str, holds: str, color_space: str) -> ExportedFile:
    return ExportedFile(path, holds, color_space, (folder / path).stat().st_size)


def _write_manifest(
    path: Path,
    result: Result,
    planned: Plan,
    files: list[ExportedFile],
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
        content["verdicts"] = {name: asdict(one) for name, one in result.verdicts.items()}
    if displacement is not None:
        content["displacement"] = displacement.as_json()
    write_json(path, content)
