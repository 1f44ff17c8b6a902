"""A scene folder as arrays: all its files read, checked, and brought to one size."""

from __future__ import annotations

import logging
import math
from collections import Counter
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from functools import partial, reduce
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.address_space import left
from pbrfit.io import images
from pbrfit.io.color import Place
from pbrfit.io.depth_files import METRES, find_depth, read_depth
from pbrfit.io.file_noise import FileNoise
from pbrfit.io.input_files import there
from pbrfit.io.lamp_files import find_lamps
from pbrfit.io.limits import AT_LEAST
from pbrfit.io.normal_files import MIN_NORMAL_LENGTH, UNCERTAINTY, find_normals, read_normals
from pbrfit.io.resampling import at_centres, averaged, averaged_channels, reduced_size
from pbrfit.io.weight_files import WEIGHT_FILE, read_weights, reduced
from pbrfit.model import estimates as of_tools
from pbrfit.model import geometry
from pbrfit.model.lighting import Lighting
from pbrfit.model.materials import Materials, read_materials
from pbrfit.scene import depth as scene_depth
from pbrfit.scene import known_lamps
from pbrfit.scene.arrays import (
    FIRST_FOV,
    SHAPE_PICTURES_MIN,
    SceneArrays,
    Truth,
    all_at_limits,
    check_not_negative,
    counted_limits,
    every_channel,
    limits_in_words,
    unit_normals,
)
from pbrfit.scene.folder import (
    DARK_FRAME,
    FLAT_FIELD,
    SEGMENT_FILE,
    SceneFiles,
    ScenePath,
    digests,
    find_flats,
    find_frame,
    locate,
    warn_of_near_misses,
)
from pbrfit.scene.options import AS_STATED, ReadOptions, Settings, Source
from pbrfit.scene.plateaus import plateaus
from pbrfit.threads import in_turn
from pbrfit.values.arrays import Array, Codes, Mask
from pbrfit.values.checks import errors_about
from pbrfit.values.quoting import listed, quoted, shown

log = logging.getLogger("pbrfit")

AnyScene = TypeVar("AnyScene", bound=SceneArrays)

HOW_TO_GET_NORMALS = (
    "normals.exr or normals.png (camera space, X right, Y up, Z to the viewer) from a renderer or "
    "a normal estimator such as Marigold (`pbrfit normals SCENE --from marigold`), or flat ones "
    "(`--from flat`)"
)

PERSPECTIVE_OFF = 1.0
"""Degrees of a crop's middle off the axis to warn of: about what good normals are off by."""

EVERY_ROW = 16
"""Rows from one to the next of those by which pictures are told apart first."""

LONGEST_NAME = 250
"""Bytes of a picture's name without its suffix; file systems take 255 with it."""

Weights = NDArray[np.float32]


