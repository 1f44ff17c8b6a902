"""Public sets of pictures under several lights, and how each becomes a scene folder."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.io import images
from pbrfit.scene import folder as scene_folder
from pbrfit.scene.completion import add_flat_normals
from pbrfit_evaluation.jobs import digest_of_files
from pbrfit_evaluation.real.spheres import sphere_normals

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Source:
    """One set of pictures, not read yet.

    Attributes
    ----------
    name
        Of the scene; fit for a file.
    folder
        Where the files are.
    kind
        Name of a public set, or "scene" for a scene folder.
    pictures
        How many.
    about
        What has to be known about it: where normals come from, what is assumed.
    """

    name: str
    folder: Path
    kind: str
    pictures: int
    about: str

    def digest(self) -> str:
        """sha256 of the names and contents of all files."""
        return digest_of_files(self.folder)


@dataclass(frozen=True)
class PublicSet:
    """A set that can be had from its authors.

    Attributes
    ----------
    kind
        Name of its folder.
    origin
        What it is, where it comes from, its licence and files.
    find
        Sources in its folder.
    write
        Writes a source as a scene folder that exists and is empty.
    """

    kind: str
    origin: str
    find: Callable[[Path], list[Source]]
    write: Callable[[Source, Path], None]


# Bunny: arrays


def _find_arrays(folder: Path) -> list[Source]:
    about = "linear arrays; true normals; field of view not told: highlights say about 48 degrees"
    sources = []
    for path in sorted(folder.glob("*.npz")):
        with np.load(path) as arrays:
            count = len(arrays["images"])
        sources.append(Source(path.stem, folder, folder.resolve().name, count, about))
    return sources


def _write_arrays(source: Source, folder: Path) -> None:
    normals = np.load(source.folder / "gt_normal.npy")
    mask = images.read_data(source.folder / "mask.png")[..., 0] >= 0.5
    with np.load(source.folder / f"{source.name}.npz") as arrays:
        pictures = arrays["images"]
    valid = mask & has_normal(normals)
    (folder / "images").mkdir()
    for i, picture in enumerate(pictures):
        channels = {name: picture[..., c].astype(np.float32) for c, name in enumerate("RGB")}
        images.write_exr(folder / "images" / f"picture_{i:02d}.exr", channels)
    _write_rest(folder, np.where(valid[..., None], normals, 0.0), valid, "")


# Shrek, ball, brick sphere: one set of PNG files, seen by an orthographic camera


# Shrek's stored normals are not (n+1)/2: beside a least-squares fit of the eight known lights, v is
# SCALE n + OFFSET in each channel, with a residual of 0.005, as if stretched to fill [0, 1].
NORMAL_SCALE = np.array([0.559, 0.561, 0.555])
NORMAL_OFFSET = np.array([0.412, 0.412, 0.447])

Normals = Callable[[Path, Sequence[Path]], tuple[Array, NDArray[np.bool_]]]
"""Normals of a set and the pixels that have one, from its folder and its pictures."""


def _files(
    kind: str, origin: str, about: str, pattern: str, normals: Normals, settings: str = ""
) -> PublicSet:
    """A set of one source, whose pictures are files."""

    def find(folder: Path) -> list[Source]:
        name = folder.resolve().name
        return [Source(name, folder, name, len(list(folder.glob(pattern))), about)]

    def write(source: Source, folder: Path) -> None:
        paths = sorted(source.folder.glob(pattern))
        found, valid = normals(source.folder, paths)
        (folder / "images").mkdir()
        for path in paths:
            shutil.copy(path, folder / "images")
        _write_rest(folder, found, valid, f"fov = 0\n{settings}")

    return PublicSet(kind, origin, find, write)


def _shrek_normals(folder: Path, _: Sequence[Path]) -> tuple[Array, NDArray[np.bool_]]:
    stored = images.read_data(folder / "normal.png")[..., :3]
    normals = (stored - NORMAL_OFFSET) / NORMAL_SCALE
    return normals, _inside(folder / "mask.png") & has_normal(normals)


def _ball_normals(folder: Path, _: Sequence[Path]) -> tuple[Array, NDArray[np.bool_]]:
    path = folder / "mask.png"
    normals, valid = sphere_normals(images.read_data(path)[..., 0] >= 0.5, str(path))
    return normals, valid & _inside(path)


def _brick_normals(folder: Path, paths: Sequence[Path]) -> tuple[Array, NDArray[np.bool_]]:
    seen = np.any([images.read_data(path).max(axis=-1) > 0 for path in paths], axis=0)
    return sphere_normals(seen, str(folder))


def _inside(path: Path) -> NDArray[np.bool_]:
    """Fully white pixels less a border: those on the outline are part background."""
    from scipy.ndimage import binary_erosion

    return np.asarray(binary_erosion(images.read_data(path)[..., 0] == 1.0))


# Multi-illumination: photographs of rooms


def _find_rooms(folder: Path) -> list[Source]:
    return [
        room_source(below)
        for below in sorted(folder.iterdir())
        if below.is_dir() and scene_folder.is_scene(below)
    ]


def room_source(folder: Path) -> Source:
    """Pictures in the layout of that set, without normals."""
    pictures = len(scene_folder.find_pictures(folder))
    about = (
        "photographs; normals unknown, so every surface is taken to face the camera; field of view "
        "unknown, taken as 60 degrees; light probes are not read"
    )
    return Source(folder.resolve().name, folder, "mit_multi_illumination", pictures, about)


def _write_room(source: Source, folder: Path) -> None:
    for path in scene_folder.find_pictures(source.folder):
        shutil.copy(path, folder)
    (folder / "scene.toml").write_text("fov = 60\n", encoding="utf-8")
    add_flat_normals(folder)


def has_normal(normals: Array) -> NDArray[np.bool_]:
    """Pixels with a normal that pbrfit does not refuse."""
    length = np.linalg.norm(normals, axis=-1)
    return np.asarray(np.isfinite(length) & (length >= 0.5))


def _write_rest(folder: Path, normals: Array, valid: NDArray[np.bool_], settings: str) -> None:
    planes = {name: normals[..., i].astype(np.float32) for i, name in enumerate("XYZ")}
    images.write_exr(folder / "normals.exr", planes)
    images.write_png(folder / "mask.png", np.where(valid, 255, 0).astype(np.uint8), tag=None)
    (folder / "scene.toml").write_text(settings, encoding="utf-8")


SETS: dict[str, PublicSet] = {
    one.kind: one
    for one in (
        PublicSet(
            "bunny_ps",
            "rendered bunny: 25 HDR pictures of a glossy material and 12 of a matt one, true "
            "normals; github.com/yasumat/RobustPhotometricStereo commit "
            "f03aa95b57e746a7d31df76b1c0fa0a83584a3c1, data/bunny; GPL-3.0 (stated in its README); "
            "bunny_specular_25.npz and bunny_lambert_noshadow_12.npz hold the .npy pictures of "
            "bunny_specular and bunny_lambert_noshadow as `images`, float32; gt_normal.npy; "
            "mask.png",
            _find_arrays,
            _write_arrays,
        ),
        _files(
            "visiont3lab_shrek",
            "rendered figure: 8 pictures under 8 lights, mask, estimated normals; "
            "github.com/visiont3lab/photometric_stereo commit "
            "9ded70dfbbe409dd2e0a2a6946c71c180d47a926, photostereo_py/samples/shrek.zip; MIT "
            "(stated in its README); its .bmp files as shrek0.png ... shrek7.png, mask.png, "
            "normal.png",
            "8 bits; normals estimated by its authors; camera orthographic",
            "*[0-9].png",
            _shrek_normals,
        ),
        _files(
            "visiont3lab_ball3",
            "rendered glossy ball: 8 pictures under 8 lights, mask; "
            "github.com/visiont3lab/photometric_stereo commit "
            "9ded70dfbbe409dd2e0a2a6946c71c180d47a926, photostereo_py/samples/ball3.zip; MIT "
            "(stated in its README); its .bmp files as ball0.png ... ball7.png, mask.png",
            "8 bits, taken as sRGB (the known lamps fit neither that nor linear values exactly); "
            "normals of a sphere, found from the mask; camera taken as orthographic",
            "*[0-9].png",
            _ball_normals,
        ),
        _files(
            "maxcrous_sphere_color",
            "rendered matt brick sphere: 25 pictures under 25 lights; "
            "github.com/maxcrous/photometric-stereo commit "
            "08eb113eca55f28934146d2fd60b589ec8dd0916, photometrics_images/SphereColor; MIT; as "
            "PNG",
            "8 bits, linear (known lamps fit better so); normals of a sphere, found as what is not "
            "black in some picture; camera taken as orthographic",
            "Sphere_*.png",
            _brick_normals,
            'color_space = "linear"\n',
        ),
        PublicSet(
            "mit_multi_illumination",
            "photographs of rooms under 25 flash directions (Murmann et al. 2019); "
            "github.com/lmurmann/multi_illumination commit "
            "a85aa9253065ff836ea97ba1a04b14259a06b3e0, tests/data; MIT; "
            "everett_kitchen2/dir_*_mip6.jpg",
            _find_rooms,
            _write_room,
        ),
    )
}
"""By name of the folder."""
