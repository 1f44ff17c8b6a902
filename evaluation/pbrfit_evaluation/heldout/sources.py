"""Sets of pictures of one view: where they are, how they are read, and what is known of them.

A *source* is a scene folder, perhaps with a `set.json` that says where it comes from and what is
known, or one of the public sets as it was published; `write_scene` makes a scene folder of those.
Objects of photometric stereo benchmarks are scene folders as they are published: DiLiGenT (Shi et
al., "A benchmark dataset and evaluation for non-Lambertian and uncalibrated photometric stereo",
TPAMI 41, 2019), DiLiGenT10² (Ren et al., CVPR 2022), LUCES (Mecca et al., BMVC 2021), Harvard's
(Xiong et al., "From shading to local shape", TPAMI 37, 2015).
"""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pbrfit._core import InputError
from pbrfit.io import images
from pbrfit.io.color import ColorSpace
from pbrfit.io.json_files import UNFIT, expecting, read_json, unfit
from pbrfit.io.normal_files import find_normals
from pbrfit.io.resampling import averaged_channels
from pbrfit.model.geometry import unit
from pbrfit.model.lamps import Lamps
from pbrfit.scene import folder as scene_folder
from pbrfit.scene.completion import add_normals, picture_size
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.arrays import Array, Floats, Mask
from pbrfit_evaluation.jobs import unlogged


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
    private: bool = False
    """Whether its licence lets nothing of it be published."""
    linear: bool = False
    """Whether it says that the values in its files are linear."""


@dataclass(frozen=True)
class PublicSet:
    """A set that can be had from its authors."""

    find: Callable[[Path], list[Source]]
    """Sources in its folder."""
    write: Callable[[Source, Path], None]
    """Writes a source as a scene folder, into a folder that exists and is empty."""


# Bunny: arrays


def _find_arrays(folder: Path) -> list[Source]:
    sources = []
    for path in sorted(folder.glob("*.npz")):
        with np.load(path) as arrays:
            count = len(arrays["images"])
        sources.append(Source(path.stem, folder, folder.resolve().name, count))
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

Normals = Callable[[Path, Sequence[Path]], tuple[Floats, Mask]]
"""Normals of a set and the pixels that have one, from its folder and its pictures."""


def _files(pattern: str, normals: Normals, settings: str = "") -> PublicSet:
    """A set of one source, whose pictures are files."""

    def find(folder: Path) -> list[Source]:
        name = folder.resolve().name
        return [Source(name, folder, name, len(list(folder.glob(pattern))))]

    def write(source: Source, folder: Path) -> None:
        paths = sorted(source.folder.glob(pattern))
        found, valid = normals(source.folder, paths)
        (folder / "images").mkdir()
        for path in paths:
            shutil.copy(path, folder / "images")
        _write_rest(folder, found, valid, f"fov = 0\n{settings}")

    return PublicSet(find, write)


def _shrek_normals(folder: Path, _: Sequence[Path]) -> tuple[Floats, Mask]:
    stored = images.read_data(folder / "normal.png")[..., :3]
    normals = (stored - NORMAL_OFFSET) / NORMAL_SCALE
    return normals, _inside(folder / "mask.png") & has_normal(normals)


def _ball_normals(folder: Path, _: Sequence[Path]) -> tuple[Floats, Mask]:
    path = folder / "mask.png"
    normals, valid = sphere_normals(images.read_data(path)[..., 0] >= 0.5, str(path))
    return normals, valid & _inside(path)


def _brick_normals(folder: Path, paths: Sequence[Path]) -> tuple[Floats, Mask]:
    seen = np.any([images.read_data(path).max(axis=-1) > 0 for path in paths], axis=0)
    return sphere_normals(seen, str(folder))


def _inside(path: Path) -> Mask:
    """Fully white pixels less a border: those on the outline are part background."""
    from scipy.ndimage import binary_erosion

    return np.asarray(binary_erosion(images.read_data(path)[..., 0] == 1.0))


RADIUS_SHARE = 0.98
"""Share of a sphere's radius that is used: pixels further out are part background, and their
normals turn by ten degrees and more within a pixel."""


def sphere_normals(disc: Mask, name: str) -> tuple[Array, Mask]:
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
    return Source(folder.resolve().name, folder, ROOMS, pictures)


def _write_room(source: Source, folder: Path) -> None:
    for path in scene_folder.locate(source.folder).pictures:
        shutil.copy(path, folder)
    (folder / "scene.toml").write_text("fov = 60\n", encoding="utf-8")
    add_normals(folder, np.broadcast_to([0.0, 0.0, 1.0], (*picture_size(folder), 3)))


def has_normal(normals: Floats) -> Mask:
    """Pixels with a normal that pbrfit does not refuse."""
    length = np.linalg.norm(normals, axis=-1)
    return np.asarray(np.isfinite(length) & (length >= 0.5))


def _write_rest(folder: Path, normals: Floats, valid: Mask, settings: str) -> None:
    planes = {name: normals[..., i].astype(np.float32) for i, name in enumerate("XYZ")}
    images.write_exr(folder / "normals.exr", planes)
    images.write_png(folder / "mask.png", np.where(valid, 255, 0).astype(np.uint8), tag=None)
    (folder / "scene.toml").write_text(settings, encoding="utf-8")