@dataclass
class _Notes:
    """A scene whose files are being read: how they are, and what they tell beside arrays."""

    files: SceneFiles
    asked: ReadOptions
    settings: Settings
    """Of the folder."""
    how: Settings
    """What is asked for, else what the folder says."""
    size: tuple[int, int] = (0, 0)
    """(height, width) of whole pictures, and so of every map beside them."""
    read: dict[str, str] = field(default_factory=dict)
    """sha256 of pictures, as in `Scene.inputs`."""
    assumed: dict[str, str] = field(default_factory=dict)
    """As `Scene.assumed`."""

    @classmethod
    def of(cls, scene: ScenePath | SceneFiles, options: ReadOptions, **changed: Any) -> _Notes:
        """Find the files of a scene; `changed` are options that count whatever is asked for."""
        files = scene if isinstance(scene, SceneFiles) else locate(scene)
        # IMG_1.CR2 and img_1.jpg are of one picture; a.png and A.png may be two.
        kinds = {(path.stem.casefold(), path.suffix.casefold()) for path in files.pictures}
        count, formats = Counter(files.names), Counter(name for name, _ in kinds)
        several = {n for n in files.names if count[n] > 1 or formats[n.casefold()] > 1}
        if twice := [path.name for path in files.pictures if path.stem in several]:
            found = f"{listed(twice)}: take others away, such as JPEG beside raw files"
            parent = files.pictures[0].parent
            raise InputError(f"{parent}: expected one picture a name, found {found}")
        settings = files.settings()
        notes = cls(files, options, settings, replace(options.or_else(settings), **changed))
        if files.said:
            notes.assumed["layout"] = f"pictures: {files.said}"
        return notes

    def part(self, name: str) -> Path | None:
        """The file of that name, where there is one and it belongs to the pictures."""
        path = self.files.folder / name
        return path if self.files.parts and there(path) else None

    def window(self, path: Path, size: tuple[int, ...]) -> tuple[slice, slice]:
        """Rows and columns that are used of a map; InputError unless it has the pictures' size."""
        _expect_size(path, size, self.size)
        return self.how.window(self.size)

    def decided_fov(self, focal_length: float | None) -> tuple[float, bool, str]:
        """Of what is used of the pictures, in degrees; whether somebody told it, and who.

        With half the field of view α a place at x from the principal point, in half widths, is seen
        at x tan α. The camera of a part has its principal point in the middle of that: directions
        are off by the angle at which the whole picture's camera sees it.
        """
        known, fov = True, self.how.fov or 0.0
        if self.how.fov is not None:
            said = "from scene.toml" if self.asked.fov is None else "asked for"
            said = f"{fov:g} degrees, {said}"
        elif focal_length is not None:
            fov = geometry.fov_from_focal_length(focal_length, *self.size)
            said = f"{fov:.2f} degrees, from EXIF ({focal_length:g} mm equivalent)"
        else:
            known, fov = False, FIRST_FOV
            said = f"{fov:g} degrees until it is fitted, as neither scene.toml nor EXIF says"
            unknown = "field of view unknown, so it is fitted (option fov gives it)"
            log.warning("%s: %s", self.files.folder, unknown)
        if self.how.crop is None:
            return fov, known, said
        left, top, width, height = self.how.crop
        slope = math.tan(math.radians(fov) / 2)
        right, down = 2 * left + width - self.size[1], 2 * top + height - self.size[0]
        off = math.degrees(math.atan(slope * math.hypot(right, down) / self.size[1]))
        part = math.degrees(2 * math.atan(slope * width / self.size[1]))
        said += f"; {part:.4g} of the crop"
        if off >= PERSPECTIVE_OFF:
            said += f", whose middle is {off:.1f} degrees off the optical axis: so are all views"
            log.warning("%s: field of view %s", self.files.folder, said)
        return part, known, said


def load(
    scene: ScenePath | SceneFiles,
    kind: type[AnyScene],
    options: ReadOptions = AS_STATED,
    *,
    pictures_alone: bool = False,
    look: int | None = None,
) -> AnyScene:
    """Read a scene as one of some class; see `Scene.load`.

    With `pictures_alone` without normals, weights, which may be theirs, and cropping; to `look` at
    it, sooner, with a longer side of at most so many pixels.
    """
    notes = _Notes.of(scene, options, **({"crop": None} if pictures_alone else {}))
    files, assumed, longest = notes.files, notes.assumed, notes.how.max_size
    if look is not None:
        notes.how = replace(notes.how, max_size=min(look, longest or look))
    folder, names = files.folder, files.names
    if files.parts:
        warn_of_near_misses(files)
    read = _read_pictures(notes, None if notes.how.crop else look)
    mask = read.mask
    full_size, size = mask.shape, read.size
    if full_size != notes.size:
        assumed["crop"] = "{2} × {3} pixels from {0},{1} on".format(*notes.how.crop or ())
    fitted = full_size if longest is None else reduced_size(full_size, longest)
    if full_size != fitted:
        to = f"{fitted[1]} × {fitted[0]} pixels"
        assumed["size"] = f"averaged down from {full_size[1]} × {full_size[0]} to {to}"
    mask &= _read_mask(notes)
    dark = _read_dark(notes)
    mask &= True if dark is None else dark.usable
    if not mask.any():
        raise InputError(f"{folder}: expected pixels both opaque and white in mask.png, found none")
    normals, sigma = None, None
    enough = len(names) >= SHAPE_PICTURES_MIN and not files.find(find_normals)
    if pictures_alone or enough:
        assumed["normals"] = "none given: found from the pictures"
    else:
        normals, sigma = _read_normals(notes, mask)
    segments = _read_segments(notes)
    depth, estimates = _read_depth(notes), _read_estimates(notes)
    if full_size != size:
        if sigma is not None:
            # Errors of neighbouring normals are much alike, so their mean is no more certain.
            sigma = averaged(np.where(mask, sigma, 0.0), size).astype(np.float32)
        normals, mask, segments = _averaged(normals, mask, segments, size)
        depth = None if depth is None else scene_depth.reduced(depth, size)
        estimates = None if estimates is None else of_tools.reduced(estimates, size)
    factors = [] if pictures_alone else [_read_weights(notes, mask)]
    _tell_bad(read, mask, notes)
    changed = dark is not None or bool(files.find(find_flats))
    limits = _limits(read, mask, notes, for_good=changed)
    factors.append(_calibrate(notes, read, mask, dark))  # here, as limits are of the files' values
    weights = _product(factors, read)

    lighting = None
    if lighting_path := notes.part("lighting.json"):
        lighting = Lighting.load(lighting_path).of(names, lighting_path)
        assumed["lighting"] = "known, from lighting.json"

    lamps = None
    if of_lamps := files.find(find_lamps):
        lamps, assumed["lamps"] = known_lamps.load(of_lamps[0], names)

    fov, fov_known, assumed["fov"] = notes.decided_fov(read.focal_length)

    model = notes.settings.model
    if model is not None:
        assumed["model"] = f"{model}, with which the pictures were rendered (scene.toml)"

    truth = None
    if files.parts:
        truth = _read_truth(folder / "truth", names, size if full_size == notes.size else (0, 0))
    named = tuple(map(files.relative, files.pictures)) if files.named else ()
    kept = read.different(notes)
    with errors_about(folder):
        found = kind(
            images=read.pixels,
            normals=normals,  # type: ignore[arg-type]  # None = unknown
            lamps=lamps,
            depth=depth,
            fov=fov,
            fov_known=fov_known,
            mask=mask,
            segments=segments,
            estimates=estimates,
            lighting=lighting,
            weights=weights,
            limits=limits,
            file_noise=tuple(read.noise) if any(read.noise) else None,
            normal_sigma=sigma,
            names=names,
            truth=truth,
            assumed=assumed,
            inputs=digests(files, notes.read),
            source=Source(folder.resolve(), options, named, full_size, fitted if look else None),
            model=model,
            response=None if read.curve_told or changed or notes.how.color_matrix else "srgb",
        )
        return found if len(kept) == len(names) else found.of_pictures(kept)


