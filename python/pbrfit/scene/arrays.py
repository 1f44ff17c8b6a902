"""Scene: pictures of one view under different lights, with normals and what else is known."""

from __future__ import annotations

import copy
import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io.color import Conversion, Curve, decode_srgb, encode_srgb
from pbrfit.io.limits import AT_LEAST, AT_MOST
from pbrfit.io.normal_files import MIN_NORMAL_LENGTH
from pbrfit.lazy import lazy
from pbrfit.model import estimates as of_tools
from pbrfit.model import geometry
from pbrfit.model.lamps import Lamps
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import Model, checked_model
from pbrfit.scene.correction import Correction
from pbrfit.scene.depth import checked_depth
from pbrfit.scene.options import Source
from pbrfit.scene.plateaus import plateaus
from pbrfit.values.arrays import Array, Codes, Floats, Mask
from pbrfit.values.checks import any_array, of_what, real_array, real_number, reals

if TYPE_CHECKING:
    from pbrfit.io.file_noise import FileNoise

log = logging.getLogger("pbrfit")

Places = NDArray[np.intp]

Counted = list[Mask] | None
"""(H, W, 3) bool of each picture: the values that count; None = all."""

CHANNELS = "red", "green", "blue"

FIRST_FOV = 60.0
"""Horizontal field of view in degrees that stands for one that nobody told, until a fit finds it:
that of a lens of 31 mm on a 35 mm camera."""

SHAPE_PICTURES_MIN = 3
"""Pictures under different lights from which on normals can be found where none are given."""

MAX_FACING_AWAY = 0.05
"""Share of normals that may face away from the camera before a warning is due."""


@dataclass(frozen=True, eq=False)
class Truth:
    """Ground truth of a scene, where there is one.

    Attributes
    ----------
    materials
        True maps.
    lighting
        (N, 16, 3), true lights of the scene's pictures, in the pictures' units; None where they are
        not spherical harmonics, such as point lights.
    relight_images, relight_lighting
        (M, H, W, 3) and (M, 16, 3): held-out pictures and their true lights; None without any.
    """

    materials: Materials
    lighting: Array | None = None
    relight_images: Floats | None = None
    relight_lighting: Array | None = None


_NEEDED: dict[str, type] = {"assumed": Mapping, "inputs": Mapping}
_NEEDED |= {"fov_known": bool, "normals_known": bool}
_OTHERS: dict[str, type] = {
    "file_noise": Sequence,
    "truth": Truth,
    "estimates": Materials,
    "source": Source,
    "lamps": Lamps,
}
_OTHERS |= {"correction": Correction, "response": str}
"""What attributes have to be that are no arrays; the second may be None."""


