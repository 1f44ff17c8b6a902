"""A scene folder as arrays: all its files read, checked, and brought to one size."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io import images
from pbrfit.io import limits as file_limits
from pbrfit.io.color import ColorSpace
from pbrfit.io.depth_files import find_depth, read_depth
from pbrfit.io.file_noise import FileNoise
from pbrfit.io.images import Orientation
from pbrfit.io.input_files import digest, there
from pbrfit.io.lamp_files import find_lamps
from pbrfit.io.normal_files import MIN_NORMAL_LENGTH, UNCERTAINTY, find_normals, read_normals
from pbrfit.io.quoting import listed, quoted, shown
from pbrfit.io.raw_files import RAW_SUFFIXES
from pbrfit.io.resampling import at_centres, averaged, averaged_channels, reduced_size
from pbrfit.io.weight_files import WEIGHT_FILE, read_weights, reduced
from pbrfit.model import geometry
from pbrfit.model.lamps import Lamps
from pbrfit.model.lighting import Lighting
from pbrfit.model.materials import read_materials
from pbrfit.scene import depth as scene_depth
from pbrfit.scene import known_lamps
from pbrfit.scene.arrays import (
    FIRST_FOV,
    SHAPE_PICTURES_MIN,
    SceneArrays,
    Source,
    Truth,
    every_channel,
    limits_in_words,
    unit_normals,
)
from pbrfit.scene.folder import (
    SEGMENT_FILE,
    Settings,
    decided_fov,
    find_dark_frame,
    find_pictures,
    read_settings,
    truth_files,
    warn_of_near_misses,
)
from pbrfit.scene.plateaus import plateaus

log = logging.getLogger("pbrfit")

AnyScene = TypeVar("AnyScene", bound=SceneArrays)

HOW_TO_GET_NORMALS = (
    "normals.exr or normals.png (camera space, X right, Y up, Z to the viewer) from a renderer or "
    "a normal estimator such as Marigold (`pbrfit normals SCENE --from marigold`), or flat ones "
    "(`--from flat`)"
)

FROM_PICTURES = "none given: found from the pictures"

LONGEST_NAME = 250
"""Bytes of a picture's name without its suffix; file systems take 255 with it."""


@dataclass(frozen=True)
class _Notes:
    """What reading a folder tells beside arrays: `Scene.inputs` and `Scene.assumed`."""

    folder: Path
    inputs: dict[str, str] = field(default_factory=dict)
    assumed: dict[str, str] = field(default_factory=dict)

    def has(self, name: str) -> bool:
        """Whether there is a file of that name; if so, it is an input."""
        path = self.folder / name
        if there(path):
            self.inputs[name] = digest(path)
        return name in self.inputs