@dataclass(frozen=True, eq=False)
class Surface:
    """What a scene folder says of shape, at the size of its files."""

    size: tuple[int, int]
    """(height, width)."""
    fov: float
    """Horizontal field of view in degrees."""
    normals: Array | None
    """(H, W, 3) unit vectors in camera space, NaN outside the mask; None = no file has them."""
    mask: Mask
    segments: NDArray[np.uint16] | None


def read_surface(scene: ScenePath, options: ReadOptions = AS_STATED) -> Surface:
    """Read whole normals, mask and segments as `load`, and raise so; of pictures only the first."""
    notes = _Notes.of(scene, options, crop=None)
    first = notes.how.picture(notes.files.pictures[0])
    notes.size = first.pixels.shape[0], first.pixels.shape[1]
    fov = notes.decided_fov(first.taken.focal_length_35mm)[0]
    mask = _read_mask(notes)
    there = bool(notes.files.find(find_normals))
    return Surface(
        size=notes.size,
        fov=fov,
        normals=_read_normals(notes, mask)[0] if there else None,
        mask=mask,
        segments=_read_segments(notes),
    )


def read_pictures(
    scene: ScenePath, options: ReadOptions = AS_STATED
) -> tuple[Pictures, float, str]:
    """All pictures, whole, as `load` has them before it seeks plateaus, whatever else there is.

    Returns them, the field of view in degrees, and what decided it; raises as `load`.
    """
    notes = _Notes.of(scene, options, crop=None, max_size=None)
    read = _read_pictures(notes)
    everywhere: Mask = np.ones(notes.size, bool)
    _tell_bad(read, everywhere, notes)
    dark = _read_dark(notes)
    _calibrate(notes, read, everywhere if dark is None else dark.usable, dark)
    fov, _, said = notes.decided_fov(read.focal_length)
    return read, fov, said


