"""The scene folder: found, read and written (docs/formats.md describes it)."""

from __future__ import annotations

import logging
import re
import tomllib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io import images
from pbrfit.io.color import ColorSpace
from pbrfit.io.normal_files import (
    NORMAL_FILES,
    UNCERTAINTY,
    Convention,
    find_normals,
    read_normals,
    read_uncertainty,
    write_normals,
)
from pbrfit.io.output import digest, new_folder
from pbrfit.io.quoting import quoted, shown
from pbrfit.io.resampling import at_centres, averaged, reduced_size
from pbrfit.io.weight_files import WEIGHT_FILE, read_weights, reduced, write_weights
from pbrfit.model import geometry
from pbrfit.model.lighting import Lighting
from pbrfit.model.materials import read_materials, write_materials
from pbrfit.model.reflection import MODELS, Model
from pbrfit.scene.arrays import MIN_NORMAL_LENGTH, SceneArrays, Source, Truth, unit_normals
from pbrfit.scene.segments import consecutive_labels

log = logging.getLogger("pbrfit")

AnyScene = TypeVar("AnyScene", bound=SceneArrays)

DEFAULT_FOV = 60.0

CONTAINS = ("scene.toml", "truth")
"""What a scene folder must hold to be replaced: ground truth tells it from somebody's pictures."""

NOT_PICTURES = frozenset({".csv", ".db", ".ini", ".json", ".md", ".toml", ".txt", ".xmp"})
"""Suffixes of files that may lie beside pictures."""

HOW_TO_GET_NORMALS = (
    "normals.exr or normals.png (camera space, X right, Y up, Z to the viewer) from a renderer or "
    "a normal estimator such as Marigold (`pbrfit normals SCENE --from marigold`), or flat ones "
    "(`--from flat`)"
)

MAX_ID = 65535
"""Of a segment, as a picture of 16 bits holds it."""

LONGEST_NAME = 250
"""Bytes of a picture's name without its suffix; file systems take 255 with it."""

_MULTI_ILLUMINATION = re.compile(r"dir_(\d+)_mip(\d+)\.(exr|jpg)")


@dataclass(frozen=True)
class Settings:
    """Keys of `scene.toml`.

    Attributes
    ----------
    fov
        Horizontal field of view in degrees, 0 = orthographic.
    color_space
        Of all pictures.
    normals
        "opengl" (Y up) or "directx" (Y down).
    normals_frame
        "camera" or "world".
    world_to_camera
        (3, 3) rotation, needed when the frame is "world".
    model
        The reflection model that the pictures were rendered with, "paper" or "principled"; None
        where neither was, or nobody knows.
    """

    fov: float | None = None
    color_space: ColorSpace | None = None
    normals: str = "opengl"
    normals_frame: str = "camera"
    world_to_camera: NDArray[np.float64] | None = None
    model: Model | None = None

    @property
    def convention(self) -> Convention:
        """How the folder's normals are written down."""
        return Convention(self.normals, self.normals_frame, self.world_to_camera)