def load(
    folder: Path,
    kind: type[AnyScene],
    *,
    fov: float | None = None,
    color_space: ColorSpace | None = None,
    max_size: int | None = None,
    code_range: tuple[int, int] | None = None,
    orientation: Orientation | None = None,
    pictures_alone: bool = False,
) -> AnyScene:
    """Read a scene folder as a scene of some class; see `Scene.load`.

    With `pictures_alone` as if there were no normals, and no weights, which may be theirs.
    """
    source = Source(folder.resolve(), color_space, max_size, code_range, fov, orientation)
    if max_size is not None and max_size < 1:
        raise InputError(f"max_size: expected at least 1 pixel, found {max_size}")
    paths = find_pictures(folder)
    warn_of_near_misses(folder)
    notes = _Notes(folder)
    assumed = notes.assumed
    settings = read_settings(folder / "scene.toml")
    notes.has("scene.toml")
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
        raise InputError(f"{paths[0].parent}: {_twice(paths)}")

    color_space = color_space or settings.color_space
    orientation = orientation or settings.orientation or "exif"
    read = _read_pictures(paths, notes, color_space, orientation, max_size, code_range)
    # From here on every map must have the size that the pictures have on disk.
    mask = read.mask
    full_size, size = mask.shape, read.pixels.shape[1:3]
    source = replace(source, size=full_size)
    if full_size != size:
        assumed["size"] = (
            f"averaged down from {full_size[1]} × {full_size[0]} to {size[1]} × {size[0]} pixels"
        )
    mask &= _read_mask(notes, full_size)
    dark = _read_dark_frame(notes, color_space, orientation, full_size)
    if dark is not None:
        mask &= dark.usable
    if not mask.any():
        raise InputError(f"{folder}: expected pixels both opaque and white in mask.png, found none")
    normals, sigma = None, None
    if pictures_alone:
        assumed["normals"] = FROM_PICTURES
    else:
        normals, sigma = _read_or_leave_normals(notes, settings, mask, len(names))
    segments = _read_segments(notes, full_size)
    depth = _read_depth(notes, full_size)
    if full_size != size:
        if sigma is not None:
            # Errors of neighbouring normals are much alike, so their mean is no more certain.
            sigma = averaged(np.where(mask, sigma, 0.0), size).astype(np.float32)
        normals, mask, segments = _averaged(normals, mask, segments, size)
        depth = None if depth is None else scene_depth.reduced(depth, size)
    weights = None if pictures_alone else _read_weights(notes, names, mask, full_size)
    weights = _without_bad(read, mask, paths, weights, assumed)
    limits = _limits(read, mask, paths, code_range, assumed, for_good=dark is not None)
    if dark is not None:  # here, as what was clipped is found in the values of the files
        _subtract(dark, read.pixels, mask, paths, assumed)

    lighting = None
    if notes.has("lighting.json"):
        lighting_path = folder / "lighting.json"
        lighting = Lighting.load(lighting_path).of(names, lighting_path)
        assumed["lighting"] = "known, from lighting.json"

    lamps = _read_lamps(notes, names)

    decided, assumed["fov"] = decided_fov(folder, fov, settings, read.focal_length, full_size)

    if settings.model is not None:
        assumed["model"] = f"{settings.model}, with which the pictures were rendered (scene.toml)"

    truth = _read_truth(folder / "truth", names, size)
    for path in truth_files(folder):
        notes.has(path.relative_to(folder).as_posix())
    try:
        return kind(
            images=read.pixels,
            normals=normals,  # type: ignore[arg-type]  # None = unknown
            lamps=lamps,
            depth=depth,
            fov=FIRST_FOV if decided is None else decided,
            fov_known=decided is not None,
            mask=mask,
            segments=segments,
            lighting=lighting,
            weights=weights,
            limits=limits,
            file_noise=tuple(read.noise) if any(read.noise) else None,
            normal_sigma=sigma,
            names=names,
            truth=truth,
            assumed=assumed,
            inputs=dict(sorted(notes.inputs.items())),
            source=source,
            model=settings.model,
            response=None if read.curve_told or dark is not None else "srgb",
        )
    except InputError as error:
        raise InputError(f"{folder}: {error}") from None


@dataclass(frozen=True, eq=False)
class Surface:
    """What a scene folder says of shape, at the size of its files."""

    size: tuple[int, int]
    """(height, width)."""
    fov: float
    """Horizontal field of view in degrees."""
    normals: NDArray[np.float64] | None
    """(H, W, 3) unit vectors in camera space, NaN outside the mask; None = no file has them."""
    mask: NDArray[np.bool_]
    segments: NDArray[np.uint16] | None


def read_surface(folder: Path, fov: float | None = None) -> Surface:
    """Read normals, mask and segments as `load` does; of the pictures only the first.

    Raises InputError or OSError as `load`.
    """
    notes = _Notes(folder)
    settings = read_settings(folder / "scene.toml")
    if fov is not None:
        geometry.check_fov(fov)
    orientation = settings.orientation or "exif"
    first = images.read_picture(find_pictures(folder)[0], orientation=orientation)
    size = first.pixels.shape[0], first.pixels.shape[1]
    mask = _read_mask(notes, size)
    there = bool(find_normals(folder))
    decided, _ = decided_fov(folder, fov, settings, first.focal_length_35mm, size)
    return Surface(
        size=size,
        fov=FIRST_FOV if decided is None else decided,
        normals=_read_normals(notes, settings, mask)[0] if there else None,
        mask=mask,
        segments=_read_segments(notes, size),
    )


@dataclass(frozen=True, eq=False)
class Pictures:
    """The pictures of a scene folder alone, at the size of their files."""

    names: tuple[str, ...]
    images: NDArray[np.float32]
    """(N, H, W, 3), linear Rec.709."""
    limits: NDArray[np.uint8]
    """(N, H, W, 3), as in a scene, of what the files hold."""
    fov: float
    """Horizontal field of view in degrees."""
    fov_in_words: str
    """What decided it."""