class Pictures:
    """All pictures of a scene, which are put in one by one."""

    def __init__(self, notes: _Notes) -> None:
        self._notes, self._window = notes, notes.how.window(notes.size)
        self.names = notes.files.names
        self.mask: Mask = np.ones(notes.size, bool)[self._window].copy()
        """What alpha leaves of what is used, at the files' size."""
        used, longest = self.mask.shape, notes.how.max_size
        self.size = used if longest is None else reduced_size(used, longest)
        """(height, width) at which they are used."""
        samples = (len(notes.files.pictures), *self.size, 3)
        self.pixels = np.empty(samples, np.float32)
        """(N, H, W, 3) at that size."""
        self.limits = np.zeros(samples, np.uint8)
        """(N, H, W, 3): samples with a part in what is too bright or too dark for its file."""
        self.searched = [False] * len(self.pixels)
        """Pictures that may have been clipped below what their files can hold: floats whose files
        say nothing about limits, and integers without loss whose range of codes nobody gave."""
        self.said = False
        """Whether a float file has limits."""
        self.noise: list[FileNoise | None] = [None] * len(self.pixels)
        """What its file did to each picture."""
        self.bad: list[Mask | None] = [None] * len(self.pixels)
        """(H, W, 3) of each picture: samples that were NaN or infinite, and are 0; None = none."""
        self.focal_length: float | None = None
        """Of the first picture that has one, 35 mm equivalent, millimetres."""
        self.curve_told = False
        """Whether somebody says of any picture by which curve its values are decoded."""
        self.told: dict[str, dict[str, list[str]]] = {"color": {}, "encoding": {}, "pictures": {}}
        """Names of files by what they say of a topic."""
        self.shared: dict[str, dict[str, list[str]]] = {}
        """Names of files by camera, exposure and the like, and by the value of each."""

    def place(self, i: int, found: tuple[int, ...]) -> Place:
        """Where a picture of a size is put; InputError if the others have another size."""
        paths, (height, width) = self._notes.files.pictures, self._notes.size
        if found != (height, width):
            raise InputError(
                f"{paths[i]}: expected the size of {paths[0].name}, "
                f"{width} × {height} pixels, found {found[1]} × {found[0]}"
                + "; option orientation as-stored turns none"
                * (found == (width, height))
            )
        return Place(self._window, self.pixels[i], self.limits[i])

    def put(self, i: int, picture: images.Picture) -> None:
        """Put in what comes with the samples of a picture; others may be put in meanwhile."""
        notes, size = self._notes, self.size
        stored = picture.stored
        if stored is None:
            bad = ~np.isfinite(self.pixels[i])
            if bad.any():
                self.bad[i] = bad
                self.pixels[i][bad] = 0
            self.searched[i] = picture.limits is None
            if not self.searched[i]:
                self.said = True
        else:
            self.searched[i] = stored.tables is None and notes.how.code_range is None
            # Of the whole picture, averaged as much: blocks of JPEG begin at its corner.
            height, width = (
                max(1, round(of * to / used))
                for of, to, used in zip(notes.size, size, self.mask.shape, strict=True)
            )
            self.noise[i] = stored.noise((height, width))

    def note(self, path: Path, picture: images.Picture) -> None:
        """Note what the picture of a file tells beside its samples; in the order of the files."""
        for warning in picture.warnings:
            log.warning(warning)
        if picture.alpha is not None and self._notes.how.alpha != "ignore":
            self.mask &= picture.alpha >= 0.5
        self.focal_length = self.focal_length or picture.taken.focal_length_35mm
        self.curve_told |= picture.curve_told
        forms = () if picture.stored is None else (picture.stored.in_words(),)
        topics = {"color": (picture.color,), "encoding": forms, "pictures": picture.notes}
        for topic, said in topics.items():
            for one in said:
                self.told[topic].setdefault(one, []).append(path.name)
        for what, value in picture.taken.settings.items():
            self.shared.setdefault(what, {}).setdefault(value, []).append(path.name)
        self._notes.read[self._notes.files.relative(path)] = picture.sha256

    def different(self, notes: _Notes) -> list[int]:
        """The first of each group of pictures that are equal, to the bit; others are told."""
        some = [sha256(of[::EVERY_ROW].tobytes()).digest() for of in self.pixels]
        groups: dict[bytes, list[int]] = {}
        for i, key in enumerate(some):
            alike = some.count(key) > 1
            key = sha256(self.pixels[i].data).digest() if alike else key
            groups.setdefault(key, []).append(i)
        equal = [[notes.files.pictures[i].name for i in of] for of in groups.values() if of[1:]]
        if equal and len(groups) == 1:
            expected = "expected pictures under different lights"
            raise InputError(f"{notes.files.folder}: {expected}, found {len(equal[0])} equal ones")
        if equal:
            said = "; ".join(listed(names) for names in equal)
            notes.assumed["duplicates"] = f"equal pictures count once: {said}"
            log.warning("%s: %s", notes.files.folder, notes.assumed["duplicates"])
        return [of[0] for of in groups.values()]