def load(
    folder: Path,
    kind: type[AnyScene],
    *,
    fov: float | None = None,
    color_space: ColorSpace | None = None,
    max_size: int | None = None,
    code_range: tuple[int, int] = images.CODE_RANGE,
) -> AnyScene:
    """Read a scene folder as a scene of some class; see `Scene.load`."""
    source = Source(folder.resolve(), color_space, max_size, code_range, fov)
    if max_size is not None and max_size < 1:
        raise InputError(f"max_size: expected at least 1 pixel, found {max_size}")
    paths = find_pictures(folder)
    _warn_of_near_misses(folder)
    inputs: dict[str, str] = {}
    assumed: dict[str, str] = {}
    settings = read_settings(folder / "scene.toml", inputs)
    if fov is not None:
        geometry.check_fov(fov)
    names = tuple(path.stem for path in paths)
    for path in paths:
        try:
            path.name.encode()
        except UnicodeEncodeError:
            raise InputError(
                f"{path.parent}: expected file names in UTF-8, found {path.name!r}"
            ) from None
    if len(set(names)) != len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"{paths[0].parent}: expected one picture a name, found {twice} twice")

    read = _read_pictures(
        paths, folder, color_space or settings.color_space, max_size, code_range, inputs, assumed
    )
    # From here on every map must have the size that the pictures have on disk.
    mask = read.mask
    full_size, size = mask.shape, read.pixels.shape[1:3]
    if full_size != size:
        assumed["size"] = (
            f"averaged down from {full_size[1]} × {full_size[0]} to {size[1]} × {size[0]} pixels"
        )
    mask &= _read_mask(folder / "mask.png", full_size, inputs)
    if not mask.any():
        raise InputError(f"{folder}: expected pixels both opaque and white in mask.png, found none")
    normals, sigma = _read_normals(folder, settings, mask, inputs, assumed)
    segments = _read_segments(folder / "segments.png", full_size, inputs)
    if full_size != size:
        if sigma is not None:
            # Errors of neighbouring normals are much alike, so their mean is no more certain.
            sigma = averaged(np.where(mask, sigma, 0.0), size).astype(np.float32)
        normals, mask, segments = _averaged(normals, mask, segments, size)
    weights = _exposure_weights(read, mask, paths, code_range, assumed)
    given = _read_weights(folder / WEIGHT_FILE, names, mask, full_size, inputs, assumed)
    if given is not None:
        weights = given if weights is None else weights * given

    lighting = None
    lighting_path = folder / "lighting.json"
    if lighting_path.exists():
        lighting = Lighting.load(lighting_path).of(names, lighting_path)
        inputs["lighting.json"] = digest(lighting_path)
        assumed["lighting"] = "known, from lighting.json"

    fov, assumed["fov"] = _decided_fov(folder, fov, settings, read.focal_length, full_size)

    if settings.model is not None:
        assumed["model"] = f"{settings.model}, with which the pictures were rendered (scene.toml)"

    truth = _read_truth(folder / "truth", names, size)
    for path in _truth_files(folder):
        inputs[path.relative_to(folder).as_posix()] = digest(path)
    try:
        return kind(
            images=read.pixels,
            normals=normals,
            fov=fov,
            mask=mask,
            segments=segments,
            lighting=lighting,
            weights=weights,
            normal_sigma=sigma,
            names=names,
            truth=truth,
            assumed=assumed,
            inputs=dict(sorted(inputs.items())),
            source=source,
            model=settings.model,
        )
    except InputError as error:
        raise InputError(f"{folder}: {error}") from None


def save(scene: SceneArrays, path: Path, *, overwrite: bool = False) -> None:
    """Write a scene folder; see `Scene.save`."""
    with new_folder(path, overwrite=overwrite, contains=CONTAINS) as folder:
        (folder / "images").mkdir()
        for name, image in zip(scene.names, scene.images, strict=True):
            _write_picture(folder / "images" / f"{name}.exr", image)
        normals = np.where(scene.valid[..., None], scene.normals, 0.0).astype(np.float32)
        sigma = scene.normal_sigma
        uncertainty = None if sigma is None else np.where(scene.valid, sigma, np.float32(0))
        write_normals(folder / "normals.exr", normals, uncertainty)
        model = "" if scene.model is None else f'model = "{scene.model}"\n'
        (folder / "scene.toml").write_text(f"fov = {float(scene.fov)!r}\n{model}", encoding="utf-8")
        if not scene.valid.all():
            images.write_png(
                folder / "mask.png", np.where(scene.valid, 255, 0).astype(np.uint8), tag=None
            )
        if scene.weights is not None:
            write_weights(folder / WEIGHT_FILE, scene.weights, scene.names)
        if scene.segments is not None:
            images.write_png(folder / "segments.png", _ids(scene.segments), tag=None)
        if scene.lighting is not None:
            Lighting(scene.names, scene.lighting).save(folder / "lighting.json")
        if scene.truth is not None:
            _write_truth(scene.truth, scene, folder / "truth")


def field_of_view(folder: Path, fov: float | None) -> float:
    """Decide about the field of view as `load` does, of the pictures reading only the first.

    Raises
    ------
    InputError, OSError
        As `load`.
    """
    if fov is not None:
        geometry.check_fov(fov)
    settings = read_settings(folder / "scene.toml", {})
    first = images.read_picture(find_pictures(folder)[0])
    size = first.pixels.shape[:2]
    return _decided_fov(folder, fov, settings, first.focal_length_35mm, size)[0]