def read_pictures(folder: Path, fov: float | None = None) -> Pictures:
    """Read all pictures as `load` does, less its dark frame, whether or not there is more.

    Raises InputError or OSError as `load`.
    """
    if fov is not None:
        geometry.check_fov(fov)
    notes = _Notes(folder)
    settings = read_settings(folder / "scene.toml")
    paths = find_pictures(folder)
    color_space, orientation = settings.color_space, settings.orientation or "exif"
    read = _read_pictures(paths, notes, color_space, orientation, None, None)
    size = read.mask.shape
    dark = _read_dark_frame(notes, color_space, orientation, size)
    if dark is not None:
        _subtract(dark, read.pixels, dark.usable, paths, notes.assumed)
    decided, said = decided_fov(folder, fov, settings, read.focal_length, size)
    names = tuple(path.stem for path in paths)
    used = FIRST_FOV if decided is None else decided
    return Pictures(names, read.pixels, read.limits, used, said)


@dataclass
class _Pictures:
    """All pictures of a scene folder."""

    pixels: NDArray[np.float32]
    """(N, H, W, 3) at the working size."""
    limits: NDArray[np.uint8]
    """(N, H, W, 3): samples with a part in what is too bright or too dark for its file."""
    searched: list[bool]
    """Pictures that may have been clipped below what their files can hold: floats whose files say
    nothing about limits, and integers without loss whose range of codes nobody gave."""
    said: bool
    """Whether a float file has limits."""
    noise: list[FileNoise | None]
    """What its file did to each picture."""
    bad: list[NDArray[np.bool_] | None]
    """(H, W, 3) of each picture: samples that were NaN or infinite, and are 0; None = none."""
    mask: NDArray[np.bool_]
    """What alpha leaves, at the files' size."""
    focal_length: float | None = None
    """Of the first picture that has one, 35 mm equivalent, millimetres."""
    curve_told: bool = False
    """Whether somebody says of any picture by which curve its values are decoded."""


def _read_pictures(
    paths: list[Path],
    notes: _Notes,
    color_space: ColorSpace | None,
    orientation: Orientation,
    max_size: int | None,
    code_range: tuple[int, int] | None,
) -> _Pictures:
    read: _Pictures | None = None
    colors: dict[str, list[str]] = {}
    forms: dict[str, list[str]] = {}
    remarks: dict[str, list[str]] = {}
    shared: dict[str, dict[str, list[str]]] = {}  # settings by what they are of and by value
    for i, path in enumerate(paths):
        picture = images.read_picture(
            path, color_space, code_range=code_range, orientation=orientation
        )
        full_size = picture.pixels.shape[:2]
        if read is None:
            size = full_size if max_size is None else reduced_size(full_size, max_size)
            samples = (len(paths), *size)
            read = _Pictures(
                pixels=np.empty((*samples, 3), dtype=np.float32),
                limits=np.zeros((*samples, 3), dtype=np.uint8),
                searched=[],
                said=False,
                noise=[],
                bad=[None] * len(paths),
                mask=np.ones(full_size, dtype=bool),
            )
        if full_size != read.mask.shape:
            height, width = read.mask.shape
            raise InputError(
                f"{path}: expected the size of {paths[0].name}, "
                f"{width} × {height} pixels, found {full_size[1]} × {full_size[0]}"
            )
        whole = size == full_size
        read.pixels[i] = picture.pixels if whole else averaged_channels(picture.pixels, size)
        is_float = picture.bit_depth == 32
        if is_float and not np.isfinite(read.pixels[i]).all():
            read.bad[i] = bad = ~np.isfinite(read.pixels[i])
            read.pixels[i][bad] = 0
        if picture.limits is not None:
            read.limits[i] = picture.limits if whole else file_limits.averaged(picture.limits, size)
        stored = picture.stored
        sharp = stored is not None and stored.tables is None and code_range is None
        read.searched.append(sharp or (is_float and picture.limits is None))
        read.said |= is_float and picture.limits is not None
        read.noise.append(None if stored is None else stored.noise(size))
        if stored is not None:
            forms.setdefault(stored.in_words(), []).append(path.name)
        if picture.alpha is not None:
            read.mask &= picture.alpha >= 0.5
        read.focal_length = read.focal_length or picture.focal_length_35mm
        read.curve_told |= picture.curve_told
        colors.setdefault(picture.color, []).append(path.name)
        for remark in picture.notes:
            remarks.setdefault(remark, []).append(path.name)
        for what, value in picture.settings.items():
            shared.setdefault(what, {}).setdefault(value, []).append(path.name)
        notes.inputs[path.relative_to(notes.folder).as_posix()] = picture.sha256
    assert read is not None
    for color, names in colors.items():
        notes.assumed["color" if len(colors) == 1 else f"color of {', '.join(names)}"] = color
    if forms:
        notes.assumed["encoding"] = _in_words(forms)
    if remarks:
        said = (f"{remark}: {listed(names)}" for remark, names in remarks.items())
        notes.assumed["pictures"] = "; ".join(said)
    _compare_settings(shared, notes, orientation)
    if not read.mask.any():
        raise InputError(f"{paths[0].parent}: expected opaque pixels, found alpha below 0.5 in all")
    if not read.mask.all():
        notes.assumed["alpha"] = f"{np.count_nonzero(~read.mask)} transparent pixels left out"
    return read


