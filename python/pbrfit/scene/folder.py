"""The scene folder (docs/formats.md): which files it has, and what `scene.toml` says of them."""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TypeVar

from pbrfit._core import InputError
from pbrfit.io import images
from pbrfit.io.depth_files import DEPTH_FILES, find_depth
from pbrfit.io.input_files import LIST_BYTES, SETTINGS_BYTES, digest, kind_of, read_text, there
from pbrfit.io.json_files import UNFIT, read_json, text, toml_of, unfit
from pbrfit.io.lamp_files import LAMP_FILES, find_lamps
from pbrfit.io.normal_files import NORMAL_FILES, find_normals
from pbrfit.io.output import FolderForm
from pbrfit.io.raw_files import RAW_SUFFIXES
from pbrfit.io.weight_files import WEIGHT_FILE
from pbrfit.model.estimates import ESTIMATES_FILE
from pbrfit.scene.options import Settings
from pbrfit.values.quoting import listed, shown

log = logging.getLogger("pbrfit")

NOT_PICTURES = {".csv", ".db", ".ini", ".json", ".lp", ".md", ".relight", ".toml", ".txt", ".xmp"}
"""Suffixes of files that may lie beside pictures."""

MAX_ID = 65535
"""Largest segment id that a picture of 16 bits holds."""

SEGMENT_FILE = "segments.png"

HEIGHT_FILE = "height.exr"
"""Channels Y, in pixels towards the viewer, and mask.Y, 1 = known."""

DARK_FRAME, FLAT_FIELD = "dark", "flat"
"""Names, without suffix, of a picture of no light, which is subtracted from all pictures, and of
one of an even white surface, by which they are divided; the latter may be a folder of such."""

LISTING = "filenames.txt"
"""A file, such as DiLiGenT has, that names the pictures beside it, one a line."""

DIRECTIONS = "light_directions.txt"
"""DiLiGenT's file of the directions of lamps."""

RELATIVE, STRENGTHS = "light_intensities", "strengths of lamps are fitted, or in lights.csv"
"""Stem of DiLiGenT's file of the strengths of lamps, whose unit nobody tells, and what to say."""

PARTS = (*("mask.png", SEGMENT_FILE, WEIGHT_FILE, ESTIMATES_FILE, "lighting.json", "scene.toml"),)
"""Files of a scene folder beside pictures, normals, depth and ground truth."""

_EVERY_PART = (*NORMAL_FILES, *DEPTH_FILES, *LAMP_FILES, *PARTS)
_STEMS = {Path(part).stem for part in _EVERY_PART}

_TRUE_LIGHTS = {"images": "truth/lighting.json", "truth/relight": "truth/relight/lighting.json"}
"""Ground truth that names the pictures of a folder."""


def _pictures_of(folder: Path) -> list[str]:
    """Files of the pictures that ground truth names; none where it cannot be read."""
    found = []
    for below, lights in _TRUE_LIGHTS.items():
        with suppress(OSError, *UNFIT):
            names = read_json(folder / lights, "lights")["pictures"]
            found += [f"{below}/{text(name)}.exr" for name in names]
    return found


SCENE_FOLDER = FolderForm(
    contains=("scene.toml", "truth"),
    holds=(
        *(NORMAL_FILES[0], DEPTH_FILES[0], LAMP_FILES[0], HEIGHT_FILE, *PARTS),
        *("truth/materials.exr", *_TRUE_LIGHTS.values()),
    ),
    listed=_pictures_of,
)
"""Form of a scene folder that may be replaced: ground truth tells it from somebody's pictures."""

OUTPUTS = ("result.json", "summary.json")
"""Files of folders whose pictures are results."""

_NO_PICTURES = {Path(part).stem for part in (*NORMAL_FILES, *DEPTH_FILES, *PARTS)} | {
    *("normal", "normal_gt", "normals_gt", "depth_gt", "segment", "weight", "height", "materials"),
    *(DARK_FRAME, FLAT_FIELD, "preview", "normals_preview", "review"),
}
"""Stems, in lower case, of files that are no pictures: parts, true maps, what commands write."""

_MAP = re.compile(r"(.*[\W_])?(mask|normal|depth)s?[\W_]*\d*\W*", re.IGNORECASE)
"""Stems as renderers and other programs give them to maps: `Normal0001`, `IMG_7_mask`."""

