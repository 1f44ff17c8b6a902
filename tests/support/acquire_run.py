"""What tests of `pbrfit generate` share: photos, a folder of pictures, a generator that counts."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from pbrfit.acquire.generators import Generated, Refused, Request, requests_from
from pbrfit.acquire.photo import Photo
from pbrfit.acquire.prompts import Catalogue, Prompt
from pbrfit.acquire.review import Check, Verdict
from pbrfit.io.color import encode_srgb
from pbrfit.synthetic import make_scene

SIZE = 64
CATALOGUE = Catalogue(
    "Keep all.", tuple(Prompt(f"light_{k}", f"Light {k}.") for k in range(6)), "no"
)


@functools.cache
def shown(size: int, count: int) -> dict[str, NDArray[np.uint8]]:
    """Pictures of a synthetic room by name, sRGB."""
    scene = make_scene("room", size=size, lights=count, seed=3)
    return {
        name: np.rint(255 * encode_srgb(np.clip(image / image.max(), 0, 1))).astype(np.uint8)
        for name, image in zip(scene.names, scene.images, strict=True)
    }


def write_pictures(folder: Path, count: int = 4, size: int = SIZE) -> list[str]:
    """Write pictures of the room but the last of `shown`; their names."""
    folder.mkdir(parents=True, exist_ok=True)
    names = list(shown(size, count + 1))[:-1]
    for name in names:
        Image.fromarray(shown(size, count + 1)[name]).save(folder / f"{name}.png")
    return names


def write_photo(path: Path, size: int = SIZE, count: int = 4) -> Path:
    """Write the picture of the room that `write_pictures` leaves out."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(list(shown(size, count + 1).values())[-1]).save(path)
    return path


def pixels(path: Path) -> NDArray[Any]:
    """Samples of a picture file."""
    with Image.open(path) as picture:
        return np.asarray(picture)


@dataclass
class Counting:
    """Pictures that differ by seed; counts what it is asked for, and fails where it is told to."""

    before: Callable[[int, Request], None] = lambda *_: None
    quality: str = "good"
    retries: bool = True
    name: str = "counting"
    asked: list[Request] = field(default_factory=list)

    def settings(self) -> dict[str, Any]:
        return {"quality": self.quality}

    def check(self) -> None:
        pass

    def plan(self, catalogue: Catalogue, count: int, seed: int) -> list[Request]:
        return requests_from(catalogue, count, seed)

    def generate(self, photo: Photo, request: Request) -> Generated:
        self.before(len(self.asked), request)
        self.asked.append(request)
        gain = 0.3 + 0.6 * np.random.default_rng(request.seed).random(3)
        pixels = np.rint(photo.srgb8() * gain).astype(np.uint8)
        return Generated(pixels, {"seed": request.seed, "usage": {"tokens": 10}})


def verdict(name: str, passed: bool) -> Verdict:
    note = "as it should be" if passed else f"refused by {name}"
    return Verdict((Check(name, 0.0 if passed else 2.0, 1.0, passed, note),))


@dataclass
class Strict:
    """A reviewer that refuses pictures by the order in which it sees them."""

    alone: Sequence[int] = ()
    company: Sequence[tuple[int, int]] = ()
    seen: int = 0
    rounds: int = 0

    def picture(self, pixels: NDArray[np.float32]) -> Verdict:
        assert pixels.dtype == np.float32
        self.seen += 1
        return verdict("alone", self.seen - 1 not in self.alone)

    def together(self, pictures: Sequence[NDArray[np.float32]]) -> list[Verdict]:
        self.rounds += 1
        return [
            verdict("company", (self.rounds - 1, k) not in self.company)
            for k in range(len(pictures))
        ]


def refusing(*names: str) -> Callable[[int, Request], None]:
    """Refuse prompts as moderation does."""

    def before(calls: int, request: Request) -> None:
        del calls
        if request.name in names:
            raise Refused("refused by moderation: not this one")

    return before


def failing(at: int, error: BaseException) -> Callable[[int, Request], None]:
    """Fail at the k-th call."""

    def before(calls: int, request: Request) -> None:
        del request
        if calls == at:
            raise error

    return before