def _without_bad(
    read: _Pictures,
    mask: NDArray[np.bool_],
    paths: list[Path],
    weights: NDArray[np.float32] | None,
    assumed: dict[str, str],
) -> NDArray[np.float32] | None:
    """Weights that are 0 where a sample is NaN or infinite; InputError if half of a picture is."""
    pixels = np.count_nonzero(mask)
    counts = [0 if bad is None else np.count_nonzero(mask & bad.any(axis=-1)) for bad in read.bad]
    worst = max(counts)
    path = paths[counts.index(worst)]
    if not worst:
        return weights
    if 2 * worst >= pixels:
        raise InputError(
            f"{path}: expected finite pixels, found {worst} of {pixels} that are NaN or infinite; "
            "a mask can leave them out"
        )
    said = f"{sum(counts)} pixels that are NaN or infinite left out, each of its picture alone"
    assumed["gaps"] = f"{said}; the most in {path.name}, {worst}"
    log.warning("%s: %s", path.parent, assumed["gaps"])
    given = np.ones((1, 1, 1), np.float32) if weights is None else weights
    given = given[..., None] if given.ndim < 4 else given
    found = np.broadcast_to(given, read.pixels.shape).copy()
    for of_picture, bad in zip(found, read.bad, strict=True):
        of_picture[bad if bad is not None else slice(0)] = 0
    return found


def _twice(paths: list[Path]) -> str:
    """What is wrong with pictures of which some have the name of another."""
    of_name: dict[str, list[str]] = {}
    for path in paths:
        of_name.setdefault(path.stem, []).append(path.name)
    pairs = [files for files in of_name.values() if len(files) > 1]
    said = f"expected one picture a name, found {' and '.join(map(shown, pairs[0]))}"
    if len(pairs) > 1:
        said += f", and {len(pairs) - 1} more such pair{'s' * (len(pairs) > 2)}"
    raw = [name for name in pairs[0] if Path(name).suffix.lower() in RAW_SUFFIXES]
    if not raw or len(raw) == len(pairs[0]):
        return f"{said}: take one of them away"
    other, kept = (
        Path(next(name for name in pairs[0] if (name in raw) == is_raw)).suffix
        for is_raw in (False, True)
    )
    return (
        f"{said}, which are one picture twice: take the {other} files away ({kept} ones are linear "
        f"light, read with pbrfit[raw]), or the {kept} ones"
    )


def _compare_settings(
    shared: dict[str, dict[str, list[str]]], notes: _Notes, orientation: Orientation
) -> None:
    """Say which pictures of a set were taken or stored otherwise than the others."""
    differing = {}
    for what, files in shared.items():
        if len(files) > 1:
            common, *others = sorted(files, key=lambda value: -len(files[value]))
            odd = ", ".join(f"{value} ({listed(files[value])})" for value in others)
            differing[what] = f"{odd}, else {common}"
    if differing:
        notes.assumed["set"] = "; ".join(f"{what} {files}" for what, files in differing.items())
    if orientation == "as-stored":
        notes.assumed["orientation"] = "as stored, whatever EXIF says"
        differing.pop("orientation", None)
    consequences = {
        "orientation": "each is turned by its EXIF data; option orientation as-stored turns none",
        "focal length": "pictures of one view have one, and one field of view is used",
        "colour profile": "each is decoded by its own; option color_space decodes all alike",
    }
    for what in filter(differing.__contains__, consequences):
        log.warning(
            "%s: expected one %s of all pictures, found %s: %s",
            *(notes.folder, what, differing[what], consequences[what]),
        )