_LOOSE_SUFFIXES = {*images.PICTURE_SUFFIXES, *RAW_SUFFIXES} | {
    *(".avif", ".bmp", ".gif", ".heic", ".heif", ".webp")
}
"""In lower case, of files that are taken for pictures where these lie beside other files."""

_MULTI_ILLUMINATION = re.compile(r"dir_(\d+)_mip(\d+)\.(exr|jpg)")

ScenePath = str | Path | Sequence[str | Path]
"""A scene folder, or the files of pictures that are named one by one."""

Found = TypeVar("Found")


@dataclass(frozen=True)
class SceneFiles:
    """The pictures of a scene, and whose other files are its parts."""

    folder: Path
    pictures: tuple[Path, ...]
    said: str = ""
    """Which files were taken for pictures, where that is not plain; else empty."""
    named: bool = False
    """Whether the pictures were named one by one."""
    listed: bool = False
    """Whether they are in the order of a listing."""
    parts: bool = True
    """Whether other files of the folder belong to the pictures."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of the pictures: those of their files, or pages of these, without suffix."""
        return tuple(path.stem for path in self.pictures)

    def find(self, finder: Callable[[Path], Found]) -> Found | None:
        """What a function finds in the folder; None where no other file belongs to the pictures."""
        return finder(self.folder) if self.parts else None

    def relative(self, path: Path) -> str:
        """A file, or that of a page, as seen from the folder."""
        return images.file_of(path).relative_to(self.folder).as_posix()

    def settings(self) -> Settings:
        """What `scene.toml` says; raises InputError or OSError as `read_settings`.

        Pictures that are listed beside the directions of their lamps are linear, as DiLiGenT's are.
        """
        found = read_settings(self.folder / "scene.toml") if self.parts else Settings()
        if self.listed and found.color_space is None and there(self.folder / DIRECTIONS):
            return replace(found, color_space="linear")
        return found


def locate(scene: ScenePath) -> SceneFiles:
    """Find the pictures of a scene.

    In a folder they lie under `images/`, or beside each other: those that `filenames.txt` lists (as
    in DiLiGenT), else `dir_*_mip*.exr|jpg` (the multi-illumination data of MIT; of these the finest
    mip level, EXR before JPEG), else all with the suffix of a picture and the name of no part. They
    are in the order of the listing, else of their names. Pages of stacks are pictures.

    Raises InputError or FileNotFoundError if there is no such folder or no picture in it, or
    something under `images/` that is no file; what is hidden, such as `.DS_Store`, is passed over.
    """
    if not isinstance(scene, (str, Path)):
        return _named(tuple(map(Path, scene)))
    folder = Path(scene)
    if not folder.is_dir():
        found = "a file" if folder.exists() else "nothing of that name"
        raise FileNotFoundError(f"{folder}: expected a scene folder, found {found}")
    below = folder / "images"
    below = below if below.is_dir() else folder
    if there(below / LISTING):
        return _listed(folder, below)
    if below != folder:
        return SceneFiles(folder, tuple(_all_in(below)))
    rooms = [(m, p) for p in folder.iterdir() if (m := _MULTI_ILLUMINATION.fullmatch(p.name))]
    if rooms:
        best = min((m[3] != "exr", int(m[2])) for m, _ in rooms)
        chosen = [(int(m[1]), p) for m, p in rooms if (m[3] != "exr", int(m[2])) == best]
        said = f"{len(chosen)} of {len(rooms)} files dir_*_mip*.exr|jpg: the finest level"
        return SceneFiles(folder, tuple(path for _, path in sorted(chosen)), said)
    loose = loose_pictures(folder)
    if not loose:
        raise InputError(
            f"{folder}: expected pictures under images/ or beside each other, found neither"
        )
    return SceneFiles(folder, tuple(loose), f"those of the folder itself, {first_and_last(loose)}")


