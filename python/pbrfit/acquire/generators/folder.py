"""Pictures that somebody already made, as a generator that asks nobody."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from pbrfit._core import InputError
from pbrfit.acquire.generators import Generated, Request
from pbrfit.acquire.padding import resized
from pbrfit.acquire.photo import LEAST_SIDE, Photo, exposure_of
from pbrfit.acquire.prompts import Catalogue
from pbrfit.display.tone import codes, encoded
from pbrfit.io import images
from pbrfit.io.color import ColorSpace
from pbrfit.io.input_files import digest

ASPECT_TOLERANCE = 0.01
"""Sizes a model rounds to multiples of 8 or 16 differ from the photo's shape by no more."""


class Folder:
    """The pictures of a folder, in the order of their names.

    They have to show the photo's view pixel by pixel; where they are of another size, they are
    scaled to the photo's. Raises InputError if there is no such folder, or no picture in it.
    """

    name = "folder"
    retries = False

    def __init__(
        self, folder: str | os.PathLike[str], *, color_space: ColorSpace | None = None
    ) -> None:
        self._folder = Path(folder)
        self._color_space = color_space
        if not self._folder.is_dir():
            raise InputError(f"{self._folder}: expected a folder of pictures, found none")
        self._files: dict[str, Path] = {}
        for path in sorted(self._folder.iterdir()):
            if path.suffix.lower() in images.PICTURE_SUFFIXES and not path.name.startswith("."):
                if path.stem in self._files:
                    raise InputError(
                        f"{path}: expected one picture of that name, found "
                        f"{self._files[path.stem].name} too"
                    )
                self._files[path.stem] = path
        if not self._files:
            raise InputError(
                f"{self._folder}: expected pictures ({', '.join(images.PICTURE_SUFFIXES)}), "
                "found none"
            )

    def settings(self) -> dict[str, Any]:
        """Where the pictures are and how they are read."""
        return {"folder": str(self._folder.resolve()), "color_space": self._color_space}

    def check(self) -> None:
        """Nothing: the folder was looked into when it was named."""

    def plan(self, catalogue: Catalogue, count: int, seed: int) -> list[Request]:
        """One request a file, at most `count`; prompts play no part.

        In their place stands the content, so that a file which was changed is another request.
        """
        del catalogue
        return [
            Request(name, f"{path.name}, sha256 {digest(path)}", "", seed + i)
            for i, (name, path) in enumerate(list(self._files.items())[:count])
        ]

    def generate(self, photo: Photo, request: Request) -> Generated:
        """Read one.

        Raises InputError if the file cannot be used, or its shape is not the photo's; OSError if it
        cannot be read.
        """
        path = self._files[request.name]
        picture = images.read_picture(path, self._color_space)
        height, width = picture.pixels.shape[:2]
        full_height, full_width = photo.full_size
        stretch = (width / height) / (full_width / full_height)
        if abs(stretch - 1) > ASPECT_TOLERANCE or min(height, width) < LEAST_SIDE:
            raise InputError(
                f"{path}: expected the shape of {photo.path.name}, {full_width} × {full_height} "
                f"pixels, found {width} × {height}"
            )
        pixels = resized(picture.pixels, photo.size)
        # A float file's white is anywhere; the light of each picture takes up its exposure.
        exposure = exposure_of(path, pixels) if picture.stored is None else 0.0
        return Generated(
            pixels=codes(encoded(pixels, exposure)),
            record={
                "file": path.name,
                "sha256": picture.sha256,
                "color": picture.color,
                "exposure": exposure,
                "size": [height, width],
            },
        )