def _in_words(forms: dict[str, list[str]]) -> str:
    """The forms of integer files, the most frequent first, and how many files have each."""
    if len(forms) == 1:
        return next(iter(forms))
    often = sorted(forms, key=lambda form: -len(forms[form]))
    more = f"; {len(often) - 3} other forms" if len(often) > 3 else ""
    return "; ".join(f"{len(forms[form])} files {form}" for form in often[:3]) + more


def _limits(
    read: _Pictures,
    mask: NDArray[np.bool_],
    paths: list[Path],
    code_range: tuple[int, int] | None,
    assumed: dict[str, str],
    *,
    for_good: bool,
) -> NDArray[np.uint8] | None:
    """(N, H, W, 3): limits of the files and of plateaus; None = a Scene has to seek them.

    With `for_good` they are sought here in any case, as the pictures are still to be changed.
    """
    everywhere = every_channel(mask)
    counted = [everywhere if bad is None else everywhere & ~bad for bad in read.bad]
    for path, limits in zip(paths, read.limits, strict=True):
        if limits[mask].all():
            low, high = code_range or images.CODE_RANGE
            raise InputError(
                f"{path}: expected some pixel of the mask with codes from {low} to {high} of 255, "
                "found all clipped or dark; code_range=(0, 255) keeps them"
            )
    bounds = any(limits[mask].any() for limits in read.limits)
    integers = [noise is not None for noise in read.noise]
    if bounds or for_good or any(np.logical_and(read.searched, integers)):
        found = plateaus(read.pixels, counted, read.searched)
        if found is not None:
            np.maximum(read.limits, found, out=read.limits)
            bounds = True
    if not bounds:
        # Plateaus of float pictures alone are sought when the Scene is made, unless their files say
        # that there are none.
        told = read.said or for_good
        return np.broadcast_to(np.uint8(0), read.limits.shape) if told else None
    assumed["exposure"] = limits_in_words(read.limits, counted)
    bounded = np.logical_and.reduce([limits.all(axis=-1) for limits in read.limits]) & mask
    if bounded.any():
        assumed["exposure"] += f"; pixels left with none: {np.count_nonzero(bounded)}"
    return read.limits


@dataclass(frozen=True, eq=False)
class _DarkFrame:
    """A picture of no light."""

    path: Path
    pixels: NDArray[np.float32]
    """(H, W, 3) at the files' size, linear Rec.709; 0 where it is not usable."""
    usable: NDArray[np.bool_]
    """(H, W): where it is not clipped from above, and finite."""


def _read_dark_frame(
    notes: _Notes,
    color_space: ColorSpace | None,
    orientation: Orientation,
    size: tuple[int, int],
) -> _DarkFrame | None:
    path = find_dark_frame(notes.folder)
    if path is None:
        return None
    picture = images.read_picture(path, color_space, orientation=orientation)
    notes.inputs[path.name] = picture.sha256
    _expect_size(path, picture.pixels.shape[:2], size)
    usable: NDArray[np.bool_] = np.asarray(np.isfinite(picture.pixels).all(axis=-1))
    if picture.limits is not None:
        usable &= (picture.limits != file_limits.AT_LEAST).all(axis=-1)
    if not usable.any():
        raise InputError(f"{path}: expected a picture without light, found all pixels clipped")
    return _DarkFrame(path, np.where(usable[..., None], picture.pixels, 0.0), usable)