@dataclass(frozen=True, eq=False)
class SceneArrays:
    """Pictures of one view under different lights, checked when made.

    Attributes
    ----------
    images
        (N, H, W, 3) float32 or float64, linear Rec.709 radiance in any one unit. What a
        `numpy.ma.MaskedArray` masks has weight 0; no other array may be masked. Negative values,
        which noise around black and other primaries lead to, are fitted as they are, because a mean
        without them would be too bright; `assumed` says how many there are.
    normals
        (H, W, 3), camera space (X right, Y up, Z towards the viewer); normalised here, NaN outside
        the mask. None = unknown, of three pictures or more: it reads (0, 0, 1) everywhere, and
        `normals_known` is False.
    depth
        (H, W), distance from the camera along its axis, positive, in any unit, with an orthographic
        camera half of the picture's width; None = unknown. Kept as float32, NaN where it is 0,
        negative, infinite or 1e9 and more.
    fov
        Horizontal field of view in degrees, 0 = orthographic; None = unknown, then it reads
        `FIRST_FOV`, and a fit finds it.
    mask
        (H, W) bool, True = use; None = all pixels.
    segments
        (H, W) integer ids, 0 = unclassified; None = unknown.
    lighting
        (N, 16, 3): known lights, then only the materials are fitted; None = unknown.
    weights
        How much each value counts, 0 or more: (N, H, W, 3), or (N, H, W) for all channels alike,
        or (H, W) for all pictures too; None = all the same. Kept as float32 (N, H, W, 3), without
        copies of what is alike. Only their ratios matter. Values of weight 0 are no data: they may
        be NaN or infinite.
    limits
        (N, H, W, 3): which samples bound the radiance instead of telling it, 0 = none of these,
        1 (`AT_LEAST`) = clipped from above, 2 (`AT_MOST`) = from below. Kept as uint8. None = those
        at a plateau of the pictures (`pbrfit.scene.plateaus`), and afterwards: no sample is one.
        Zeros say that none is.
    file_noise
        What its file did to each picture, None where that was nothing, as `noise_floor` tells; None
        = nobody knows. Pictures that have one are not searched for plateaus.
    normal_sigma
        (H, W), degrees, 0 or more: how far off the given normals may be, the root mean square
        angle to the true ones; each of the two directions that a normal can tilt in has 1/√2 of
        it. None = nobody said. Kept as float32, NaN outside the mask.
    names
        One a picture; `picture_00`, ... when left out.
    truth
        Ground truth to report errors against.
    assumed
        What was decided about the input, by topic, in words.
    inputs
        sha256 of every file that was read, by path relative to the scene folder.
    source
        The scene folder and how it was read; None for scenes made of arrays.
    model
        The reflection model that the pictures were rendered with, "paper" or "principled": a fit
        takes it too, unless told otherwise. None = neither of them, or unknown.
    fov_known
        Whether somebody told the field of view; False where `fov` is a number to start from.
    correction
        What undoes the camera's tone curve in `samples`; None = nothing. A fit finds it.
    lamps
        Known lamps of the pictures, whose colours may be unknown; None = unknown.
    normals_known
        Whether somebody told the normals; False where they stand for ones that nobody told.
    estimates
        Maps of materials (H, W) that a network or another tool estimated, linear, in [0, 1], NaN
        where unknown: evidence beside the pictures, under environment light. None = there are none.
    response
        The tone curve that the files' values were decoded by, "srgb" or "linear", where nobody told
        which is right; None = it is known, or there are no files of integers. A fit decides.

    Raises
    ------
    InputError
        If an array has the wrong shape or values that cannot be used; one line that names it.
    """

    images: Floats
    normals: Floats = None  # type: ignore[assignment]  # an array once it is made
    fov: float = None  # type: ignore[assignment]  # a number once the scene is made
    mask: Mask | None = None
    segments: NDArray[np.integer[Any]] | None = None
    lighting: Array | None = None
    weights: Floats | None = None
    limits: Codes | None = None
    file_noise: tuple[FileNoise | None, ...] | None = None
    normal_sigma: Floats | None = None
    names: tuple[str, ...] = ()
    truth: Truth | None = None
    assumed: Mapping[str, str] = field(default_factory=dict)
    inputs: Mapping[str, str] = field(default_factory=dict)
    source: Source | None = None
    model: Model | None = None
    fov_known: bool = True
    correction: Correction | None = None
    depth: Floats | None = None
    lamps: Lamps | None = None
    normals_known: bool = True
    response: Curve | None = None
    estimates: Materials | None = None

    def __post_init__(self) -> None:
        for name, kind in (_NEEDED | _OTHERS).items():
            found = getattr(self, name)
            if not isinstance(found, kind) and (name in _NEEDED or found is not None):
                raise InputError(f"{name}: expected {kind.__name__}, found {of_what(found)}")
        hidden = isinstance(self.images, np.ma.MaskedArray)
        images = any_array("images", self.images.data if hidden else self.images)
        if images.ndim != 4 or images.shape[-1] != 3 or 0 in images.shape:
            raise InputError(f"images: expected shape (N, H, W, 3), found {images.shape}")
        if images.dtype not in (np.float32, np.float64):
            raise InputError(
                f"images: expected linear float32 or float64, found {images.dtype}; "
                "pbrfit.Scene.load decodes files"
            )
        n, height, width = images.shape[:3]
        names = _names(self.names, n)
        told: Any = self.fov
        fov = FIRST_FOV if told is None else real_number("fov", told)
        geometry.check_fov(fov)
        mask = _mask(self.mask, (height, width))
        weights = _weights(self.weights, names, (height, width), mask)
        if np.ma.is_masked(self.images):
            masked = np.ma.getmaskarray(self.images)
            weights = np.where(masked, np.float32(0), 1 if weights is None else weights)
            weights = _weights(weights, names, (height, width), mask)
        _check_finite(images, names, mask, weights)
        if n == 1 and self.lighting is None:
            raise InputError(
                "images: expected at least two pictures under different lights, found one "
                f"({names[0]}); a single picture needs its light (lighting.json)"
            )
        segments, lighting = self.segments, self.lighting
        if segments is not None:
            segments = any_array("segments", segments, (height, width))
            if not np.issubdtype(segments.dtype, np.integer):
                raise InputError(f"segments: expected integer ids, found {segments.dtype}")
        estimates = self.estimates
        if estimates is not None:
            estimates = of_tools.of_maps(vars(estimates), (height, width))
        if lighting is not None:
            lighting = real_array("lighting", lighting, (n, 16, 3))
            if not np.isfinite(lighting).all():
                raise InputError("lighting: expected finite coefficients, found NaN or infinity")
        file_noise = (None,) * n if self.file_noise is None else tuple(self.file_noise)
        if len(file_noise) != n:
            raise InputError(f"file_noise: expected {n}, found {len(file_noise)}")
        assumed, counted = self.assumed, _counted(mask, weights, n)
        if self.limits is not None:
            limits: Codes | None = _limits(self.limits, images.shape)
        else:
            limits = plateaus(images, counted, [noise is None for noise in file_noise])
            if limits is not None:
                assumed = {**assumed, "exposure": limits_in_words(limits, counted)}
        if limits is not None:
            for name, of_picture in zip(names, counted_limits(limits, counted), strict=True):
                if of_picture.all():
                    expected = "expected some sample at no limit in every picture"
                    raise InputError(f"limits: {expected}, found none in {name}")
        assumed = {topic: said for topic, said in assumed.items() if topic != "negative"}
        if said := _negative_in_words(images, counted):
            assumed["negative"] = said
        vars(self).update(images=images, mask=mask, weights=weights, limits=limits)
        valid = self.valid
        if self.truth is not None:
            _check_truth(self.truth, n, height, width)
            if not np.isfinite(self.truth.materials.albedo[valid]).any():
                raise InputError("truth: expected materials of some valid pixels, found only NaN")
        if self.lamps is not None:
            self.lamps.check_pictures(n)
        given: Any = self.normals
        if given is None:
            if n < SHAPE_PICTURES_MIN:
                raise InputError(
                    f"normals: expected unit vectors, found none; {SHAPE_PICTURES_MIN} or more "
                    "pictures under different lights need none"
                )
            normals = np.where(valid[..., None], [0.0, 0.0, 1.0], np.nan)
        else:
            normals = unit_normals(given, valid)
        normals_known = bool(self.normals_known and given is not None)
        depth, of_depth = checked_depth(self.depth, normals, fov, normals_known=normals_known)
        if of_depth:
            assumed["depth"] = "; ".join(filter(None, [assumed.get("depth"), *of_depth]))
        normal_sigma = _sigma(self.normal_sigma, valid)
        if normals_known:
            # An assumed field of view would put what is seen wrong.
            _warn_of_normals(normals[valid], fov if self.fov_known else None, valid)
        vars(self).update(
            normals=normals,
            depth=depth,
            fov=fov,
            segments=segments,
            estimates=estimates,
            lighting=lighting,
            file_noise=None if self.file_noise is None else file_noise,
            assumed=assumed,
            normal_sigma=normal_sigma,
            names=names,
            model=None if self.model is None else checked_model(self.model),
            fov_known=bool(self.fov_known and told is not None),
            normals_known=normals_known,
        )

    def __repr__(self) -> str:
        """In a line: what there is, and no arrays."""
        parts = [
            f"{len(self.images)} pictures of {self.width} × {self.height}",
            f"fov {self.fov:g}°{'' if self.fov_known else ', to be fitted'}",
            "normals" if self.normals_known else "no normals",
        ]
        if not self.all_valid:
            parts.append(f"{np.count_nonzero(self.valid)} of {self.valid.size} pixels valid")
        known = ("depth", "segments", "estimates", "lighting", "lamps", "weights", "truth")
        parts += [f"{name} known" for name in known if getattr(self, name) is not None]
        return f"{type(self).__name__}({', '.join(parts)})"

    @property
    def height(self) -> int:
        """Rows of a picture."""
        return int(self.images.shape[1])

    @property
    def width(self) -> int:
        """Columns of a picture."""
        return int(self.images.shape[2])

    @lazy
    def valid(self) -> Mask:
        """(H, W) bool: the pixels that are fitted.

        They are in the mask, and some sample of theirs has weight and is at no limit.
        """
        found = np.ones((self.height, self.width), bool)
        if self.weights is not None:
            found[:] = False
            for i in range(len(self.images)):
                weights = self.channel_weights(i)
                found |= weights is not None and (weights > 0).any(axis=-1)
        elif self.limits is not None:
            found.ravel()[all_at_limits(self.limits)] = False
        return found if self.mask is None else found & self.mask

    @lazy
    def places(self) -> Places:
        """(P,): where these are in the picture, row by row."""
        return np.flatnonzero(self.valid)

    @lazy
    def all_valid(self) -> bool:
        """Whether that are all."""
        return bool(self.valid.all())

    @lazy
    def grey(self) -> bool:
        """Whether the pictures, and the lights if they are known, have three equal channels."""
        lights = self.lighting is None or equal_channels(self.lighting)
        # The first picture in colour ends it.
        return lights and all(equal_channels(self.samples(i)) for i in range(len(self.images)))

    @lazy
    def weighted(self) -> bool:
        """Whether values of valid pixels have different weights."""
        if self.weights is None:
            return False
        first = self.weights[0][self.valid][0, 0]
        return any((of_picture[self.valid] != first).any() for of_picture in self.weights)

    @lazy
    def labels(self) -> tuple[NDArray[np.intp], int] | None:
        """(P,) labels of the valid pixels' segments, 1 … S in the order of their ids, and S.

        0 is unclassified. None without segments.
        """
        return None if self.segments is None else consecutive_labels(self.segments[self.valid])

    @lazy
    def label_map(self) -> NDArray[np.int32] | None:
        """(H, W): these labels, 0 at pixels that are not valid."""
        if self.labels is None:
            return None
        found = np.zeros(self.valid.shape, np.int32)
        found[self.valid] = self.labels[0]
        return found

    def samples(self, picture: int, places: Places | None = None) -> Floats:
        """(P, 3): a picture at the valid pixels in row order; 0 where it has no weight.

        Or at some places of the picture, row by row, read alone. No copy where all pixels count.
        """

        def at(values: NDArray[Any]) -> NDArray[Any]:
            if places is not None:
                return np.asarray(values[np.divmod(places, self.width)])
            if self.all_valid and self.weights is None:
                return values.reshape(-1, *values.shape[2:])
            return np.asarray(values[self.valid])

        samples: Floats = at(self.images[picture])
        if self.weights is not None:
            samples[at(self.weights[picture]) == 0] = 0
        if self.correction is not None:
            samples = self.correction.applied(samples).astype(self.images.dtype)
        return samples

    def channel_weights(
        self, picture: int, rows: slice = slice(None)
    ) -> NDArray[np.float32] | None:
        """(h, W, 3): `weights` of some rows of a picture, 0 at limits; None = all the same."""
        weights: NDArray[Any] | None = None if self.weights is None else self.weights[picture, rows]
        if self.limits is None:
            return weights
        ordinary: NDArray[np.float32] = (self.limits[picture, rows] == 0).astype(np.float32)
        ordinary *= 1 if weights is None else weights
        return ordinary

    def noise_floor(self, picture: int, places: Places | None = None) -> NDArray[np.float32] | None:
        """(H, W, 3), or (Q, 3) of some places, row by row: standard deviation of file noise.

        In the pictures' units: of rounding to codes and of JPEG; not of the camera. None for
        pictures that were floats, or are of no file.
        """
        noise = None if self.file_noise is None else self.file_noise[picture]
        if noise is None:
            return None
        image = self.images[picture]
        return noise.deviation(image if places is None else image.reshape(-1, 3)[places])

    @property
    def file_correlation(self) -> float:
        """Of what files did to a sample, with what they did to it in another picture."""
        known = [noise.correlation for noise in self.file_noise or () if noise is not None]
        return sum(known) / len(known) if known else 0.0

    def brightness(self, picture: int) -> Array:
        """(P,): the mean over the channels of `samples`."""
        return np.asarray(sum(self.samples(picture).T, np.zeros(1)) / 3)  # faster than `mean`

    def through(self, fov: float, correction: Correction | None = None) -> Self:
        """The same scene by another camera, of a field of view in degrees; it shares all else.

        The new number is not told by anybody: whether it was known stays as it is.
        """
        found = copy.copy(self)
        object.__setattr__(found, "fov", fov)
        object.__setattr__(found, "correction", correction)
        return found

    def decoded_by(self, curve: Curve) -> Self:
        """The scene with its files' values decoded by another curve than `response`.

        Raises InputError if there is no choice, because `response` is None.
        """
        if curve == self.response:
            return self
        if self.response is None:
            raise InputError(f"response: expected files of integers for {curve}, found none")
        other = encode_srgb if curve == "linear" else decode_srgb
        images = np.empty_like(self.images)
        for row in range(self.height):  # a curve has temporaries, which caches hold of a row
            images[:, row] = other(self.images[:, row])
        noise = self.file_noise
        if noise is not None:
            of = Conversion(curve)
            noise = tuple(None if one is None else replace(one, conversion=of) for one in noise)
        source = self.source
        if source is not None:
            source = replace(source, options=replace(source.options, color_space=curve))
        told = f"{curve}: pictures that were left out are explained better than by {self.response}"
        return replace(
            self,
            images=images,
            file_noise=noise,
            source=source,
            response=curve,
            assumed={**self.assumed, "color": told},
        )

    def file_values(self, radiance: Floats) -> Floats:
        """Radiance (..., 3) as the files' values, where 1 is white: `response` undone."""
        return encode_srgb(radiance) if self.response == "srgb" else radiance

    def of_pictures(self, pictures: Sequence[int], **changed: Any) -> Self:
        """The scene of some of the pictures, in this order, without ground truth of the others.

        `changed` are fields that are not those of this scene.
        """
        of, truth, noise = list(pictures), self.truth, self.file_noise
        for name in {"images", "weights", "limits", "lighting"} - changed.keys():
            given = getattr(self, name)
            changed[name] = None if given is None else given[of]
        if truth is not None and truth.lighting is not None:
            truth = replace(truth, lighting=truth.lighting[of])
        return replace(
            self,
            **changed,
            file_noise=None if noise is None else tuple(noise[i] for i in of),
            names=tuple(self.names[i] for i in of),
            lamps=None if self.lamps is None else self.lamps.of_pictures(of),
            truth=truth,
        )

    def picture(self, i: int, rows: slice) -> Floats:
        """Some rows of a picture, (h, W, 3), corrected."""
        if self.correction is None:
            return self.images[i, rows]
        return self.correction.applied(self.images[i, rows])

    def mean_brightness(self) -> float:
        """Of all samples, as they came."""
        raw = self.through(self.fov)
        return float(np.mean([raw.brightness(i).mean() for i in range(len(self.images))]))

    @property
    def views(self) -> Array:
        """(H, W, 3) unit vectors from the surface to the camera."""
        return geometry.view_directions(self.height, self.width, self.fov)


