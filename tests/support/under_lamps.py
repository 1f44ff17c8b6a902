"""Results with lamps, made by hand; samples under lamps in the core, by names."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from pbrfit import Result, _core
from pbrfit.model.lamps import Lamps
from relit import SIDE, ball, fitted


def far_and_none() -> Lamps:
    """Of picture 0 a warm lamp from the upper left, of picture 2 a dim one from the right."""
    places = np.array([(-0.48, 0.6, 0.64), (0.8, 0.0, 0.6)])
    return Lamps(np.array([0, 2]), places, colors=np.array([(1.2, 1.0, 0.7), (0.3, 0.3, 0.4)]))


def near_lamp(place: Sequence[float]) -> Lamps:
    """Of picture 0 a white lamp."""
    return Lamps(np.array([0]), np.array([place], float), np.array([True]), np.ones((1, 3)))


def ball_under_lamps() -> Result:
    """A sphere seen straight on: three pictures, ambient environment light, and its height."""
    like = ball(fitted())
    ambient = np.zeros((3, 16, 3))
    ambient[:, 0] = np.array([0.2, 0.5, 0.1])[:, None]
    height = np.where(like.mask, like.normals[..., 2] * SIDE / 2, np.nan)
    height -= np.nanmean(height)
    return dataclasses.replace(
        like,
        lighting=ambient,
        pictures=("a", "b", "c"),
        lamps=far_and_none(),
        height=height.astype(np.float32),
    )


def of_lamp_samples(method: str, given: dict[str, Any]) -> Any:
    """What a method of `_core.LampSamples` finds, all that it is told by name in one place."""
    told = ("pictures", "limits", "views", "directions", "intensities", "picture_of", "ambient")
    own = {name: given[name] for name in (*told, "threads", "model") if name in given}
    fits, maps = method == "fit", ("albedo", "roughness", "metallic")
    groups = {
        "start" if fits else "surfaces": ("start_normals" if fits else "normals", *maps),
        "prior": ("prior_mean", "prior_precision"),
        "free": ("free_normals", "free_metallic", "free_roughness"),
        "noise": ("floor", "growth", "proportional", "least"),
    }
    grouped = {
        group: tuple(given[name] for name in names)
        for group, names in groups.items()
        if names[0] in given
    }
    rest = set(given) - set(own) - {name for names in groups.values() for name in names}
    return getattr(_core.LampSamples(**own), method)(**grouped, **{n: given[n] for n in rest})
