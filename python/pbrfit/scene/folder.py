"""The scene folder (docs/formats.md): which files it has, and what `scene.toml` says of them."""

from __future__ import annotations

import logging
import re
import tomllib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io import images
from pbrfit.io.color import ColorSpace
from pbrfit.io.depth_files import DEPTH_FILES, find_depth
from pbrfit.io.input_files import FILE, SETTINGS_BYTES, digest, kind_of, read_text, there
from pbrfit.io.lamp_files import LAMP_FILES, find_lamps
from pbrfit.io.normal_files import NORMAL_FILES, Convention, find_normals
from pbrfit.io.output import FolderForm
from pbrfit.io.quoting import listed, quoted, shown
from pbrfit.io.weight_files import WEIGHT_FILE
from pbrfit.model import geometry
from pbrfit.model.reflection import MODELS, Model
from pbrfit.scene.arrays import FIRST_FOV
from pbrfit.scene.height import HEIGHT_FILE

log = logging.getLogger("pbrfit")

NOT_PICTURES = frozenset({".csv", ".db", ".ini", ".json", ".lp", ".md", ".toml", ".txt", ".xmp"})
"""Suffixes of files that may lie beside pictures."""

MAX_ID = 65535
"""Largest segment id that a picture of 16 bits holds."""

SEGMENT_FILE = "segments.png"

DARK_FRAME = "dark"
"""Name, without its suffix, of a picture of no light, which is subtracted from all pictures."""

RELATIVE, STRENGTHS = "light_intensities", "strengths of lamps are fitted, or in lights.csv"
"""Stem of DiLiGenT's file of the strengths of lamps, whose unit nobody tells, and what to say."""

PARTS = ("mask.png", SEGMENT_FILE, WEIGHT_FILE, "lighting.json", "scene.toml")
"""Files of a scene folder beside pictures, normals, depth and ground truth."""

SCENE_FOLDER = FolderForm(
    contains=("scene.toml", "truth"),
    holds=(
        *("images/*.exr", NORMAL_FILES[0], DEPTH_FILES[0], LAMP_FILES[0], HEIGHT_FILE, *PARTS),
        *(f"truth/{path}" for path in ("materials.exr", "lighting.json")),
        *(f"truth/relight/{path}" for path in ("*.exr", "lighting.json")),
    ),
)
"""Form of a scene folder that may be replaced: ground truth tells it from somebody's pictures."""

_MULTI_ILLUMINATION = re.compile(r"dir_(\d+)_mip(\d+)\.(exr|jpg)")


@dataclass(frozen=True)
class Settings:
    """Keys of `scene.toml`."""

    fov: float | None = None
    """Horizontal field of view in degrees, 0 = orthographic."""
    color_space: ColorSpace | None = None
    """Of all pictures."""
    orientation: images.Orientation | None = None
    """Of all pictures."""
    normals: str = "opengl"
    """Either "opengl" (Y up) or "directx" (Y down)."""
    normals_frame: str = "camera"
    """Either "camera" or "world"."""
    world_to_camera: NDArray[np.float64] | None = None
    """(3, 3) rotation, needed when the frame is "world"."""
    model: Model | None = None
    """The reflection model that the pictures were rendered with, "paper" or "principled"; None
    where neither was, or nobody knows."""

    @property
    def convention(self) -> Convention:
        """How the folder's normals are written down."""
        return Convention(self.normals, self.normals_frame, self.world_to_camera)


def field_of_view(folder: Path, fov: float | None) -> float:
    """Decide about the field of view as `load` does, of the pictures reading only the first.

    Raises InputError or OSError as `load`.
    """
    if fov is not None:
        geometry.check_fov(fov)
    settings = read_settings(folder / "scene.toml")
    first = images.read_picture(
        find_pictures(folder)[0], orientation=settings.orientation or "exif"
    )
    size = first.pixels.shape[:2]
    decided, _ = decided_fov(folder, fov, settings, first.focal_length_35mm, size)
    return FIRST_FOV if decided is None else decided