def _read_pictures(notes: _Notes, look: int | None = None) -> Pictures:
    """Read pictures on all processors; errors and warnings are those of one after the other."""
    how, paths = notes.how, notes.files.pictures
    begun: Future[Pictures] = Future()

    def place(i: int, size: tuple[int, ...]) -> Place:
        if i == 0 and not begun.done():
            notes.size = size[0], size[1]
            begun.set_result(Pictures(notes))
        return begun.result().place(i, size)  # waits for the first picture's size

    def put(i: int) -> images.Picture:
        try:
            picture = how.picture(paths[i], place=partial(place, i), look=look)
        except BaseException as error:
            if i == 0 and not begun.done():
                begun.set_exception(error)
            raise
        begun.result().put(i, picture)
        return picture

    threads = 0 if left() is None else 1  # each has a picture's memory
    for path, picture in zip(paths, in_turn(threads, put, range(len(paths))), strict=True):
        begun.result().note(path, picture)
    read = begun.result()
    for color, names_of in read.told["color"].items():
        alone = len(read.told["color"]) == 1
        notes.assumed["color" if alone else f"color of {', '.join(names_of)}"] = color
    for topic in ("encoding", "pictures"):
        if told := read.told[topic]:
            alone = topic == "encoding" and len(told) == 1
            said = [one if alone else f"{one}: {listed(names)}" for one, names in told.items()]
            notes.assumed[topic] = "; ".join(said)
    _compare_settings(read.shared, notes)
    if how.color_matrix is not None:
        rows = "; ".join(" ".join(map("{:.3f}".format, row)) for row in how.color_matrix)
        notes.assumed["color matrix"] = f"{rows}, after that"
    if how.alpha == "ignore":
        notes.assumed["alpha"] = "ignored, as asked for"
    elif not read.mask.all():
        notes.assumed["alpha"] = f"{np.count_nonzero(~read.mask)} transparent pixels left out"
    return read


def _tell_bad(read: Pictures, mask: Mask, notes: _Notes) -> None:
    """Say how many pixels are NaN or infinite; InputError if half of those are that others have."""
    bad = [np.False_ if one is None else mask & one.any(axis=-1) for one in read.bad]
    counts = list(map(np.count_nonzero, bad))
    worst = max(counts)
    if not worst:
        return
    path = notes.files.pictures[counts.index(worst)]
    common, pixels = np.count_nonzero(reduce(np.logical_and, bad)), np.count_nonzero(mask)
    if 2 * (worst - common) >= pixels - common:
        raise InputError(
            f"{path}: expected finite pixels, found {worst} of {pixels} that are NaN, infinite or "
            "outside of the data window; a mask can leave them out"
        )
    said = f"{sum(counts)} pixels that are NaN, infinite or outside of a data window left out, "
    said += "each of its picture alone"
    notes.assumed["gaps"] = f"{said}; the most in {path.name}, {worst}"
    log.warning("%s: %s", path.parent, notes.assumed["gaps"])


def _product(factors: list[Weights | None], read: Pictures) -> Weights | None:
    """Weights (N, H, W, 3) of several reasons, and 0 where a sample is NaN or infinite."""
    if any(bad is not None for bad in read.bad):
        sound: Weights = np.ones(read.pixels.shape, np.float32)
        for i, bad in enumerate(read.bad):
            sound[i, bad if bad is not None else slice(0)] = 0
        factors = [*factors, sound]
    known = [one for one in factors if one is not None]
    return np.broadcast_to(math.prod(known), read.pixels.shape) if known else None


def _compare_settings(shared: dict[str, dict[str, list[str]]], notes: _Notes) -> None:
    """Say which pictures of a set were taken or stored otherwise than the others."""
    differing = {}
    for what, files in shared.items():
        if len(files) > 1:
            common, *others = sorted(files, key=lambda value: -len(files[value]))
            odd = ", ".join(f"{value} ({listed(files[value])})" for value in others)
            differing[what] = f"{odd}, else {common}"
    if differing:
        notes.assumed["set"] = "; ".join(f"{what} {files}" for what, files in differing.items())
    if notes.how.orientation == "as-stored":
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
            *(notes.files.folder, what, differing[what], consequences[what]),
        )