def _mask(mask: NDArray[Any] | None, shape: tuple[int, int]) -> Mask | None:
    if mask is None:
        return None
    mask = reals("mask", mask, shape)
    if np.isnan(mask).any():
        raise InputError("mask: expected True or False for each pixel, found NaN")
    mask = mask.astype(bool)
    if not mask.any():
        raise InputError("mask: expected at least one pixel to use, found none")
    return None if mask.all() else mask


def _weights(
    weights: Any, names: tuple[str, ...], shape: tuple[int, int], mask: Mask | None
) -> NDArray[np.float32] | None:
    """As (N, H, W, 3) float32; what the mask leaves out need not be sound and gets weight 0."""
    if weights is None:
        return None
    given = told = reals("weights", weights)
    expected = (len(names), *shape, 3)
    if given.shape not in (shape, expected[:3], expected):
        raise InputError(
            f"weights: expected shape {shape}, {expected[:3]} or {expected}, found {given.shape}"
        )
    if given.ndim < 4:
        given = given[..., None]
    # What was broadcast is kept once.
    given = given[tuple(slice(1) if stride == 0 else slice(None) for stride in given.strides)]
    with np.errstate(over="ignore"):  # what float32 cannot hold is infinite then, and refused
        found: NDArray[np.float32] = given.astype(np.float32)
    if mask is not None:
        found = np.where(mask[..., None], found, np.float32(0))
    check_not_negative("weights: expected finite numbers", found, told)
    found = np.broadcast_to(found, expected)
    for name, of_picture in zip(names, found, strict=True):
        some = of_picture.any(axis=(0, 1))
        if not some.all():
            where = f"the {CHANNELS[int(np.argmin(some))]} of {name}" if some.any() else name
            raise InputError(
                "weights: expected some weight above 0 in every channel of every picture, "
                f"found none in {where}"
            )
    return found