def find_pictures(folder: Path) -> list[Path]:
    """Pictures of a scene folder, in name order.

    They lie under `images/`, or beside each other as `dir_*_mip*.exr|jpg` (the layout of the MIT
    multi-illumination data; the finest mip level that is there is taken, EXR before JPEG).

    Raises
    ------
    InputError, FileNotFoundError
        If there is no such folder or no picture in it.
    """
    if not folder.is_dir():
        there = "a file" if folder.exists() else "nothing of that name"
        raise FileNotFoundError(f"{folder}: expected a scene folder, found {there}")
    below = folder / "images"
    if below.is_dir():
        # A format that cannot be read must not be passed over in silence, so all that is not
        # known to be something else counts as a picture.
        paths = sorted(
            (
                path
                for path in below.iterdir()
                if path.is_file()
                and not path.name.startswith(".")
                and path.suffix.lower() not in NOT_PICTURES
            ),
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


def input_files(folder: Path) -> list[Path]:
    """All files of a scene folder that `load` reads, and so those that its result depends on.

    Raises
    ------
    InputError, FileNotFoundError
        As `find_pictures`.
    """
    parts = ("scene.toml", "mask.png", "segments.png", WEIGHT_FILE, "lighting.json")
    found = [*find_pictures(folder), *find_normals(folder), *(folder / part for part in parts)]
    return [*(path for path in found if path.exists()), *_truth_files(folder)]


def digests(folder: Path) -> dict[str, str]:
    """What `load` would put into `Scene.inputs`, without decoding anything.

    Raises
    ------
    InputError, OSError
        As `input_files`, or if a file cannot be read.
    """
    return {path.relative_to(folder).as_posix(): digest(path) for path in input_files(folder)}


def is_scene(folder: Path) -> bool:
    """Whether a folder looks like one scene (rather than a folder of scenes)."""
    return (folder / "images").is_dir() or any(
        _MULTI_ILLUMINATION.fullmatch(p.name) for p in folder.iterdir()
    )


def _warn_of_near_misses(folder: Path) -> None:
    """Say which files look like parts of a scene but are not read: `mask.tif`, `Normals.exr`."""
    parts = (
        *NORMAL_FILES,
        "mask.png",
        "segments.png",
        WEIGHT_FILE,
        "lighting.json",
        "scene.toml",
    )
    stems = {Path(part).stem for part in parts} | {"normal", "segment", "weight"}
    for path in sorted(folder.iterdir()):
        if path.is_file() and path.stem.lower() in stems and path.name not in parts:
            log.warning("%s: not read; expected %s", path, ", ".join(parts))


def read_settings(path: Path, inputs: dict[str, str]) -> Settings:
    """Read `scene.toml`, if it is there; `inputs` gets its sha256.

    Raises
    ------
    InputError
        If it is not TOML, or has other keys or values.
    """
    if not path.exists():
        return Settings()
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:  # numbers beyond reason raise a plain ValueError
        raise InputError(f"{path}: expected TOML, found {shown(error)}") from None
    known = [field.name for field in fields(Settings)]
    unknown = sorted(set(content) - set(known))
    if unknown:
        raise InputError(f"{path}: expected keys {', '.join(known)}, found {shown(unknown[0])}")
    inputs["scene.toml"] = digest(path)
    return Settings(
        fov=_fov(path, content),
        color_space=_choice(path, content, "color_space", get_args(ColorSpace), None),
        normals=_choice(path, content, "normals", ("opengl", "directx"), "opengl"),
        normals_frame=_choice(path, content, "normals_frame", ("camera", "world"), "camera"),
        world_to_camera=_rotation(path, content),
        model=_choice(path, content, "model", MODELS, None),
    )


def _decided_fov(
    folder: Path,
    fov: float | None,
    settings: Settings,
    focal_length: float | None,
    size: tuple[int, ...],
) -> tuple[float, str]:
    """In degrees, and in words."""
    if fov is not None:
        return fov, f"{fov:g} degrees, asked for"
    if settings.fov is not None:
        return settings.fov, f"{settings.fov:g} degrees, from scene.toml"
    if focal_length is not None:
        fov = geometry.fov_from_focal_length(focal_length, size[0], size[1])
        return fov, f"{fov:.2f} degrees, from EXIF ({focal_length:g} mm equivalent)"
    log.warning(
        "%s: field of view unknown, assumed %g degrees (--fov sets it)", folder, DEFAULT_FOV
    )
    return DEFAULT_FOV, f"{DEFAULT_FOV:g} degrees: neither --fov, scene.toml nor EXIF says"


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


@dataclass
class _Pictures:
    """All pictures of a scene folder.

    Attributes
    ----------
    pixels
        (N, H, W, 3) at the working size.
    clipped, dark
        (N, H, W), bool: samples with a part in what is too bright or too dark for its file.
    mask
        What alpha leaves, at the files' size.
    focal_length
        Of the first picture that has one, 35 mm equivalent, millimetres.
    """

    pixels: NDArray[np.float32]
    clipped: NDArray[np.bool_]
    dark: NDArray[np.bool_]
    mask: NDArray[np.bool_]
    focal_length: float | None = None


def _read_pictures(
    paths: list[Path],
    folder: Path,
    color_space: ColorSpace | None,
    max_size: int | None,
    code_range: tuple[int, int],
    inputs: dict[str, str],
    assumed: dict[str, str],
) -> _Pictures:
    read: _Pictures | None = None
    colors: dict[str, list[str]] = {}
    for i, path in enumerate(paths):
        picture = images.read_picture(path, color_space, code_range=code_range)
        full_size = picture.pixels.shape[:2]
        if read is None:
            size = full_size if max_size is None else reduced_size(full_size, max_size)
            samples = (len(paths), *size)
            read = _Pictures(
                pixels=np.empty((*samples, 3), dtype=np.float32),
                clipped=np.empty(samples, dtype=bool),
                dark=np.empty(samples, dtype=bool),
                mask=np.ones(full_size, dtype=bool),
            )
        if full_size != read.mask.shape:
            height, width = read.mask.shape
            raise InputError(
                f"{path}: expected the size of {paths[0].name}, "
                f"{width} × {height} pixels, found {full_size[1]} × {full_size[0]}"
            )
        if size == full_size:
            read.pixels[i] = picture.pixels
        else:
            for c in range(3):
                read.pixels[i, ..., c] = averaged(picture.pixels[..., c], size)
        read.clipped[i] = _touched(picture.clipped, size)
        read.dark[i] = _touched(picture.dark, size)
        if picture.alpha is not None:
            read.mask &= picture.alpha >= 0.5
        read.focal_length = read.focal_length or picture.focal_length_35mm
        colors.setdefault(picture.color, []).append(path.name)
        inputs[path.relative_to(folder).as_posix()] = picture.sha256
    assert read is not None
    for color, names in colors.items():
        assumed["color" if len(colors) == 1 else f"color of {', '.join(names)}"] = color
    if not read.mask.any():
        raise InputError(f"{paths[0].parent}: expected opaque pixels, found alpha below 0.5 in all")
    if not read.mask.all():
        assumed["alpha"] = f"{np.count_nonzero(~read.mask)} transparent pixels left out"
    return read


def _exposure_weights(
    read: _Pictures,
    mask: NDArray[np.bool_],
    paths: list[Path],
    code_range: tuple[int, int],
    assumed: dict[str, str],
) -> NDArray[np.float32] | None:
    """(N, H, W), 0 where a sample of the mask is clipped or dark; None if none is."""
    clipped, dark = read.clipped & mask, read.dark & mask
    left_out = clipped | dark
    if not left_out.any():
        return None
    low, high = code_range
    for path, of_picture in zip(paths, left_out, strict=True):
        if np.array_equal(of_picture, mask):
            raise InputError(
                f"{path}: expected some pixel of the mask with codes from {low} to {high} of 255, "
                "found all clipped or dark; --code-range 0,255 keeps them"
            )
    samples = np.count_nonzero(mask) * len(paths)
    causes = [
        f"{100 * np.count_nonzero(samples_of) / samples:.2g} % {cause}"
        for samples_of, cause in (
            (clipped, f"with a channel above code {high} of 255"),
            (dark, f"with all channels below {low}"),
        )
        if samples_of.any()
    ]
    assumed["exposure"] = f"samples left out: {', '.join(causes)}"
    pixels = np.count_nonzero(left_out.all(axis=0))
    if pixels:
        assumed["exposure"] += f"; pixels left with none: {pixels}"
    return np.where(left_out, np.float32(0), np.float32(1))


def _read_weights(
    path: Path,
    names: tuple[str, ...],
    mask: NDArray[np.bool_],
    full_size: tuple[int, ...],
    inputs: dict[str, str],
    assumed: dict[str, str],
) -> NDArray[np.float32] | None:
    """`weights.exr` at the working size, that of `mask`; (H, W) or (N, H, W), 0 outside `mask`."""
    if not path.exists():
        return None
    stored = read_weights(path, names)
    _expect_size(path, stored.shape[-2:], full_size)
    inputs[path.name] = digest(path)
    weights = stored if mask.shape == full_size else reduced(stored, mask.shape)
    inside = weights[..., mask]
    if not (np.isfinite(inside) & (inside >= 0)).all():
        bad = inside[~(np.isfinite(inside) & (inside >= 0))]
        raise InputError(f"{path}: expected finite weights, 0 or more, found {bad[0]:g}")
    if not inside.any():
        raise InputError(f"{path}: expected some weight above 0 in the mask, found none")
    alike = "for all pictures alike" if weights.ndim == 2 else "for each picture"
    assumed["weights"] = (
        f"{path.name}, {alike}: {inside.min():.2g} to {inside.max():.2g}, "
        f"median {np.median(inside):.2g}"
    )
    return np.where(mask, weights, 0.0).astype(np.float32)


def _touched(marked: NDArray[np.bool_], size: tuple[int, int]) -> NDArray[np.bool_]:
    """Which pixels of a picture averaged down to `size` have a part in any that is marked."""
    if marked.shape == size:
        return marked
    touched = np.zeros(size, dtype=bool)
    rows, columns = np.nonzero(marked)
    lows, highs = [], []
    for at, full, small in zip((rows, columns), marked.shape, size, strict=True):
        lows.append(at * small // full)
        highs.append(np.minimum(((at + 1) * small - 1) // full, small - 1))
    for row in (lows[0], highs[0]):
        for column in (lows[1], highs[1]):
            touched[row, column] = True
    return touched


def _read_mask(path: Path, size: tuple[int, int], inputs: dict[str, str]) -> NDArray[np.bool_]:
    if not path.exists():
        return np.ones(size, dtype=bool)
    drawn = images.read_data(path)
    _expect_size(path, drawn.shape[:2], size)
    inputs[path.name] = digest(path)
    mask: NDArray[np.bool_] = drawn[..., : 3 if drawn.shape[-1] >= 3 else 1].mean(axis=-1) >= 0.5
    if not mask.any():
        raise InputError(f"{path}: expected at least one white pixel, found none")
    return mask


def _read_segments(
    path: Path, size: tuple[int, int], inputs: dict[str, str]
) -> NDArray[np.uint16] | None:
    if not path.exists():
        return None
    segments = images.read_ids(path)
    _expect_size(path, segments.shape, size)
    inputs[path.name] = digest(path)
    return segments


def _averaged(
    normals: NDArray[np.float64],
    mask: NDArray[np.bool_],
    segments: NDArray[np.uint16] | None,
    size: tuple[int, int],
) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.uint16] | None]:
    """Reduce maps to a smaller size.

    A pixel is used when all pixels that it averages are, so that nothing from outside the mask
    gets in; ids are not averaged but taken from the middle.
    """
    small_mask = averaged(mask, size) > 1 - 1e-4
    planes = [averaged(np.where(mask, normals[..., i], 0.0), size) for i in range(3)]
    small_normals = np.stack(planes, axis=-1).astype(np.float64)
    # Opposite normals cancel.
    small_mask &= np.linalg.norm(small_normals, axis=-1) >= MIN_NORMAL_LENGTH
    if segments is not None:
        segments = at_centres(segments, size)
    return small_normals, small_mask, segments


def _read_normals(
    folder: Path,
    settings: Settings,
    mask: NDArray[np.bool_],
    inputs: dict[str, str],
    assumed: dict[str, str],
) -> tuple[NDArray[np.float64], NDArray[np.float32] | None]:
    """Unit normals in camera space, and how far off they may be, in degrees, where that is told."""
    found = find_normals(folder)
    if not found:
        raise InputError(f"{folder}: expected {HOW_TO_GET_NORMALS}; found no normals")
    if len(found) == 2:
        raise InputError(f"{folder}: expected normals.exr or normals.png, found both")
    [path] = found
    normals = read_normals(path)
    _expect_size(path, normals.shape[:2], mask.shape)
    inputs[path.name] = digest(path)
    try:
        normals = settings.convention.to_camera(normals)
    except InputError as error:
        raise InputError(f"{folder / 'scene.toml'}: {error}") from None
    assumed["normals"] = f"{path.name}, {settings.convention}"
    sigma = read_uncertainty(path)
    if sigma is not None:
        _check_sigma(path, sigma[mask])
        low, middle, high = np.percentile(sigma[mask], [0, 50, 100])
        assumed["normals"] += f", uncertain by {low:.2g} to {high:.2g} degrees, median {middle:.2g}"
    try:
        return unit_normals(normals, mask), sigma
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _check_sigma(path: Path, sigma: NDArray[np.float32]) -> None:
    bad = ~(np.isfinite(sigma) & (sigma >= 0))
    if bad.any():
        raise InputError(
            f"{path}: expected {UNCERTAINTY} of finite degrees, 0 or more, found {sigma[bad][0]:g}"
        )


def _read_truth(folder: Path, names: tuple[str, ...], size: tuple[int, int]) -> Truth | None:
    if not folder.is_dir():
        return None
    path = folder / "materials.exr"
    materials, _, _ = read_materials(path)
    if materials.albedo.shape[:2] != size:
        # Materials must not be averaged across objects, so a scaled scene has no truth.
        log.warning("%s: another size than the pictures in use, left out", path)
        return None
    lighting_path = folder / "lighting.json"
    lighting = None  # of pictures whose lights are not spherical harmonics
    if lighting_path.exists():
        lighting = Lighting.load(lighting_path).of(names, lighting_path)
    relight = folder / "relight"
    if not relight.is_dir():
        return Truth(materials, lighting)
    held_out = Lighting.load(relight / "lighting.json")
    pictures = []
    for name in held_out.pictures:
        if not name or set(name) & set("/\\\0") or len(name.encode()) > LONGEST_NAME:
            raise InputError(
                f"{relight / 'lighting.json'}: expected names of pictures beside it, "
                f"found {quoted(name)}"
            )
        path = relight / f"{name}.exr"
        pictures.append(images.read_picture(path).pixels)
        _expect_size(path, pictures[-1].shape[:2], size)
    return Truth(materials, lighting, np.stack(pictures), held_out.coefficients)


def _truth_files(folder: Path) -> list[Path]:
    truth = folder / "truth"
    found = [truth / "materials.exr", truth / "lighting.json", truth / "relight" / "lighting.json"]
    return [path for path in found if path.exists()] + sorted((truth / "relight").glob("*.exr"))


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


def _write_picture(path: Path, image: NDArray[Any]) -> None:
    finite = np.where(np.isfinite(image), image, 0.0).astype(np.float32)
    images.write_exr(path, {name: finite[..., c] for c, name in enumerate("RGB")})


def _ids(segments: NDArray[np.integer[Any]]) -> NDArray[np.uint16]:
    """As a picture of 16 bits holds them: other ids are numbered anew from 1, in their order."""
    if segments.min() < 0 or segments.max() > MAX_ID:
        segments, count = consecutive_labels(segments)
        if count > MAX_ID:
            raise InputError(f"segments: expected at most {MAX_ID} to save, found {count}")
    return segments.astype(np.uint16)


def _expect_size(path: Path, found: tuple[int, ...], expected: tuple[int, ...]) -> None:
    if tuple(found) != tuple(expected):
        raise InputError(
            f"{path}: expected the pictures' size, {expected[1]} × {expected[0]} pixels, "
            f"found {found[1]} × {found[0]}"
        )