SETS: dict[str, PublicSet] = {
    # rendered bunny, glossy and matt: github.com/yasumat/RobustPhotometricStereo, its .npy
    # pictures in one .npz a material, as `images`
    "bunny_ps": PublicSet(_find_arrays, _write_arrays),
    # rendered figure and ball: github.com/visiont3lab/photometric_stereo, .bmp files as .png
    "visiont3lab_shrek": _files("*[0-9].png", _shrek_normals),
    "visiont3lab_ball3": _files("*[0-9].png", _ball_normals),
    # rendered brick sphere: github.com/maxcrous/photometric-stereo, as .png
    "maxcrous_sphere_color": _files("Sphere_*.png", _brick_normals, 'color_space = "linear"\n'),
    # photographs of rooms under a flash (Murmann et al. 2019)
    ROOMS: PublicSet(_find_rooms, _write_room),
}
"""By name of the folder."""


SET, NORMALS = "set.json", ("normals.npz", "Normal_gt.mat", "normals.mat")
"""Of a scene folder, beside what pbrfit reads: what it is, and files of true normals to compare
with, as arrays (H, W, 3)."""

DIRECTIONS, STRENGTHS = ("light_directions.txt", "refined_light.txt"), "light_intensities.txt"
"""Tables of a benchmark's lamps, one a line in the order of the pictures, here or in the folder
above: vectors to them, and strengths of their channels."""

OBJECTS = "Objects"
"""Folder of the pictures in that of one of Harvard's objects, beside those of light probes."""

UNLICENSED = "none stated"
"""How the licence of a set begins of which nothing may be published."""

BRICK_HEIGHT = 1.8
"""Distance along Z of the brick sphere's lamps, whose files tell X and Y alone: the one that
explains the pictures best on the true sphere, to within 0.1."""


@dataclass(frozen=True, eq=False)
class Opened:
    """A source, read."""

    scene: Scene
    """As pbrfit reads it, without true materials, known lighting and lamps."""
    lamps: Lamps | None
    """The far lamps of the pictures, one each, with colours where these are known; None = unknown.
    """
    normals: Array | None
    """(H, W, 3) true ones that the scene is not told, NaN where unknown; None = no such."""


# ------------------------------------------------------------------------------------- finding


def asked_sources(folders: Sequence[Path], environment: Mapping[str, str]) -> list[Source]:
    """All in some folders, by default in that of PBRFIT_DATA.

    Raises FileNotFoundError or InputError as `find_sources`; if there is no folder, or two sources
    have one name: records are kept by it.
    """
    if not folders and environment.get("PBRFIT_DATA"):
        folders = [Path(environment["PBRFIT_DATA"])]
    if not folders:
        raise InputError(
            "FOLDER: expected folders of pictures, found none, and PBRFIT_DATA is not set"
        )
    sources = [source for path in folders for source in find_sources(path.absolute())]
    names = [source.name for source in sources]
    for source in sources:
        if names.count(source.name) > 1:
            raise InputError(
                f"{source.folder}: expected different names, found {source.name} twice"
            )
    return sources


def find_sources(path: Path) -> list[Source]:
    """Sources that a path names: a scene folder, a public set, or a folder that holds such.

    Scene folders with a `set.json` are found one folder further down, too.

    Raises FileNotFoundError or InputError if there is no such folder, or nothing in it that could
    be pictures of one view.
    """
    if not path.is_dir():
        there = "a file" if path.exists() else "nothing of that name"
        raise FileNotFoundError(f"{path}: expected a folder of pictures, found {there}")
    found = _sources_at(path)
    if not found:
        folders = [one for one in sorted(path.iterdir()) if one.is_dir() and one.name[0] != "."]
        for folder in folders:
            found += _sources_at(folder) or [
                source
                for below in sorted(folder.glob(f"*/{SET}"))
                for source in _sources_at(below.parent)
            ]
    if not found:
        raise InputError(
            f"{path}: expected a scene folder, one of {', '.join(SETS)}, or pictures beside "
            f"{', '.join((*DIRECTIONS, *NORMALS))}, found none of them"
        )
    return found


def _sources_at(path: Path) -> list[Source]:
    name = path.resolve().name
    if name in SETS:
        return SETS[name].find(path)
    if (path / OBJECTS).is_dir():
        return [replace(one, name=name) for one in _sources_at(path / OBJECTS)]
    benchmark = path.name == OBJECTS or any(
        (path / one).is_file() for one in (*DIRECTIONS, *NORMALS)
    )
    if not scene_folder.is_scene(path) and not benchmark:
        return []
    if not (path / "images").is_dir() and not find_normals(path) and not benchmark:
        return [room_source(path)]
    said = _said(path)
    licence = str(said.get("licence", ""))
    pictures = len(scene_folder.locate(path).pictures)
    private, linear = licence.startswith(UNLICENSED), said.get("pixels_are_linear") is True
    return [Source(name, path, "scene", pictures, private, linear)]