def _limits(read: Pictures, mask: Mask, notes: _Notes, *, for_good: bool) -> Codes | None:
    """(N, H, W, 3): limits of the files and of plateaus; None = a Scene has to seek them.

    With `for_good` they are sought here in any case, as the pictures are still to be changed.
    """
    everywhere, counted, bounds = every_channel(mask), None, False
    if any(bad is not None for bad in read.bad) or not mask.all():
        counted = [everywhere if bad is None else everywhere & ~bad for bad in read.bad]
    of_pictures = counted_limits(read.limits, counted)
    for path, limits in zip(notes.files.pictures, of_pictures, strict=True):
        bounds |= bool(limits.any())
        if limits.all():
            raise InputError(
                f"{path}: expected some pixel of the mask within the range of codes, found all "
                "clipped or dark; code_range=(0, 255) keeps them"
            )
    integers = [noise is not None for noise in read.noise]
    if bounds or for_good or any(np.logical_and(read.searched, integers)):
        found = plateaus(read.pixels, counted, read.searched)
        if found is not None:
            np.maximum(read.limits, found, out=read.limits)
            bounds = True
    if not bounds:
        # Plateaus of floats are sought when the Scene is made, unless their files say: none.
        told = read.said or for_good
        return np.broadcast_to(np.uint8(0), read.limits.shape) if told else None
    said = limits_in_words(read.limits, counted)
    if bounded := np.count_nonzero(mask.ravel()[all_at_limits(read.limits)]):
        said += f"; pixels left with none: {bounded}"
    notes.assumed["exposure"] = said
    return read.limits


@dataclass(frozen=True, eq=False)
class _Frame:
    """A picture that tells of the camera or the lamps: of no light, or of a white surface."""

    path: Path
    pixels: NDArray[np.float32]
    """(H, W, 3) at the files' size, linear Rec.709; 0 where it is not usable."""
    usable: Mask
    """(H, W): where it is not overexposed, and finite."""


def _read_dark(notes: _Notes) -> _Frame | None:
    path = notes.files.find(partial(find_frame, name=DARK_FRAME))
    return None if path is None else _read_frame(notes, path)


def _read_frame(notes: _Notes, path: Path) -> _Frame:
    picture = notes.how.picture(path)
    window = notes.window(path, picture.pixels.shape[:2])
    pixels = picture.pixels[window]
    usable: Mask = np.asarray(np.isfinite(pixels).all(axis=-1))
    if picture.limits is not None:
        usable &= (picture.limits[window] != AT_LEAST).all(axis=-1)
    if not usable.any():
        raise InputError(f"{path}: expected some pixel that is not clipped, found all clipped")
    return _Frame(path, np.where(usable[..., None], pixels, 0.0), usable)


def _calibrate(notes: _Notes, read: Pictures, mask: Mask, dark: _Frame | None) -> Weights | None:
    """Subtract a dark frame from all pictures, and divide them by flat-field frames, in place.

    A frame is used over its mean, g. Of a radiance L the camera shows g L, and photons give that a
    variance in proportion; so the variance of the quotient is in proportion to L/g, and its weight
    is g. Returns weights (1 or N, H, W, 3), None without such frames, 0 where a frame tells
    nothing. Raises InputError if a frame cannot be one.
    """
    if dark is not None:
        _subtract(dark, read.pixels, mask, notes)
    paths = notes.files.find(find_flats)
    if not paths:
        return None
    names = notes.files.names
    of_name = {path.stem: path for path in paths}
    if paths[0].parent == notes.files.folder:
        of_name, said = dict.fromkeys(names, paths[0]), paths[0].name
    else:
        said = f"those of {FLAT_FIELD}/"
        if spare := [path.name for path in paths if path.stem not in names]:
            said += f" (of no picture: {listed(spare)})"
    gains: list[Weights] = []
    for pixels, name in zip(read.pixels, names, strict=True):
        if name not in of_name:
            expected = "expected a flat-field frame for every picture"
            raise InputError(f"{paths[0].parent}: {expected}, found none for {shown(name)}")
        if not gains or of_name[name].parent != notes.files.folder:
            gains.append(_gain(notes, of_name[name], mask, dark))
        np.divide(pixels, gains[-1], out=pixels, where=gains[-1] > 0)
    of_mask = [gain[mask] for gain in gains]
    low, high = min(gain.min() for gain in of_mask), max(gain.max() for gain in of_mask)
    unused = sum(np.count_nonzero((gain <= 0).any(axis=-1)) for gain in of_mask)
    notes.assumed["flat field"] = (
        f"divided by {said}, from {low:.2g} to {high:.2g} of the mean, by which samples weigh"
        + f"; {unused} pixels left out that are clipped or black in one" * bool(unused)
    )
    return np.stack(gains)