def _named(pictures: tuple[Path, ...]) -> SceneFiles:
    """Pictures that are named one by one."""
    for path in pictures:
        if not path.is_file():
            raise FileNotFoundError(
                f"{path}: expected a picture, found {'a folder' if path.is_dir() else 'no file'}"
            )
    folders = {path.absolute().parent for path in pictures}
    if not folders:
        raise InputError("scene: expected a folder or pictures, found none")
    if len(folders) > 1:
        above = Path(os.path.commonpath(folders))
        said = f"{len(pictures)} files of {len(folders)} folders, without other parts of a scene"
        return SceneFiles(above, tuple(map(Path.absolute, pictures)), said, named=True, parts=False)
    below = pictures[0].parent
    folder = below.parent if below.name == "images" else below
    taken = tuple(below / path.name for path in pictures)
    return SceneFiles(folder, taken, f"{len(taken)} files that were named", named=True)


def _listed(folder: Path, below: Path) -> SceneFiles:
    """Pictures that a listing names, in its order."""
    listing = below / LISTING
    names = [line.strip() for line in read_text(listing, LIST_BYTES, "cp1252").splitlines()]
    pictures = tuple(below / name for name in names if name)
    missing = next((p.name for p in pictures if p.parent != below or not p.is_file()), None)
    if missing is not None or not pictures:
        found = "none" if missing is None else f"{shown(missing)}, which is none"
        raise InputError(f"{listing}: expected names of pictures beside it, found {found}")
    others = len(set(loose_pictures(below)) - set(pictures))
    said = f"the {len(pictures)} that {LISTING} lists" + f"; {others} more left out" * bool(others)
    if there(folder / DIRECTIONS):
        said += "; linear, as beside directions of lamps, unless told otherwise"
    return SceneFiles(folder, pictures, said, listed=True)


def _all_in(below: Path) -> list[Path]:
    """The pictures under `images/`.

    No format may be passed over in silence: what is not known to be something else is a picture.
    """
    paths = []
    for path in sorted(path for path in below.iterdir() if not path.name.startswith(".")):
        if not path.is_file():
            found = kind_of(path.stat()) if path.exists() else "a link to nothing"
            raise InputError(f"{path}: expected only pictures in {below.name}/, found {found}")
        paths += images.pages(path) if path.suffix.lower() not in NOT_PICTURES else []
    if not paths:
        suffixes = " ".join(images.PICTURE_SUFFIXES)
        raise InputError(f"{below}: expected pictures ({suffixes}), found none")
    if maps := set(paths) - set(_without_maps(paths)):
        found = f"{listed(path.name for path in maps)}: a map belongs beside {below.name}/"
        raise InputError(f"{below}: expected only pictures, found {found}")
    return paths


def _without_maps(paths: list[Path]) -> list[Path]:
    """Files that are not called maps, or all if they are: pictures may be of masks."""
    return [path for path in paths if not _MAP.fullmatch(path.stem)] or paths


def loose_pictures(folder: Path) -> list[Path]:
    """Files of a folder that look like photographs of a scene, in name order.

    Parts of a scene, maps and what is in a result are none. Formats that are not read count.
    """
    if any((folder / name).exists() for name in OUTPUTS):
        return []
    found = sorted(path for path in folder.iterdir() if _loose(path) and not path.is_dir())
    return _without_maps(found)


def _loose(path: Path) -> bool:
    """Whether a file would be taken for a picture beside others."""
    suffix, stem = path.suffix.lower(), path.stem.lower()
    return suffix in _LOOSE_SUFFIXES and stem not in _NO_PICTURES and path.name[0] != "."


def check_unread(scenes: Iterable[Path], outputs: Iterable[Path]) -> None:
    """Check that nothing at these places would be read as a part of a scene folder.

    Raises InputError: what lies under `images/` and beside loose pictures belongs to the scene.
    """
    folders = {path.resolve() for path in scenes}
    within = {folder / name for folder in folders for name in ("images", FLAT_FIELD, "truth")}
    for output in outputs:
        path = output.resolve()
        loose = _loose(path) and not (path.parent / "images").is_dir()
        part = path.parent in folders and (loose or path.stem in _STEMS)
        if part or not within.isdisjoint((path, *path.parents)):
            expected = "expected a place that is not read with the pictures of the scene"
            raise InputError(f"{output}: {expected}, found one in {path.parent}")


def first_and_last(paths: Sequence[Path]) -> str:
    """The first and the last of some files in words, and how many there are."""
    first, *others = (path.name for path in paths)
    return f"{first} to {others[-1]} ({len(paths)})" if others else first