def find_pictures(folder: Path) -> list[Path]:
    """Pictures of a scene folder, in name order.

    They lie under `images/`, or beside each other as `dir_*_mip*.exr|jpg` (the layout of the MIT
    multi-illumination data; the finest mip level that is there is taken, EXR before JPEG). Raises
    InputError or FileNotFoundError if there is no such folder or no picture in it, or something
    under `images/` that is no file; what is hidden, such as `.DS_Store`, is passed over.
    """
    if not folder.is_dir():
        there = "a file" if folder.exists() else "nothing of that name"
        raise FileNotFoundError(f"{folder}: expected a scene folder, found {there}")
    below = folder / "images"
    if below.is_dir():
        # A format that cannot be read must not be passed over in silence, so all that is not
        # known to be something else counts as a picture.
        seen = [path for path in below.iterdir() if not path.name.startswith(".")]
        for path in seen:
            _check_is_file(path)
        paths = sorted(
            (path for path in seen if path.suffix.lower() not in NOT_PICTURES),
            key=lambda path: path.name,
        )
        if not paths:
            raise InputError(
                f"{below}: expected pictures ({' '.join(images.PICTURE_SUFFIXES)}), found none"
            )
        return paths
    found = [(m, p) for p in folder.iterdir() if (m := _MULTI_ILLUMINATION.fullmatch(p.name))]
    if not found:
        raise InputError(
            f"{folder}: expected pictures under {below.name}/ or files dir_*_mip*.exr|jpg, "
            "found neither"
        )
    best = min((m[3] != "exr", int(m[2])) for m, _ in found)
    chosen = [(int(m[1]), p) for m, p in found if (m[3] != "exr", int(m[2])) == best]
    return [path for _, path in sorted(chosen)]


def _check_is_file(path: Path) -> None:
    """See that something beside pictures is a regular file, or a link to one."""
    try:
        status = path.stat()
    except FileNotFoundError:
        found = "a link to nothing"
    else:
        found = kind_of(status)
    if found != FILE:
        raise InputError(f"{path}: expected only pictures in {path.parent.name}/, found {found}")


def find_dark_frame(folder: Path) -> Path | None:
    """The picture of no light that lies beside `images/` as `dark.*`, whatever its format.

    Raises InputError if there are several.
    """
    found = sorted(
        path
        for path in folder.iterdir()
        if path.stem.lower() == DARK_FRAME
        and path.suffix.lower() not in NOT_PICTURES
        and not path.is_dir()
    )
    if len(found) > 1:
        raise InputError(
            f"{folder}: expected one dark frame, found {listed(path.name for path in found)}"
        )
    return found[0] if found else None


def input_files(folder: Path) -> list[Path]:
    """All files of a scene folder that `load` reads, and so those that its result depends on.

    Raises InputError or FileNotFoundError as `find_pictures`, or if there are two with depth, or
    with lamps, or two dark frames.
    """
    found = [*find_pictures(folder), *find_normals(folder), *(folder / part for part in PARTS)]
    single = (find_depth(folder), find_lamps(folder), find_dark_frame(folder))
    found += [path for path in single if path is not None]
    return [*filter(there, found), *truth_files(folder)]


def digests(folder: Path) -> dict[str, str]:
    """What `load` would put into `Scene.inputs`, without decoding anything.

    Raises InputError or OSError as `input_files`, or if a file cannot be read.
    """
    return {path.relative_to(folder).as_posix(): digest(path) for path in input_files(folder)}


def is_scene(folder: Path) -> bool:
    """Whether a folder looks like one scene (rather than a folder of scenes)."""
    return (folder / "images").is_dir() or any(
        _MULTI_ILLUMINATION.fullmatch(p.name) for p in folder.iterdir()
    )


def warn_of_near_misses(folder: Path) -> None:
    """Say which files look like parts of a scene but are not read: `mask.tif`, `Normals.exr`."""
    parts = (*NORMAL_FILES, *DEPTH_FILES, *LAMP_FILES, *PARTS)
    stems = {Path(part).stem for part in parts} | {"normal", "segment", "weight", RELATIVE}
    for path in sorted((*folder.iterdir(), *(folder / "images").glob(f"{RELATIVE}.*"))):
        if path.is_file() and path.stem.lower() in stems and path.name not in parts:
            expected = f"expected {', '.join(parts)}"
            of_lamps = path.stem.lower() == RELATIVE
            log.warning("%s: not read; %s", path, STRENGTHS if of_lamps else expected)