def check_not_negative(expected: str, values: NDArray[Any], told: NDArray[Any]) -> None:
    """Raise InputError that says what was `told` in place of a value that is not 0 or more."""
    bad = ~(np.isfinite(values) & (values >= 0))
    if bad.any():
        index = tuple(map(int, np.argwhere(bad)[0]))[: told.ndim]
        raise InputError(f"{expected}, 0 or more, found {told[index]:g} at {index}")


def _limits(limits: Any, shape: tuple[int, ...]) -> Codes:
    given = any_array("limits", limits, shape)
    known = given.dtype == np.uint8 and given.max() <= max(AT_LEAST, AT_MOST)
    if not known and (
        given.dtype.kind not in "buif" or not np.isin(given, (0, AT_LEAST, AT_MOST)).all()
    ):
        raise InputError(f"limits: expected 0, {AT_LEAST} or {AT_MOST}, found others")
    found: Codes = given.astype(np.uint8, copy=False)
    # Of zeros one is kept: not None, which would have plateaus sought.
    return found if found.any() else np.broadcast_to(np.uint8(0), shape)


def all_at_limits(limits: Codes) -> NDArray[np.intp]:
    """Pixels, row by row, whose samples of all pictures (N, H, W, 3) are at a limit."""
    first, *others = (of.reshape(-1, 3) for of in limits)
    left = np.flatnonzero((first[:, 0] != 0) & (first[:, 1] != 0) & (first[:, 2] != 0))
    for of in others:  # axes of three are slow to go along: only where it is still open
        left = left[of[left].all(axis=-1)]
    return left


