"""From a photograph to a scene folder: pictures asked for, reviewed, and put in place.

What can fail for free is done first: the place, the key, the weights, and the normals and segments,
which need the photo alone. Then pictures, each written to the journal as it comes. The scene itself
appears at the very end.
"""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pbrfit import geometry
from pbrfit._core import InputError
from pbrfit.acquire import journal as journals
from pbrfit.acquire.generators import RETRY_STEP, Generator, Refused, Request
from pbrfit.acquire.journal import Entry, Journal
from pbrfit.acquire.photo import Photo, read_photo
from pbrfit.acquire.prompts import Catalogue
from pbrfit.acquire.scene_parts import Maps, free_place, publish
from pbrfit.color import ColorSpace, decode_srgb
from pbrfit.scene_folder import DEFAULT_FOV

log = logging.getLogger("pbrfit")

PHOTO = "photo"
"""Name of the photograph among the pictures."""

REGENERATE = 2
"""How often a picture that the review refused is asked for again."""

LEAST = 2
"""Pictures that a scene needs."""

Progress = Callable[[str, int, int], None]
"""Told what happens, how many pictures are there, and how many are wanted so far."""


class Check(Protocol):
    """One figure that a picture was judged by."""

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def value(self) -> float: ...  # noqa: D102
    @property
    def bound(self) -> float: ...  # noqa: D102
    @property
    def passed(self) -> bool: ...  # noqa: D102
    @property
    def note(self) -> str: ...  # noqa: D102
