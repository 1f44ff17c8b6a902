"""Result: recovered materials and lights, how the fit went, and the folder it is kept in."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pbrfit._core import InputError
from pbrfit.io import images
from pbrfit.io.input_files import digest
from pbrfit.io.json_files import (
    UNFIT,
    as_json,
    number,
    path_text,
    read_as,
    read_json,
    table,
    unfit,
    whole,
    write_json,
)
from pbrfit.io.output import FolderForm, new_folder
from pbrfit.model.geometry import check_fov
from pbrfit.model.lighting import Lighting
from pbrfit.model.materials import of_channels, write_materials
from pbrfit.model.reflection import MODELS, Model
from pbrfit.registration.placement import IN_LINE, NOT_CHECKED, aligned
from pbrfit.result.data import DEPTH, GIVEN_NORMALS, SEGMENT, ResultData
from pbrfit.result.history import History
from pbrfit.result.metrics import PROTOCOL
from pbrfit.result.refinement import Refinement
from pbrfit.result.relighting import Light, relight
from pbrfit.result.uncertainty import Uncertainty, layer_names
from pbrfit.scene.folder import HEIGHT_FILE, is_scene
from pbrfit.scene.options import ReadOptions, Source
from pbrfit.scene.scene import Scene
from pbrfit.scene.writing import write_height
from pbrfit.values.quoting import listed, quoted

if TYPE_CHECKING:
    from pbrfit import Exported

FILES = ("materials.exr", "lighting.json", "history.csv", "preview.png")
"""Files of a result folder whose sha256 is in `result.json`."""

DETAILS = (
    *("fov", "status", "stop_reason", "evaluations", "seconds", "metrics", "options", "assumed"),
    *("left_out", "inputs", "stages", "camera", "transport", "held_out"),
)
"""Fields of `ResultData` that `result.json` has under their names."""

REPORT_FILE = "report.html"

RESULT_FOLDER = FolderForm(
    contains=("result.json", "materials.exr"),
    holds=("result.json", *FILES, HEIGHT_FILE, REPORT_FILE),
)


class Result(ResultData):
    """What `decompose` found, with the folder it is kept in; `ResultData` says what it holds."""

    def save(
        self, path: str | Path, *, scene: Scene | None = None, overwrite: bool = False
    ) -> None:
        """Write a result folder (docs/formats.md), whole or not at all.

        Maps are rounded to float32, relatively by 6·10⁻⁸ at most, because an EXR file holds no
        more; `load` gives them back as float64 of these values. Lights, lamps and other numbers
        keep all digits of float64. A result that was loaded is saved as the same bits again.

        Parameters
        ----------
        path
            The folder.
        scene
            Lets the preview show a picture beside its reconstruction, and ground truth.
        overwrite
            Replace an existing folder.

        Raises
        ------
        FileExistsError
            If the folder exists and `overwrite` is False.
        """
        with new_folder(Path(path), overwrite=overwrite, form=RESULT_FOLDER) as folder:
            self.write(folder, scene)

    def write(self, folder: Path, scene: Scene | None = None, place: Path | None = None) -> None:
        """Write the files of a result into an existing folder.

        The folder may be moved to `place` afterwards, from where `result.json` says the way to the
        scene; None = it stays, or is renamed where it is.
        """
        # Here: what only writing needs takes longer to import than all else of this module.
        from importlib.metadata import version

        from pbrfit.result.preview import preview

        if scene is not None:
            scene = self.as_fitted(scene)
        uncertainty = self.uncertainty
        write_materials(
            folder / "materials.exr",
            self.materials,
            self.normals,
            self.mask,
            self.further_layers(),
            self.whole_layers(),
        )
        Lighting(self.pictures, self.lighting, self.lamps).save(folder / "lighting.json")
        if self.height is not None:
            write_height(folder / HEIGHT_FILE, self.height)
        self.history.save(folder / "history.csv")
        images.write_png(folder / "preview.png", preview(self, scene), tag="srgb")
        content = {
            "version": version("pbrfit"),
            "model": self.model,
            "iterations": self.history.iterations,
            "protocol": PROTOCOL,
            **{name: as_json(getattr(self, name)) for name in DETAILS},
            "uncertainty": None if uncertainty is None else uncertainty.summary(),
            "normals": as_json(self.refinement),
            "verdicts": {name: one.level for name, one in self.verdicts.items()},
            "scene": None if self.source is None else _source_as_json(self.source, place or folder),
            "files": {name: digest(folder / name) for name in files_of(folder)},
        }
        # What no UTF-8 can hold, of a path to the scene, becomes what JSON escapes it by.
        write_json(folder / "result.json", content, errors="backslashreplace")

    def as_fitted(self, scene: Scene) -> Scene:
        """The scene with its pictures where they were fitted, decoded as they were."""
        said = self.assumed.get("alignment", "")
        if self.options.align == "auto" and not said.startswith((IN_LINE, NOT_CHECKED)):
            scene = aligned(scene)
        response = None if self.camera is None else self.camera.response
        if response is None or scene.response is None:
            return scene
        return scene.decoded_by(response)

    def report(
        self, path: str | Path, scene: Scene | str | Path | None = None, *, overwrite: bool = False
    ) -> None:
        """Write a page about it, one .html file; as `pbrfit.write_report`, which see."""
        from pbrfit import write_report  # public: what is above this room is not named here

        write_report(self, path, scene, overwrite=overwrite)

    def export(self, path: str | Path, **options: Any) -> Exported:
        """Write it for other tools, into a new folder.

        `options` are those of `pbrfit.export_result`, which see: `format`, `preset`, `overwrite`
        and others.
        """
        from pbrfit import export_result

        return export_result(self, path, **options)

    def relight(
        self,
        light: ArrayLike | Light | str | Path | None = None,
        threads: int = 0,
        *,
        picture: int | str | None = None,
        shadows: bool = True,
    ) -> NDArray[np.float64]:
        """(H, W, 3): radiance under other light; as `pbrfit.relight`, which see."""
        return relight(self, light, threads, picture=picture, shadows=shadows)

    def _repr_html_(self) -> str:
        """Maps and verdicts, for notebooks."""
        from pbrfit.result.notebook import html

        return html(self)

    @classmethod
    def load(cls, path: str | Path) -> Result:
        """Read a result folder; its maps have the float32 values that `save` wrote, as float64.

        Raises
        ------
        InputError, OSError
            If this is no result folder, or a file in it is missing or not what `save` writes; the
            message names it.
        """
        folder = Path(path)
        _check_is_result(folder)
        of_maps = folder / "materials.exr"
        layers = images.read_channels(of_maps)
        materials, normals, mask = of_channels(layers, of_maps)
        if not mask.any():
            raise InputError(f"{of_maps}: expected some pixel with mask.Y above 0.5, found none")
        for name, values in {**vars(materials), "normal": normals}.items():
            if not np.isfinite(values[mask]).all():
                raise InputError(f"{of_maps}: expected finite {name}, found NaN or infinity")
        lighting = Lighting.load(folder / "lighting.json")
        file, expected = folder / "result.json", "what pbrfit writes"
        content = read_json(file, expected)
        try:
            details = details_of(content, folder)
            refined, blocked = details["refinement"].refined, details["transport"].blocks
            uncertainty = None
            if content["uncertainty"] is not None:
                _check_layers(layers, of_maps, layer_names(), "an uncertainty")
                uncertainty = Uncertainty.of(layers, mask, content["uncertainty"])
            return cls(
                **details,
                materials=materials,
                lighting=lighting.coefficients,
                normals=normals,
                mask=mask,
                pictures=lighting.pictures,
                history=History.load(folder / "history.csv"),
                uncertainty=uncertainty,
                given_normals=_given_normals(layers, of_maps, mask) if refined else None,
                depth=_depth(layers),
                segments=(
                    layers[SEGMENT].astype(np.int32) if blocked and SEGMENT in layers else None
                ),
                lamps=lighting.lamps,
                height=(
                    _height(folder / HEIGHT_FILE, mask) if HEIGHT_FILE in content["files"] else None
                ),
            )
        except UNFIT as error:
            if isinstance(error, InputError) and str(folder) in str(error):
                raise
            raise unfit(file, expected, error) from None


def details_of(content: Any, folder: Path) -> dict[str, Any]:
    """What `result.json` of a folder says of a result: fields of `ResultData` that are no arrays.

    Raises one of `json_files.UNFIT` for what pbrfit does not write.
    """
    content = table(content)
    check_fov(number(content["fov"]))
    table(content["files"])
    whole(content["iterations"])
    kinds, source = get_type_hints(ResultData), content["scene"]
    return {
        **{name: read_as(kinds[name], content[name]) for name in DETAILS},
        "model": model_of(content, folder / "result.json"),
        "refinement": read_as(Refinement, content["normals"]),
        "source": None if source is None else _source(source, folder),
    }


def files_of(folder: Path) -> tuple[str, ...]:
    """Files of a result folder whose sha256 belongs into its `result.json`."""
    return (*FILES, HEIGHT_FILE) if (folder / HEIGHT_FILE).exists() else FILES


def _check_is_result(folder: Path) -> None:
    """Raise InputError that says what is there instead."""
    marks = (*RESULT_FOLDER.contains, "lighting.json")
    missing = [name for name in marks if not (folder / name).exists()]
    if not missing:
        return
    found = f"one without {' and '.join(missing)}"
    if not folder.is_dir():
        found = "a file" if folder.exists() else "nothing"
    elif is_scene(folder):
        found = "a scene folder: run pbrfit decompose on it first"
    elif below := sorted(folder.glob(f"*/{marks[0]}")):
        found = f"a folder of results: name one of them, such as {below[0].parent}"
    raise InputError(
        f"{folder}: expected a result folder, as pbrfit decompose writes it, found {found}"
    )


def model_of(content: Mapping[str, Any], file: Path) -> Model:
    """Return the model of a result by what its `result.json` holds.

    Raises InputError if that is none; the message names the file.
    """
    name: Any = content.get("model")
    if name in MODELS:
        return name  # type: ignore[no-any-return]
    raise InputError(f"{file}: model: expected {' or '.join(MODELS)}, found {quoted(name)}")


def _source_as_json(source: Source, folder: Path) -> dict[str, Any] | None:
    """How a scene was read; its place as seen from the result folder, so that both can move."""
    try:
        path = Path(os.path.relpath(source.path, folder.resolve())).as_posix()
    except ValueError:  # on another drive, where no relative path leads
        return None
    return {"path": path, "files": list(source.files), **vars(source.options)}


def _source(content: Mapping[str, Any], folder: Path) -> Source:
    return Source(
        path=(folder / path_text(content["path"])).resolve(),
        options=ReadOptions.from_json(content),
        files=read_as(tuple[str, ...], content["files"]),
    )


Layers = Mapping[str, NDArray[np.float32]]
"""Channels of `materials.exr`."""


def _given_normals(layers: Layers, file: Path, mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    _check_layers(layers, file, GIVEN_NORMALS, "refined normals")
    given = np.stack([layers[name] for name in GIVEN_NORMALS], axis=-1).astype(np.float64)
    return np.where(mask[..., None], given, np.nan)


def _depth(layers: Layers) -> NDArray[np.float32] | None:
    if DEPTH not in layers:
        return None
    depth = layers[DEPTH]
    return np.where((depth > 0) & np.isfinite(depth), depth, np.float32(np.nan))


def _height(path: Path, mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    layers = images.read_channels(path)
    _check_layers(layers, path, ("Y", "mask.Y"), "a height")
    height = layers["Y"]
    if height.shape != mask.shape:
        raise InputError(f"{path}: expected a height of {mask.shape}, found {height.shape}")
    known = (layers["mask.Y"] > 0.5) & mask
    if not np.isfinite(height[known]).all():
        raise InputError(f"{path}: expected finite heights, found NaN or infinity")
    return np.where(known, height, np.float32(np.nan))


def _check_layers(layers: Layers, file: Path, names: Sequence[str], told: str) -> None:
    """Raise InputError unless `names` are there, as `result.json` tells."""
    missing = [name for name in names if name not in layers]
    if missing:
        raise InputError(
            f"{file}: expected channel {missing[0]}, because result.json tells of {told}, "
            f"found {listed(layers)}"
        )