def _subtract(
    dark: _DarkFrame,
    pixels: NDArray[np.float32],
    mask: NDArray[np.bool_],
    paths: list[Path],
    assumed: dict[str, str],
) -> None:
    """Subtract a dark frame from pictures (N, H, W, 3), in place; noise may leave negative values.

    Raises InputError if a picture is no brighter than it.
    """
    size = mask.shape
    small = dark.pixels if dark.usable.shape == size else averaged_channels(dark.pixels, size)
    level = float(small[mask].mean(dtype=np.float64))
    means = [float(picture[mask].mean(dtype=np.float64)) for picture in pixels]
    for path, mean in zip(paths, means, strict=True):
        if mean <= level:
            raise InputError(
                f"{dark.path}: expected a picture without light, darker than all others, found a "
                f"mean radiance of {level:.3g}, and {mean:.3g} in {path.name}"
            )
    pixels -= small.astype(np.float32)
    below = 100 * np.mean([(picture[mask] < 0).mean() for picture in pixels])
    said = (
        f"{dark.path.name} subtracted, {100 * level / np.mean(means):.2g} % of the mean radiance; "
        f"{below:.2g} % of the values are below 0 and stay so"
    )
    unusable = np.count_nonzero(~dark.usable)
    assumed["dark frame"] = (
        f"{said}; {unusable} pixels clipped in it left out" if unusable else said
    )


def _read_weights(
    notes: _Notes, names: tuple[str, ...], mask: NDArray[np.bool_], full_size: tuple[int, ...]
) -> NDArray[np.float32] | None:
    """`weights.exr` at the working size, that of `mask`, 0 outside of it; as `read_weights`."""
    if not notes.has(WEIGHT_FILE):
        return None
    path = notes.folder / WEIGHT_FILE
    stored = read_weights(path, names)
    _expect_size(path, stored.shape[-3:-1], full_size)
    weights = stored if mask.shape == full_size else reduced(stored, mask.shape)
    inside = weights[..., mask, :]
    _check_not_negative(path, "finite weights", inside)
    if not inside.any():
        raise InputError(f"{path}: expected some weight above 0 in the mask, found none")
    alike = "for all pictures alike"
    if weights.ndim == 4:
        alike = f"for each {'picture' if weights.shape[-1] == 1 else 'channel of each picture'}"
    notes.assumed["weights"] = (
        f"{path.name}, {alike}: {inside.min():.2g} to {inside.max():.2g}, "
        f"median {np.median(inside):.2g}"
    )
    found = np.where(mask[..., None], weights, 0.0).astype(np.float32)
    return found[..., 0] if found.shape[-1] == 1 else found


def _check_not_negative(path: Path, what: str, values: NDArray[np.floating[Any]]) -> None:
    bad = ~(np.isfinite(values) & (values >= 0))
    if bad.any():
        raise InputError(f"{path}: expected {what}, 0 or more, found {values[bad][0]:g}")


def _read_mask(notes: _Notes, size: tuple[int, int]) -> NDArray[np.bool_]:
    if not notes.has("mask.png"):
        return np.ones(size, dtype=bool)
    path = notes.folder / "mask.png"
    drawn = images.read_data(path)
    _expect_size(path, drawn.shape[:2], size)
    colors = drawn[..., : 3 if drawn.shape[-1] >= 3 else 1]
    drawn_in_grey = np.ptp(colors) > 0 and (colors == colors[..., :1]).all()
    if drawn.shape[-1] in (2, 4) and np.ptp(drawn[..., -1]) > 0 and not drawn_in_grey:
        colors = drawn[..., -1:]
        notes.assumed["mask"] = f"{path.name}: its alpha, as it is not drawn in black and white"
    white = colors.max()
    mask: NDArray[np.bool_] = colors.mean(axis=-1) >= 0.5
    if not mask.any() and white > 0 and np.isin(colors, (0, white)).all():
        mask = colors.mean(axis=-1) >= white / 2
        notes.assumed["mask"] = f"{path.name}: 0 and {white:.2g} of white alone, taken for it"
    if not mask.any():
        raise InputError(
            f"{path}: expected at least one white pixel, found none, and {white:.2g} of white at "
            "most"
        )
    return mask


def _read_segments(notes: _Notes, size: tuple[int, int]) -> NDArray[np.uint16] | None:
    if not notes.has(SEGMENT_FILE):
        return None
    segments = images.read_ids(notes.folder / SEGMENT_FILE)
    _expect_size(notes.folder / SEGMENT_FILE, segments.shape, size)
    return segments