def _said(folder: Path) -> dict[str, Any]:
    path, expected = folder / SET, "an object"
    content = read_json(path, expected) if path.exists() else {}
    if not isinstance(content, dict):
        raise InputError(f"{path}: expected {expected}, found {type(content).__name__}")
    return content


# ------------------------------------------------------------------------------------- reading


def write_scene(source: Source, folder: Path) -> None:
    """Write a public set as a scene folder, into a folder that exists and is empty."""
    SETS[source.kind].write(source, folder)


@contextmanager
def scene_of(source: Source) -> Iterator[Path]:
    """The scene folder of a source, for a while; rooms stay without normals."""
    if source.kind in ("scene", ROOMS):
        yield source.folder
    else:
        with tempfile.TemporaryDirectory() as folder:
            write_scene(source, Path(folder))
            yield Path(folder)


def opened(
    source: Source, max_size: int, most: int = 1000, color_space: ColorSpace | None = None
) -> Opened:
    """Read a source; of more pictures than `most`, so many, evenly chosen.

    Raises InputError or OSError if a file cannot be used.
    """
    with scene_of(source) as folder, unlogged():
        scene = Scene.load(folder, max_size=max_size, color_space=color_space)
    count = len(scene.images)
    lamps = _lamps(source, scene)
    if lamps is not None and len(lamps) != count:
        raise InputError(
            f"{source.folder}: expected a lamp for each of {count} pictures, found {len(lamps)}"
        )
    some = evenly(count, most)
    return Opened(
        replace(scene, lighting=None, truth=None, lamps=None).of_pictures(some),
        None if lamps is None else lamps.of_pictures(some),
        None if scene.normals_known else _true_normals(source.folder, scene),
    )


def evenly(count: int, most: int) -> list[int]:
    """At most so many of the indices below `count`, evenly chosen, from the first to the last."""
    chosen: list[int] = np.linspace(0, count - 1, min(count, most)).round().astype(int).tolist()
    return chosen


def _true_normals(folder: Path, scene: Scene) -> Array | None:
    """X right, Y up, Z to the viewer; files whose Z points into the picture have Y down as well."""
    path = next((folder / name for name in NORMALS if (folder / name).exists()), None)
    if path is None:
        return None
    expected = "an array (H, W, 3)"
    try:
        if path.suffix == ".npz":
            with np.load(path) as arrays:
                found = [arrays[arrays.files[0]]]
        else:
            from scipy.io import loadmat

            found = [one for one in loadmat(path).values() if np.ndim(one) == 3]
        normals = np.nan_to_num(np.asarray(found[0], np.float64))
    except (IndexError, NotImplementedError, *UNFIT) as error:
        raise unfit(path, expected, error) from None
    if normals.ndim != 3 or normals.shape[2] != 3:
        raise InputError(f"{path}: expected {expected}, found {normals.shape}")
    if normals[..., 2].sum() < 0:
        normals = normals * [1.0, -1.0, -1.0]
    normals = averaged_channels(normals, (scene.height, scene.width))
    with np.errstate(invalid="ignore"):
        return np.where(scene.valid[..., None], unit(normals), np.nan)


def _lamps(source: Source, scene: Scene) -> Lamps | None:
    """As of `Opened`, of all pictures."""
    folder, said = source.folder, _said(source.folder)
    if said.get("directions"):
        with expecting(folder / SET, "directions and colors (N, 3)"):
            return _far(said["directions"], said.get("colors"))
    for path in (above / name for above in (folder, folder.parent) for name in DIRECTIONS):
        if path.is_file():
            strengths = path.with_name(STRENGTHS)
            return _far(_table(path), _table(strengths) if strengths.is_file() else None)
    if source.kind == "bunny_ps":
        with np.load(folder / f"{source.name}.npz") as arrays:
            lengths = np.linalg.norm(arrays["lights"], axis=-1, keepdims=True)
            return _far(arrays["lights"], np.repeat(lengths, 3, axis=-1))
    if source.kind.startswith("visiont3lab"):
        # As OpenCV writes it: its longest list of numbers.
        text = (folder / "LightMatrix.yml").read_text(encoding="utf-8")
        numbers = max(re.findall(r"\[([^\]]*)\]", text), key=len).split(",")
        return _far(np.array(numbers, np.float64).reshape(-1, 3))
    if source.kind == "maxcrous_sphere_color":  # Sphere_X_Y
        return _far([[*map(float, name.split("_")[1:]), BRICK_HEIGHT] for name in scene.names])
    lamps = scene.lamps
    if lamps is None or lamps.near.any() or len(lamps) != len(scene.images):
        return None
    return lamps


def _far(vectors: Any, colors: Any = None) -> Lamps:
    """Lamps along vectors (N, 3), one a picture; ValueError or InputError if they are none."""
    places = unit(np.asarray(vectors, np.float64).reshape(-1, 3))
    return Lamps(np.arange(len(places)), places, colors=colors)


def _table(path: Path) -> Array:
    """(N, 3) numbers of a text file."""
    with expecting(path, "three numbers a line"):
        return np.loadtxt(path, ndmin=2)[:, -3:]