def _counted(mask: Mask | None, weights: NDArray[np.float32] | None, pictures: int) -> Counted:
    """(H, W, 3) of each picture: values in the mask and of some weight; None = all."""
    if weights is not None:
        return [of_picture > 0 for of_picture in weights]
    return None if mask is None else [every_channel(mask)] * pictures


def counted_limits(limits: Codes, counted: Counted) -> Iterator[Codes]:
    """Those of each picture's values that are counted."""
    for i, of_picture in enumerate(limits):
        yield of_picture.ravel() if counted is None else of_picture[counted[i]]


def limits_in_words(limits: Codes, counted: Counted) -> str:
    """Which share of the values of counted samples is bounded."""
    total, bounded = 0, np.zeros(2)
    for of_picture in counted_limits(limits, counted):
        total += of_picture.size
        bounded += [np.count_nonzero(of_picture == limit) for limit in (AT_LEAST, AT_MOST)]
    shares = [
        f"{100 * count / total:.2g} % {side}exposed"
        for count, side in zip(bounded, ("over", "under"), strict=True)
        if count
    ]
    return f"of the values {', '.join(shares)}: they only bound the radiance"


def _negative_in_words(images: Floats, counted: Counted) -> str:
    """Which share of the values of counted samples is below 0; empty where none is."""
    below, total, lowest = 0, 0, 0.0
    for i, image in enumerate(images):
        total += image.size if counted is None else int(np.count_nonzero(counted[i]))
        if image.min() >= 0:  # not so if one is NaN
            continue
        negative = image < 0
        if counted is not None:
            negative &= counted[i]
        below += int(np.count_nonzero(negative))
        lowest = min(lowest, float(image[negative].min(initial=0.0)))
    if not below:
        return ""
    share = f"{100 * below / total:.2g} %" if below / total >= 1e-4 else f"{below}"
    return f"{share} of the values are below 0, down to {lowest:.2g}: fitted as they are"


