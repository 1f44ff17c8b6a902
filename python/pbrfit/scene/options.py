"""How the files of a scene are read: one frozen object for all that read them."""

from __future__ import annotations

import operator
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal, Self, get_args, get_origin, get_type_hints

import numpy as np

from pbrfit._core import InputError
from pbrfit.io import images
from pbrfit.io.color import ColorSpace
from pbrfit.io.images import Orientation
from pbrfit.io.normal_files import Convention
from pbrfit.model import geometry
from pbrfit.model.reflection import Model
from pbrfit.values.checks import of_what, one_of, real_array
from pbrfit.values.quoting import quoted

Alpha = Literal["mask", "ignore"]

CROP = "X,Y,W,H, whole pixels, X and Y 0 or more, W and H 1 or more"


@dataclass(frozen=True)
class ReadOptions:
    """How the files of a scene are read. None = as `scene.toml` says, else the default.

    Raises InputError if a value is none of those that it may be.
    """

    fov: float | None = None
    """Horizontal field of view of a whole picture in degrees; default: EXIF, else it is fitted."""
    color_space: ColorSpace | None = None
    """Of all pictures; default: profiles and file types."""
    max_size: int | None = None
    """Longer side in pixels to which larger pictures are averaged down; default: as they are."""
    code_range: tuple[int, int] | None = None
    """Lowest and highest code of 8-bit pictures that is data, and the same shares of the maximum of
    16-bit ones; what is outside is in `limits`. Default: 1 to 250 in JPEG, all but 0 and the
    maximum in other integer pictures; (0, 255) = all are data."""
    orientation: Orientation | None = None
    """"exif" turns each picture as its EXIF data says, "as-stored" none; default: "exif"."""
    layer: str | None = None
    """Of EXR pictures; default: told by the names of layers."""
    alpha: Alpha | None = None
    """"mask", the default, leaves out pixels of which any picture has less than half."""
    color_matrix: tuple[tuple[float, ...], ...] | None = None
    """Three rows, applied to the linear Rec.709 of all pictures: a chart tells that of a camera."""
    crop: tuple[int, int, int, int] | None = None
    """Left, top, width, height in pixels of what is used of upright pictures and maps."""

    def __post_init__(self) -> None:
        if self.fov is not None:
            geometry.check_fov(self.fov)
            object.__setattr__(self, "fov", float(self.fov))
        for name, kind in get_type_hints(type(self)).items():
            choices = [of for of in (kind, *get_args(kind)) if get_origin(of) is Literal]
            if choices and (given := getattr(self, name)) is not None:
                one_of(name, given, choices[0])
        if not isinstance(self.layer, str | None):
            raise InputError(f"layer: expected a name, found {of_what(self.layer)}")
        if self.max_size is not None:
            [pixels] = _whole("max_size", [self.max_size], "at least 1 pixel")
            object.__setattr__(self, "max_size", pixels)
            if pixels < 1:
                raise InputError(f"max_size: expected at least 1 pixel, found {pixels}")
        if self.code_range is not None:
            object.__setattr__(self, "code_range", images.checked_codes(self.code_range))
        if self.color_matrix is not None:
            rows = real_array("color_matrix", self.color_matrix, (3, 3))
            if not np.isfinite(rows).all() or np.linalg.det(rows) == 0:
                expected = "expected three rows of three numbers that can be undone"
                raise InputError(f"color_matrix: {expected}, found {quoted(self.color_matrix)}")
            object.__setattr__(self, "color_matrix", tuple(map(tuple, rows.tolist())))
        if self.crop is not None:
            crop = _whole("crop", self.crop, CROP)
            object.__setattr__(self, "crop", crop)
            if len(crop) != 4 or min(crop) < 0 or 0 in crop[2:]:
                raise InputError(f"crop: expected {CROP}, found {of_what(self.crop)}")

    def or_else(self, settings: Settings) -> Settings:
        """These options, and those of a folder where nothing is asked for."""
        given = {name: value for name, value in vars(self).items() if value is not None}
        return replace(settings, **given)

    def picture(self, path: Path, **placed: Any) -> images.Picture:
        """Read a picture; as `images.read_picture`, and raises InputError or OSError as that."""
        turned = self.orientation or "exif"
        how = (self.color_space, self.layer, self.code_range, turned, self.color_matrix)
        return images.read_picture(path, *how, straight=self.alpha != "ignore", **placed)

    def window(self, size: tuple[int, ...]) -> tuple[slice, slice]:
        """Rows and columns that are used of pictures of a size (height, width).

        Raises InputError if the pictures are smaller.
        """
        if self.crop is None:
            return slice(None), slice(None)
        left, top, width, height = self.crop
        if left + width > size[1] or top + height > size[0]:
            found = f"found {left},{top},{width},{height}"
            raise InputError(f"crop: expected X,Y,W,H within {size[1]} × {size[0]} pixels, {found}")
        return slice(top, top + height), slice(left, left + width)

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> Self:
        """Options of a table, as `vars` gives one; it may have more, or lack some."""
        names = {one.name for one in fields(cls)}
        return cls(**{name: value for name, value in content.items() if name in names})


def _whole(name: str, values: Any, expected: str) -> tuple[int, ...]:
    """Whole numbers, as Python's own; InputError if these are none."""
    with suppress(TypeError):
        if not any(isinstance(value, bool) for value in values):
            return tuple(map(operator.index, values))
    raise InputError(f"{name}: expected {expected}, found {of_what(values)}")


AS_STATED = ReadOptions()
"""Nothing is asked for."""


@dataclass(frozen=True)
class Settings(ReadOptions):
    """Keys of `scene.toml`: how its files are to be read, and what else is known of them."""

    normals: Literal["opengl", "directx"] = "opengl"
    """Y up, or Y down."""
    normals_frame: Literal["camera", "world"] = "camera"
    world_to_camera: Any = None
    """(3, 3) rotation, needed when the frame is "world"; kept as float64."""
    depth_unit: Literal["m", "cm", "mm"] | None = None
    """Of the numbers in the depth file, which become metres; None = any unit, as stored."""
    model: Model | None = None
    """That the pictures were rendered with, "paper" or "principled"; None = none, or unknown."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.world_to_camera is not None:
            rotation = real_array("world_to_camera", self.world_to_camera, (3, 3))
            if (
                not (np.abs(rotation) <= 1.01).all()  # beyond, squares may overflow
                or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3)
                or np.linalg.det(rotation) < 0
            ):
                found = quoted(self.world_to_camera)
                raise InputError(f"world_to_camera: expected a 3 × 3 rotation, found {found}")
            object.__setattr__(self, "world_to_camera", rotation)

    @property
    def convention(self) -> Convention:
        """How the folder's normals are written down."""
        return Convention(self.normals, self.normals_frame, self.world_to_camera)


@dataclass(frozen=True)
class Source:
    """Where a scene was read from, and how."""

    path: Path
    """The scene folder, absolute; of pictures of several folders the one that holds these."""
    options: ReadOptions = AS_STATED
    """As given to `Scene.load`."""
    files: tuple[str, ...] = ()
    """Pictures that were named one by one, relative to the folder; none = those that it has."""
    size: tuple[int, int] | None = field(default=None, compare=False)
    """(height, width) of the pictures before `max_size`; None = not known."""
    fitted: tuple[int, int] | None = field(default=None, compare=False)
    """The same after it, where the scene was read smaller, to be looked at."""