def _gain(notes: _Notes, path: Path, mask: Mask, dark: _Frame | None) -> NDArray[np.float32]:
    """(H, W, 3) of a flat-field frame over its mean in each channel, 0 where it tells nothing."""
    frame = _read_frame(notes, path)
    usable, level = frame.usable, frame.pixels
    if dark is not None:
        level, usable = level - dark.pixels, usable & dark.usable
    if usable.shape != mask.shape:
        level = averaged_channels(level, mask.shape).astype(np.float32)
        usable = averaged(usable, mask.shape) > 1 - 1e-4
    sound = np.where(every_channel(usable & mask), np.maximum(level, 0), 0)
    mean = sound.sum(axis=(0, 1), dtype=np.float64) / max(np.count_nonzero(usable & mask), 1)
    if not mean.all():
        raise InputError(f"{path}: expected an even surface, brighter than black, found it black")
    found = np.where(every_channel(usable), np.maximum(level, 0), 0) / mean
    return np.asarray(found, np.float32)


def _subtract(dark: _Frame, pixels: NDArray[np.float32], mask: Mask, notes: _Notes) -> None:
    """Subtract a dark frame from pictures (N, H, W, 3), in place; noise may leave negative values.

    Raises InputError if a picture is no brighter than it.
    """
    size = mask.shape
    small = dark.pixels if dark.usable.shape == size else averaged_channels(dark.pixels, size)
    level = float(small[mask].mean(dtype=np.float64))
    means = [float(picture[mask].mean(dtype=np.float64)) for picture in pixels]
    for path, mean in zip(notes.files.pictures, means, strict=True):
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
    notes.assumed["dark frame"] = (
        f"{said}; {unusable} pixels clipped in it left out" if unusable else said
    )


def _read_weights(notes: _Notes, mask: Mask) -> Weights | None:
    """`weights.exr` (1 or N, H, W, 1 or 3) at the working size, that of `mask`; 0 outside it."""
    path = notes.part(WEIGHT_FILE)
    if path is None:
        return None
    stored = read_weights(path, notes.files.names)
    stored = stored[(..., *notes.window(path, stored.shape[-3:-1]), slice(None))]
    weights = stored if mask.shape == stored.shape[-3:-1] else reduced(stored, mask.shape)
    inside = weights[..., mask, :]
    in_mask = np.where(mask[..., None], weights, 0)
    check_not_negative(f"{path}: expected finite weights", in_mask, weights)
    if not inside.any():
        raise InputError(f"{path}: expected some weight above 0 in the mask, found none")
    alike = "for all pictures alike"
    if weights.ndim == 4:
        alike = f"for each {'picture' if weights.shape[-1] == 1 else 'channel of each picture'}"
    notes.assumed["weights"] = (
        f"{path.name}, {alike}: {inside.min():.2g} to {inside.max():.2g}, "
        f"median {np.median(inside):.2g}"
    )
    found = in_mask.astype(np.float32)
    return found if found.ndim == 4 else found[None]


def _read_mask(notes: _Notes) -> Mask:
    path = notes.part("mask.png")
    if path is None:
        return np.ones(notes.size, dtype=bool)[notes.how.window(notes.size)]
    drawn = images.read_data(path)
    drawn = drawn[notes.window(path, drawn.shape[:2])]
    colors = drawn[..., : 3 if drawn.shape[-1] >= 3 else 1]
    drawn_in_grey = np.ptp(colors) > 0 and (colors == colors[..., :1]).all()
    if drawn.shape[-1] in (2, 4) and np.ptp(drawn[..., -1]) > 0 and not drawn_in_grey:
        colors = drawn[..., -1:]
        notes.assumed["mask"] = f"{path.name}: its alpha, as it is not drawn in black and white"
    white = colors.max()
    mask: Mask = colors.mean(axis=-1) >= 0.5
    not_black = colors.max(axis=-1) > 0
    if not mask.any() and white > 0 and not np.ptp(colors[not_black], axis=0).any():
        mask = not_black
        said = f"0 and {white:.2g} of white in one colour alone, taken for white"
        notes.assumed["mask"] = f"{path.name}: {said}"
    if not mask.any():
        raise InputError(
            f"{path}: expected at least one white pixel, found none, and {white:.2g} of white at "
            "most"
        )
    return mask


