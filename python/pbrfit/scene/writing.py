"""A scene as a folder that is read back as it is: float32 EXR, ground truth included."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io import images
from pbrfit.io.lamp_files import LAMP_FILES, write_lamps
from pbrfit.io.normal_files import write_normals
from pbrfit.io.output import new_folder
from pbrfit.io.weight_files import WEIGHT_FILE, write_weights
from pbrfit.model import estimates
from pbrfit.model.lamps import entries_of_lamps
from pbrfit.model.lighting import Lighting
from pbrfit.model.materials import nearest_inside, write_materials
from pbrfit.scene.arrays import SceneArrays, Truth, storable_ids
from pbrfit.scene.folder import MAX_ID, SCENE_FOLDER, SEGMENT_FILE
from pbrfit.values.arrays import Codes, Floats


def save(scene: SceneArrays, path: Path, *, overwrite: bool = False) -> None:
    """Write a scene folder; see `Scene.save`."""
    with new_folder(path, overwrite=overwrite, form=SCENE_FOLDER) as folder:
        (folder / "images").mkdir()
        for i, (name, image) in enumerate(zip(scene.names, scene.images, strict=True)):
            limits = None if scene.limits is None else scene.limits[i]
            _write_picture(folder / "images" / f"{name}.exr", image, limits)
        if scene.normals_known:
            normals = np.where(scene.valid[..., None], scene.normals, 0.0).astype(np.float32)
            sigma = scene.normal_sigma
            uncertainty = None if sigma is None else np.where(scene.valid, sigma, np.float32(0))
            write_normals(folder / "normals.exr", normals, uncertainty)
        fov = f"fov = {float(scene.fov)!r}\n" if scene.fov_known else ""
        model = "" if scene.model is None else f'model = "{scene.model}"\n'
        (folder / "scene.toml").write_text(fov + model, encoding="utf-8")
        if not scene.valid.all():
            images.write_png(
                folder / "mask.png", np.where(scene.valid, 255, 0).astype(np.uint8), tag=None
            )
        if scene.weights is not None:
            write_weights(folder / WEIGHT_FILE, scene.weights, scene.names)
        if scene.depth is not None:
            images.write_exr(folder / "depth.exr", {"Z": scene.depth})
        if scene.estimates is not None:
            estimates.write(folder / estimates.ESTIMATES_FILE, scene.estimates)
        if (segments := scene.segments) is not None:
            segments = storable_ids(segments, MAX_ID)
            if (count := segments.max()) > MAX_ID:
                raise InputError(f"segments: expected at most {MAX_ID} to save, found {count}")
            images.write_png(folder / SEGMENT_FILE, segments.astype(np.uint16), tag=None)
        if scene.lighting is not None:
            Lighting(scene.names, scene.lighting).save(folder / "lighting.json")
        if scene.lamps is not None:
            write_lamps(folder / LAMP_FILES[0], entries_of_lamps(scene.lamps, scene.names))
        if scene.truth is not None:
            _write_truth(scene.truth, scene, folder / "truth")


def write_height(path: Path, height: Floats) -> None:
    """Write a height (H, W), NaN where unknown; there the file has what the nearest pixel has."""
    known = np.isfinite(height)
    filled = np.where(known, height, 0.0)[nearest_inside(known)]
    channels = {"Y": filled.astype(np.float32), "mask.Y": known.astype(np.float32)}
    images.write_exr(path, channels)


def _write_truth(truth: Truth, scene: SceneArrays, folder: Path) -> None:
    folder.mkdir()
    write_materials(folder / "materials.exr", truth.materials, scene.normals, scene.valid)
    if truth.lighting is not None:
        Lighting(scene.names, truth.lighting).save(folder / "lighting.json")
    if truth.relight_images is None or truth.relight_lighting is None:
        return
    (folder / "relight").mkdir()
    names = tuple(f"relight_{i:02d}" for i in range(len(truth.relight_images)))
    for name, image in zip(names, truth.relight_images, strict=True):
        _write_picture(folder / "relight" / f"{name}.exr", image)
    Lighting(names, truth.relight_lighting).save(folder / "relight" / "lighting.json")


def _write_picture(path: Path, image: NDArray[Any], limits: Codes | None = None) -> None:
    finite = np.where(np.isfinite(image), image, 0.0).astype(np.float32)
    channels: dict[str, NDArray[Any]] = {name: finite[..., c] for c, name in enumerate("RGB")}
    if limits is not None:
        channels |= {f"{images.LIMITS}.{name}": limits[..., c] for c, name in enumerate("RGB")}
    images.write_exr(path, channels)
