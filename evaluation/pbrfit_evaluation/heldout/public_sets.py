"""Public sets of pictures under several lights, and how each becomes a scene folder."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io import images
from pbrfit.scene import folder as scene_folder
from pbrfit.scene.completion import add_normals, picture_size
from pbrfit_evaluation.jobs import digest_of_files

Array = NDArray[np.floating[Any]]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Source:
    """One set of pictures, not read yet."""

    name: str
    """Fit for a file."""
    folder: Path
    kind: str
    """Name of a public set, or "scene" for a scene folder."""
    pictures: int
    """How many."""
    about: str
    """What has to be known about it."""
    private: bool = False
    """Whether its licence lets nothing of it be published."""
    linear: bool = False
    """Whether it says that the values in its files are linear."""

    def digest(self) -> str:
        """sha256 of the names and contents of all files."""
        return digest_of_files(self.folder)


@dataclass(frozen=True)
class PublicSet:
    """A set that can be had from its authors."""

    kind: str
    """Name of its folder."""
    origin: str
    """What it is, where it comes from, its licence and files."""
    find: Callable[[Path], list[Source]]
    """Sources in its folder."""
    write: Callable[[Source, Path], None]
    """Writes a source as a scene folder, into a folder that exists and is empty."""


# Bunny: arrays


def _find_arrays(folder: Path) -> list[Source]:
    about = "linear arrays; true normals given; field of view unknown"
    sources = []
    for path in sorted(folder.glob("*.npz")):
        with np.load(path) as arrays:
            count = len(arrays["images"])
        sources.append(Source(path.stem, folder, folder.resolve().name, count, about))
    return sources


def _write_arrays(source: Source, folder: Path) -> None:
    normals = np.load(source.folder / "gt_normal.npy")
    valid = (images.read_data(source.folder / "mask.png")[..., 0] >= 0.5) & has_normal(normals)
    with np.load(source.folder / f"{source.name}.npz") as arrays:
        pictures = arrays["images"]
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

Normals = Callable[[Path, Sequence[Path]], tuple[Array, Mask]]
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


def _shrek_normals(folder: Path, _: Sequence[Path]) -> tuple[Array, Mask]:
    stored = images.read_data(folder / "normal.png")[..., :3]
    normals = (stored - NORMAL_OFFSET) / NORMAL_SCALE
    return normals, _inside(folder / "mask.png") & has_normal(normals)


def _ball_normals(folder: Path, _: Sequence[Path]) -> tuple[Array, Mask]:
    path = folder / "mask.png"
    normals, valid = sphere_normals(images.read_data(path)[..., 0] >= 0.5, str(path))
    return normals, valid & _inside(path)


def _brick_normals(folder: Path, paths: Sequence[Path]) -> tuple[Array, Mask]:
    seen = np.any([images.read_data(path).max(axis=-1) > 0 for path in paths], axis=0)
    return sphere_normals(seen, str(folder))


def _inside(path: Path) -> Mask:
    """Fully white pixels less a border: those on the outline are part background."""
    from scipy.ndimage import binary_erosion

    return np.asarray(binary_erosion(images.read_data(path)[..., 0] == 1.0))


RADIUS_SHARE = 0.98
"""Share of a sphere's radius that is used: pixels further out are part background, and their
normals turn by ten degrees and more within a pixel."""


def sphere_normals(disc: Mask, name: str) -> tuple[NDArray[np.float64], Mask]:
    """Normals (H, W, 3) of a sphere seen from far away, and the pixels (H, W) that have one.

    `disc` (H, W) is where the sphere is seen, `name` that of the file. Raises InputError if it is
    no disc.
    """
    rows, columns = (np.flatnonzero(disc.any(axis=axis)) for axis in (1, 0))
    found = "nothing"
    if rows.size:
        height, width = (float(np.ptp(at)) + 1 for at in (rows, columns))
        radius = (height + width) / 4
        fill = np.count_nonzero(disc) / (np.pi * radius**2)
        if abs(height - width) <= 0.02 * radius and abs(fill - 1) <= 0.02:
            y, x = np.indices(disc.shape, dtype=np.float64)
            right = (x - (columns[0] + columns[-1]) / 2) / radius
            up = ((rows[0] + rows[-1]) / 2 - y) / radius
            inside = right**2 + up**2 < RADIUS_SHARE**2
            towards = np.sqrt(np.where(inside, 1 - right**2 - up**2, 0.0))
            return np.stack([right, up, towards], axis=-1), inside & disc
        found = f"{width:.0f} × {height:.0f} pixels, of which {100 * fill:.0f} % of a disc are set"
    raise InputError(f"{name}: expected the disc of a sphere, found {found}")


# Multi-illumination: photographs of rooms

ROOMS = "mit_multi_illumination"


def _find_rooms(folder: Path) -> list[Source]:
    rooms = [one for one in sorted(folder.iterdir()) if one.is_dir() and scene_folder.is_scene(one)]
    return [room_source(room) for room in rooms]


def room_source(folder: Path) -> Source:
    """Pictures in the layout of that set, without normals."""
    pictures = len(scene_folder.locate(folder).pictures)
    about = "photographs of a room; normals and field of view unknown; light probes are not read"
    return Source(folder.resolve().name, folder, ROOMS, pictures, about)


def _write_room(source: Source, folder: Path) -> None:
    for path in scene_folder.locate(source.folder).pictures:
        shutil.copy(path, folder)
    (folder / "scene.toml").write_text("fov = 60\n", encoding="utf-8")
    add_normals(folder, np.broadcast_to([0.0, 0.0, 1.0], (*picture_size(folder), 3)))


def has_normal(normals: Array) -> Mask:
    """Pixels with a normal that pbrfit does not refuse."""
    length = np.linalg.norm(normals, axis=-1)
    return np.asarray(np.isfinite(length) & (length >= 0.5))


def _write_rest(folder: Path, normals: Array, valid: Mask, settings: str) -> None:
    planes = {name: normals[..., i].astype(np.float32) for i, name in enumerate("XYZ")}
    images.write_exr(folder / "normals.exr", planes)
    images.write_png(folder / "mask.png", np.where(valid, 255, 0).astype(np.uint8), tag=None)
    (folder / "scene.toml").write_text(settings, encoding="utf-8")


VISIONT3LAB = (
    "github.com/visiont3lab/photometric_stereo commit 9ded70dfbbe409dd2e0a2a6946c71c180d47a926, "
    "photostereo_py/samples/{0}.zip; MIT (stated in its README); its .bmp files as {1}0.png ... "
    "{1}7.png"
)

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
            f"{VISIONT3LAB.format('shrek', 'shrek')}, mask.png, normal.png",
            "8 bits; normals estimated by its authors given; camera orthographic",
            "*[0-9].png",
            _shrek_normals,
        ),
        _files(
            "visiont3lab_ball3",
            "rendered glossy ball: 8 pictures under 8 lights, mask; "
            f"{VISIONT3LAB.format('ball3', 'ball')}, mask.png",
            "8 bits; normals of a sphere given; camera taken as orthographic",
            "*[0-9].png",
            _ball_normals,
        ),
        _files(
            "maxcrous_sphere_color",
            "rendered matt brick sphere: 25 pictures under 25 lights; "
            "github.com/maxcrous/photometric-stereo commit "
            "08eb113eca55f28934146d2fd60b589ec8dd0916, photometrics_images/SphereColor; MIT; as "
            "PNG",
            "8 bits, declared linear; normals of a sphere given; camera taken as orthographic",
            "Sphere_*.png",
            _brick_normals,
            'color_space = "linear"\n',
        ),
        PublicSet(
            ROOMS,
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