def _read_segments(notes: _Notes) -> NDArray[np.uint16] | None:
    path = notes.part(SEGMENT_FILE)
    if path is None:
        return None
    segments = images.read_ids(path)
    return segments[notes.window(path, segments.shape)]


def _read_depth(notes: _Notes) -> scene_depth.Depth | None:
    """Distances along the camera's axis, NaN where there is none."""
    path = notes.files.find(find_depth)
    if path is None:
        return None
    stored, how = read_depth(path, METRES[notes.how.depth_unit or "m"], own=True)
    stored = stored[notes.window(path, stored.shape)]
    with errors_about(path):
        depth, holes = scene_depth.without_holes(stored)
    said = f"{path.name}: {scene_depth.in_words(depth)}"
    notes.assumed["depth"] = "; ".join([said, *how, *holes])
    return depth


def _read_estimates(notes: _Notes) -> Materials | None:
    """Maps of materials that another tool estimated."""
    path = notes.part(of_tools.ESTIMATES_FILE)
    if path is None:
        return None
    found = of_tools.read(path)
    rows, columns = notes.window(path, found.roughness.shape)
    notes.assumed["estimates"] = f"{listed(of_tools.known_maps(found))} from {path.name}"
    return found.each(lambda plane: plane[rows, columns])


def _averaged(
    normals: Array | None, mask: Mask, segments: NDArray[np.uint16] | None, size: tuple[int, int]
) -> tuple[Array | None, Mask, NDArray[np.uint16] | None]:
    """Reduce maps to a smaller size.

    A pixel is used when all pixels that it averages are, so that nothing from outside the mask
    gets in; ids are not averaged but taken from the middle.
    """
    small_mask = np.ones(size, bool) if mask.all() else averaged(mask, size) > 1 - 1e-4
    small_normals = None
    if normals is not None:
        small_normals = averaged_channels(np.where(mask[..., None], normals, 0.0), size)
        # Opposite normals cancel.
        small_mask &= np.linalg.norm(small_normals, axis=-1) >= MIN_NORMAL_LENGTH
    if segments is not None:
        segments = at_centres(segments, size)
    return small_normals, small_mask, segments


def _read_normals(notes: _Notes, mask: Mask) -> tuple[Array, NDArray[np.float32] | None]:
    """Unit normals in camera space, and their standard deviation in degrees, where it is given.

    Pixels that have none are taken out of the mask, in place.
    """
    folder = notes.files.folder
    found = notes.files.find(find_normals)
    if not found:
        if len(notes.files.pictures) == 1:
            one = "one photograph, of which `pbrfit generate PHOTO --out SCENE` makes others"
            raise InputError(f"{folder}: expected pictures under different lights, found {one}")
        raise InputError(
            f"{folder}: expected {HOW_TO_GET_NORMALS}; found no normals ({SHAPE_PICTURES_MIN} or "
            "more pictures under different lights need none)"
        )
    if len(found) == 2:
        raise InputError(f"{folder}: expected normals.exr or normals.png, found both")
    [path] = found
    window = notes.how.window(notes.size)
    whole: Mask = np.zeros(notes.size, bool)
    whole[window] = mask
    read = read_normals(path, whole)
    _expect_size(path, read.vectors.shape[:2], notes.size)
    with errors_about(folder / "scene.toml"):
        normals = notes.settings.convention.to_camera(read.vectors[window])
    said = ", ".join([path.name, *read.said, str(notes.settings.convention)])
    none = mask & np.isnan(normals[..., 0])
    if none.any():
        mask &= ~none
        if not mask.any():
            raise InputError(f"{path}: expected normals of some pixel of the mask, found none")
        said += (
            f"; {np.count_nonzero(none)} pixels left out, whose vectors are zero, NaN or longer "
            "than normals"
        )
    sigma = None if read.uncertainty is None else read.uncertainty[window]
    if sigma is not None:
        expected = f"{path}: expected {UNCERTAINTY} of finite degrees"
        check_not_negative(expected, np.where(mask, sigma, 0), sigma)
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