def every_channel(pixels: Mask) -> Mask:
    """(..., 3): the same for all channels, without copies."""
    return np.broadcast_to(pixels[..., None], (*pixels.shape, 3))


def equal_channels(values: NDArray[Any]) -> bool:
    """Whether the three on the last axis are exactly equal, (..., 3)."""
    first = values[..., 0]
    return all(np.array_equal(first, values[..., c]) for c in (1, 2))


def _names(given: Any, pictures: int) -> tuple[str, ...]:
    """Names of files: different, and safe as such; made up where none are given."""
    names = tuple(given) if isinstance(given, Iterable) else (given,)
    if not all(isinstance(name, str) for name in names):
        raise InputError(f"names: expected file names, found {of_what(given)}")
    digits = max(2, len(str(pictures - 1)))
    names = names or tuple(f"picture_{i:0{digits}d}" for i in range(pictures))
    if len(set(names)) != pictures or len(names) != pictures:
        raise InputError(f"names: expected {pictures} different names, found {names}")
    for name in names:
        if not name or name[0] == "." or set(name) & set("/\\\0"):
            raise InputError(
                f"names: expected file names without slash or leading dot, found {name!r}"
            )
        try:
            name.encode()
        except UnicodeEncodeError:  # a file name of bytes that are no text
            raise InputError(f"names: expected names in UTF-8, found {name!a}") from None
    return names


