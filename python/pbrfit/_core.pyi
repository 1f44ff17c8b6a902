from collections.abc import Sequence
from os import PathLike
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "InputError",
    "Raster",
    "decode_exr",
    "decode_icc",
    "decode_raster",
    "image_format",
    "write_exr",
    "write_png",
]

class InputError(ValueError): ...

@final
class Raster:
    @property
    def format(self) -> str: ...
    @property
    def samples(self) -> NDArray[Any]: ...
    @property
    def icc_profile(self) -> bytes | None: ...
    @property
    def exif(self) -> bytes | None: ...
    @property
    def orientation(self) -> int: ...
    @property
    def ignored(self) -> str | None: ...

def image_format(data: bytes) -> str | None: ...
def decode_exr(
    data: bytes, path: str | PathLike[str]
) -> tuple[dict[str, NDArray[np.float32]], list[float] | None]: ...
def decode_raster(data: bytes, path: str | PathLike[str], indices: bool) -> Raster: ...
def decode_icc(
    profile: bytes, levels: int, path: str | PathLike[str]
) -> tuple[list[NDArray[np.float32]], list[list[float]] | None]: ...
def write_exr(
    path: str | PathLike[str], channels: Sequence[tuple[str, NDArray[np.float32]]], half: bool
) -> None: ...
def write_png(path: str | PathLike[str], image: NDArray[Any], srgb: bool) -> None: ...