def find_frame(folder: Path, name: str) -> Path | None:
    """The picture that lies in a folder under a name, whatever its format.

    Raises InputError if there are several.
    """
    called = (path for path in folder.iterdir() if path.stem.lower() == name)
    pictures = (path for path in called if path.suffix.lower() not in NOT_PICTURES)
    found = sorted(path for path in pictures if not path.is_dir())
    if len(found) > 1:
        every = listed(path.name for path in found)
        raise InputError(f"{folder}: expected one picture {name}.*, found {every}")
    return found[0] if found else None


def find_flats(folder: Path) -> list[Path]:
    """The flat-field frames of a folder: `flat.*` alone, or those under `flat/`.

    Raises InputError if there are both, or several `flat.*`.
    """
    one, below = find_frame(folder, FLAT_FIELD), folder / FLAT_FIELD
    if not below.is_dir():
        return [] if one is None else [one]
    if one is not None:
        raise InputError(f"{folder}: expected {one.name} or {FLAT_FIELD}/, found both")
    return _all_in(below)


def digests(
    scene: ScenePath | SceneFiles, known: Mapping[str, str] | None = None
) -> dict[str, str]:
    """What `load` puts into `Scene.inputs`, without decoding anything; some may be `known`.

    Raises InputError or OSError as `locate`, or if a file cannot be read, or there are two with
    depth, or with lamps, or two dark frames.
    """
    files = scene if isinstance(scene, SceneFiles) else locate(scene)
    folder, known = files.folder, known or {}
    found = list(dict.fromkeys(map(images.file_of, files.pictures)))
    if files.parts:
        found += [*find_normals(folder), *(folder / part for part in PARTS), *find_flats(folder)]
        single = (find_depth(folder), find_frame(folder, DARK_FRAME))
        found += [*find_lamps(folder), *filter(None, single), *truth_files(folder)]
    named = {files.relative(path): path for path in filter(there, found)}
    return {name: known.get(name) or digest(path) for name, path in sorted(named.items())}


def is_scene(folder: Path) -> bool:
    """Whether a folder says that it is one scene, by the places or the names of its pictures."""
    return (folder / "images").is_dir() or any(
        _MULTI_ILLUMINATION.fullmatch(p.name) or p.name == LISTING for p in folder.iterdir()
    )


def warn_of_near_misses(files: SceneFiles) -> None:
    """Say what looks like a part of a scene but is not read: `mask.tif`, `lights.csv.txt`."""
    stems = {stem.rstrip("s") for stem in (*_STEMS, RELATIVE, "lamps", "light_positions")}
    pictures = set(map(images.file_of, files.pictures))
    beside = (files.folder / "images").glob(f"{RELATIVE}.*")
    for path in sorted({*files.folder.iterdir(), *beside} - pictures):
        name, *suffixes = path.name.lower().split(".")
        known = path.name in _EVERY_PART or path.suffix.lower() in (".lp", ".relight")
        named = re.sub(r"[\W_]*\d*\W*$", "", name).rstrip("s") in stems or "lp" in suffixes[:-1]
        if name and not known and ((named and path.is_file()) or _MAP.fullmatch(path.stem)):
            expected = f"expected {', '.join(_EVERY_PART)}"
            log.warning("%s: not read; %s", path, STRENGTHS if name == RELATIVE else expected)


def read_settings(path: Path) -> Settings:
    """Read `scene.toml`, if it is there.

    Raises InputError if it is not TOML, or has other keys or values; OSError if it cannot be read.
    """
    if not there(path):
        return Settings()
    content = toml_of(path, read_text(path, SETTINGS_BYTES, "cp1252"))
    known = [field.name for field in fields(Settings)]
    unknown = sorted(set(content) - set(known))
    if unknown:
        raise InputError(f"{path}: expected keys {', '.join(known)}, found {shown(unknown[0])}")
    try:
        return Settings.from_json(content)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except UNFIT as error:
        raise unfit(path, "settings of a scene", error) from None


def truth_files(folder: Path) -> list[Path]:
    """Files of the ground truth that are there."""
    truth = folder / "truth"
    found = [truth / "materials.exr", truth / "lighting.json", truth / "relight" / "lighting.json"]
    return [*filter(there, found), *sorted((truth / "relight").glob("*.exr"))]