def _check_finite(
    images: NDArray[Any],
    names: tuple[str, ...],
    mask: Mask | None,
    weights: NDArray[np.float32] | None,
) -> None:
    for i, (name, image) in enumerate(zip(names, images, strict=True)):
        if np.isfinite([image.min(), image.max()]).all():  # NaN goes through both
            continue
        bad = ~np.isfinite(image)
        if mask is not None:
            bad &= mask[..., None]
        if weights is not None:
            bad &= weights[i] > 0
        _refuse(bad.any(axis=-1), f"{name}: expected finite pixels", "NaN or infinite")


def _refuse(bad: Mask, expected: str, found: str) -> None:
    """Raise InputError if a pixel (H, W) is bad."""
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise InputError(
            f"{expected}, found {np.count_nonzero(bad)} that are {found}, the first at row {row}, "
            f"column {column}; a mask can leave them out"
        )


def unit_normals(normals: NDArray[Any], valid: Mask) -> Array:
    """(H, W, 3) normals of unit length where `valid`, NaN elsewhere; InputError if one has none."""
    normals = real_array("normals", normals, (*valid.shape, 3))
    with np.errstate(over="ignore"):  # an infinite length is refused
        length = np.linalg.norm(normals, axis=-1)
    bad = valid & ~((length >= MIN_NORMAL_LENGTH) & np.isfinite(length))
    _refuse(bad, "normals: expected unit vectors", "zero or NaN")
    # Vectors of unit length stay as they are, to the bit: so does a scene made of another's.
    length[~valid | (np.abs(length - 1.0) < 1e-12)] = 1.0
    return np.where(valid[..., None], normals / length[..., None], np.nan)


