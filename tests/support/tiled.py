"""Small pictures fitted in tiles as if they were large ones."""

from __future__ import annotations

from functools import partial

import pytest

from pbrfit.fit import decompose as decompose_module
from pbrfit.fit import settings
from pbrfit.fit.tiles import fit_tiles


def in_tiles(patch: pytest.MonkeyPatch, *, side: int, subset: int) -> None:
    """Every picture is a large one: lights from about `subset` pixels, then tiles of `side`²."""
    patch.setattr(settings, "WHOLE_PIXELS_MAX", 0)
    tiled = partial(fit_tiles, subset_pixels=subset, side=side)
    patch.setattr(decompose_module, "fit_tiles", tiled)