def _read_depth(notes: _Notes, size: tuple[int, int]) -> NDArray[np.float32] | None:
    """Distances along the camera's axis, NaN where there is none."""
    path = find_depth(notes.folder)
    if path is None:
        return None
    notes.has(path.name)
    stored = read_depth(path)
    _expect_size(path, stored.shape, size)
    try:
        depth, holes = scene_depth.without_holes(stored)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    said = f"{path.name}: {scene_depth.in_words(depth)}"
    notes.assumed["depth"] = "; ".join([said, *holes])
    return depth


def _read_lamps(notes: _Notes, names: tuple[str, ...]) -> Lamps | None:
    path = find_lamps(notes.folder)
    if path is None:
        return None
    notes.has(path.relative_to(notes.folder).as_posix())
    lamps, notes.assumed["lamps"] = known_lamps.load(path, names)
    return lamps


def _averaged(
    normals: NDArray[np.float64] | None,
    mask: NDArray[np.bool_],
    segments: NDArray[np.uint16] | None,
    size: tuple[int, int],
) -> tuple[NDArray[np.float64] | None, NDArray[np.bool_], NDArray[np.uint16] | None]:
    """Reduce maps to a smaller size.

    A pixel is used when all pixels that it averages are, so that nothing from outside the mask
    gets in; ids are not averaged but taken from the middle.
    """
    small_mask = averaged(mask, size) > 1 - 1e-4
    small_normals = None
    if normals is not None:
        small_normals = averaged_channels(np.where(mask[..., None], normals, 0.0), size)
        # Opposite normals cancel.
        small_mask &= np.linalg.norm(small_normals, axis=-1) >= MIN_NORMAL_LENGTH
    if segments is not None:
        segments = at_centres(segments, size)
    return small_normals, small_mask, segments


def _read_or_leave_normals(
    notes: _Notes, settings: Settings, mask: NDArray[np.bool_], pictures: int
) -> tuple[NDArray[np.float64] | None, NDArray[np.float32] | None]:
    """As `_read_normals`; None where there are none and the pictures are enough to tell them."""
    if find_normals(notes.folder) or pictures < SHAPE_PICTURES_MIN:
        return _read_normals(notes, settings, mask)
    notes.assumed["normals"] = FROM_PICTURES
    return None, None


def _read_normals(
    notes: _Notes, settings: Settings, mask: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float32] | None]:
    """Unit normals in camera space, and their standard deviation in degrees, where it is given.

    Pixels that have none are taken out of the mask, in place.
    """
    folder = notes.folder
    found = find_normals(folder)
    if not found:
        raise InputError(
            f"{folder}: expected {HOW_TO_GET_NORMALS}; found no normals ({SHAPE_PICTURES_MIN} or "
            "more pictures under different lights need none)"
        )
    if len(found) == 2:
        raise InputError(f"{folder}: expected normals.exr or normals.png, found both")
    [path] = found
    notes.has(path.name)
    read = read_normals(path, mask)
    _expect_size(path, read.vectors.shape[:2], mask.shape)
    try:
        normals = settings.convention.to_camera(read.vectors)
    except InputError as error:
        raise InputError(f"{folder / 'scene.toml'}: {error}") from None
    said = ", ".join([path.name, *read.said, str(settings.convention)])
    none = mask & np.isnan(normals[..., 0])
    if none.any():
        mask &= ~none
        if not mask.any():
            raise InputError(f"{path}: expected normals of some pixel of the mask, found none")
        said += (
            f"; {np.count_nonzero(none)} pixels left out, whose vectors are zero, NaN or longer "
            "than normals"
        )
    sigma = read.uncertainty
    if sigma is not None:
        _check_not_negative(path, f"{UNCERTAINTY} of finite degrees", sigma[mask])
        low, middle, high = np.percentile(sigma[mask], [0, 50, 100])
        said += f", uncertain by {low:.2g} to {high:.2g} degrees, median {middle:.2g}"
    notes.assumed["normals"] = said
    return unit_normals(normals, mask), sigma


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
    if there(lighting_path):
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


def _expect_size(path: Path, found: tuple[int, ...], expected: tuple[int, ...]) -> None:
    if tuple(found) != tuple(expected):
        raise InputError(
            f"{path}: expected the pictures' size, {expected[1]} × {expected[0]} pixels, "
            f"found {found[1]} × {found[0]}"
        )