def _sigma(given: Any, valid: Mask) -> NDArray[np.float32] | None:
    """Standard deviations of normals as float32, NaN where not `valid`."""
    if given is None:
        return None
    degrees = real_array("normal_sigma", given, valid.shape)
    with np.errstate(over="ignore"):  # what float32 cannot hold is infinite then, and refused
        sigma: NDArray[np.float32] = np.where(valid, degrees, np.nan).astype(np.float32)
    check_not_negative("normal_sigma: expected finite degrees", np.where(valid, sigma, 0), degrees)
    return sigma


def _check_truth(truth: Truth, pictures: int, height: int, width: int) -> None:
    found: dict[str, tuple[Any, tuple[int, ...]]] = {
        "albedo": (truth.materials.albedo, (height, width, 3)),
        "roughness": (truth.materials.roughness, (height, width)),
        "metallic": (truth.materials.metallic, (height, width)),
    }
    if truth.lighting is not None:
        found["lighting"] = (truth.lighting, (pictures, 16, 3))
    if truth.relight_images is not None or truth.relight_lighting is not None:
        held_out = len(truth.relight_images) if truth.relight_images is not None else 0
        found["relight_images"] = (truth.relight_images, (held_out, height, width, 3))
        found["relight_lighting"] = (truth.relight_lighting, (held_out, 16, 3))
    for name, (array, shape) in found.items():
        if np.shape(array) != shape:
            raise InputError(f"truth: expected {name} of shape {shape}, found {np.shape(array)}")


def _warn_of_normals(normals: Array, fov: float | None, valid: Mask) -> None:
    """Warn of normals (M, 3) that face away, or are all the same: mostly nobody knew any then."""
    if fov is not None:
        views = geometry.view_directions(valid.shape[0], valid.shape[1], fov)[valid]
        share = float(np.mean(geometry.facing_away(normals, views)))
        if share > MAX_FACING_AWAY:
            cause = geometry.likely_convention_error(normals, views)
            unknown = "check their frame, the mask and the field of view"
            said = f"likely {cause}" if cause else unknown
            log.warning("normals: %.0f %% face away from the camera; %s", 100 * share, said)
    if len(normals) > 1 and (normals == normals[0]).all():
        log.warning(
            "normals: all equal, (%.3g, %.3g, %.3g); on anything but a flat surface shape is taken "
            "for material and light",
            *normals[0].tolist(),
        )


def storable_ids(ids: NDArray[np.integer[Any]], most: int) -> NDArray[np.integer[Any]]:
    """Ids from 0 to `most`: the same, or where others are among them `consecutive_labels`."""
    return ids if ids.min() >= 0 and ids.max() <= most else consecutive_labels(ids)[0]


def consecutive_labels(ids: NDArray[np.integer[Any]]) -> tuple[NDArray[np.intp], int]:
    """Labels 1 … S in the order of the ids, of the shape of `ids`, and S; id 0 stays 0.

    0 means unclassified, whether or not it occurs. Ids may be negative, large and sparse.
    """
    found, index = np.unique(ids, return_inverse=True)
    classified = found != 0
    labels = np.where(classified, np.cumsum(classified), 0)
    return labels[index.reshape(ids.shape)], int(np.count_nonzero(classified))