def read_settings(path: Path) -> Settings:
    """Read `scene.toml`, if it is there.

    Raises InputError if it is not TOML, or has other keys or values; OSError if it cannot be read.
    """
    if not there(path):
        return Settings()
    try:
        content = tomllib.loads(read_text(path, SETTINGS_BYTES, "cp1252"))
    except InputError:
        raise
    except (ValueError, RecursionError) as error:  # numbers beyond reason raise a plain ValueError
        raise InputError(f"{path}: expected TOML, found {shown(error)}") from None
    known = [field.name for field in fields(Settings)]
    unknown = sorted(set(content) - set(known))
    if unknown:
        raise InputError(f"{path}: expected keys {', '.join(known)}, found {shown(unknown[0])}")
    return Settings(
        fov=_fov(path, content),
        color_space=_choice(path, content, "color_space", get_args(ColorSpace), None),
        orientation=_choice(path, content, "orientation", get_args(images.Orientation), None),
        normals=_choice(path, content, "normals", ("opengl", "directx"), "opengl"),
        normals_frame=_choice(path, content, "normals_frame", ("camera", "world"), "camera"),
        world_to_camera=_rotation(path, content),
        model=_choice(path, content, "model", MODELS, None),
    )


def decided_fov(
    folder: Path,
    fov: float | None,
    settings: Settings,
    focal_length: float | None,
    size: tuple[int, ...],
) -> tuple[float | None, str]:
    """In degrees, None where nothing says it, and in words."""
    if fov is not None:
        return fov, f"{fov:g} degrees, asked for"
    if settings.fov is not None:
        return settings.fov, f"{settings.fov:g} degrees, from scene.toml"
    if focal_length is not None:
        fov = geometry.fov_from_focal_length(focal_length, size[0], size[1])
        return fov, f"{fov:.2f} degrees, from EXIF ({focal_length:g} mm equivalent)"
    log.warning(
        "%s: field of view unknown, fitted from %g degrees on (option fov sets it)",
        folder,
        FIRST_FOV,
    )
    return None, f"{FIRST_FOV:g} degrees: neither fov, scene.toml nor EXIF says"


def _fov(path: Path, content: dict[str, Any]) -> float | None:
    value = content.get("fov")
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InputError(f"{path}: fov: expected a number, found {quoted(value)}")
    try:
        geometry.check_fov(value)
    except (InputError, OverflowError) as error:
        raise InputError(f"{path}: {error}") from None
    return float(value)


def _choice(
    path: Path, content: dict[str, Any], key: str, choices: tuple[str, ...], default: Any
) -> Any:
    value = content.get(key, default)
    if value is not default and value not in choices:
        raise InputError(
            f"{path}: {key}: expected one of {', '.join(choices)}, found {quoted(value)}"
        )
    return value


def _rotation(path: Path, content: dict[str, Any]) -> NDArray[np.float64] | None:
    rows = content.get("world_to_camera")
    if rows is None:
        return None
    try:
        rotation = np.array(rows, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        rotation = np.zeros(0)
    if (
        rotation.shape != (3, 3)
        or not (np.abs(rotation) <= 1.01).all()  # beyond, squares may overflow
        or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3)
        or np.linalg.det(rotation) < 0
    ):
        raise InputError(
            f"{path}: world_to_camera: expected a 3 × 3 rotation, found {quoted(rows)}"
        )
    return rotation


def truth_files(folder: Path) -> list[Path]:
    """Files of the ground truth that are there."""
    truth = folder / "truth"
    found = [truth / "materials.exr", truth / "lighting.json", truth / "relight" / "lighting.json"]
    return [*filter(there, found), *sorted((truth / "relight").glob("*.exr"))]
