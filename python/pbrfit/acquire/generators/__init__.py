"""Generators: what makes pictures of the same view under other lights, behind one protocol."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any, Protocol

from pbrfit._core import InputError
from pbrfit.acquire.photo import Photo
from pbrfit.acquire.prompts import Catalogue
from pbrfit.values.arrays import Codes

RETRY_STEP = 1000
"""Between the seeds of a request's attempts; so many requests have seeds of their own."""


@dataclass(frozen=True)
class Request:
    """One picture that is asked for."""

    name: str
    """Of the picture, safe in file names, unique in a run."""
    prompt: str
    negative: str
    """The whole texts; a generator may not take the second."""
    seed: int
    """Of this attempt."""


@dataclass(frozen=True, eq=False)
class Generated:
    """One picture that came."""

    pixels: Codes
    """(H, W, 3) uint8, sRGB, of the photo's size, each pixel where the photo has it."""
    record: dict[str, Any]
    """How it was made, as JSON: model, revision, seed, steps, guidance, seconds, usage …"""


class Refused(Exception):  # noqa: N818 - a refusal is an answer, not an error
    """A prompt was refused, and the message says why; other prompts may not be."""


class Generator(Protocol):
    """Makes pictures of a view under other lights."""

    name: str
    """As the command line has it."""
    retries: bool
    """Whether another seed gives another picture."""

    def settings(self) -> dict[str, Any]:
        """All that decides about the pictures, as JSON; no secrets."""

    def check(self) -> None:
        """See that it can work, as far as that shows without making a picture.

        Raises InputError if something is missing: one line.
        """

    def plan(self, catalogue: Catalogue, count: int, seed: int) -> list[Request]:
        """The pictures to ask for, with their first seeds.

        Raises InputError if so many cannot be had.
        """

    def generate(self, photo: Photo, request: Request) -> Generated:
        """Make one.

        Raises Refused if this request was refused; InputError if the generator cannot work: one
        line.
        """


def requests_from(catalogue: Catalogue, count: int, seed: int) -> list[Request]:
    """The first `count` lightings, request i with seed + i; beyond the end again from the front.

    A second round has other seeds, and names that end in ``_2``. Raises InputError if `count` is
    not 1 to 1000, beyond which seeds of attempts would meet.
    """
    if not 1 <= count <= RETRY_STEP:
        raise InputError(f"count: expected 1 to {RETRY_STEP}, found {count}")
    requests: list[Request] = []
    taken = {prompt.name for prompt in catalogue.lighting}
    for i in range(count):
        around, k = divmod(i, len(catalogue.lighting))
        prompt = catalogue.lighting[k]
        name = prompt.name
        if around:
            name = f"{prompt.name}_{around + 1}"
            while name in taken:  # somebody called a lighting of their own so
                name += "_"
            taken.add(name)
        requests.append(Request(name, catalogue.full(prompt), catalogue.negative, seed + i))
    return requests


_REGISTRY = {
    "flux2-klein": ("flux2_klein", "Flux2Klein"),
    "gpt-image-2": ("gpt_image", "GptImage"),
    "folder": ("folder", "Folder"),
}
"""Name to module and class; imported when chosen."""

NAMES = ("flux2-klein", "gpt-image-2", "folder:DIR")


def create(choice: str, **options: Any) -> Generator:
    """Make a generator by its name.

    `choice` is one of `NAMES`, and `options` are what its constructor takes; None stands for its
    default. Raises InputError if there is none of that name.
    """
    name, colon, argument = choice.partition(":")
    if name not in _REGISTRY or (name == "folder") != bool(colon and argument):
        raise InputError(f"generator: expected one of {', '.join(NAMES)}, found {choice!r}")
    module, class_name = _REGISTRY[name]
    made = getattr(importlib.import_module(f"{__name__}.{module}"), class_name)
    given = {key: value for key, value in options.items() if value is not None}
    generator: Generator = made(argument, **given) if argument else made(**given)
    return generator
