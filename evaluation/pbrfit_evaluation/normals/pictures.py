"""Normals before and after, the true ones, and how far off they are: pictures, and a sheet."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from pbrfit.model.geometry import angles_between
from pbrfit.result import differences, metrics
from pbrfit.result.differences import PALETTE, Difference
from pbrfit.result.sheet import Key, Panel, Row, as_png, displayed, outside_grey, sheet
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.normal_errors import Array, Floats
from pbrfit_evaluation.real.pictures import masked, used_part


def draw_panels(scene: Scene, given: Floats, refined: Floats) -> dict[str, bytes]:
    """PNGs by name: "picture", "true", and "given", "refined" and the errors of both.

    Parameters
    ----------
    scene
        With the true normals.
    given, refined
        (H, W, 3), NaN outside the mask.
    """
    used = used_part(scene)
    shown = masked(scene, int(np.argmax(_brightness(scene))))
    true = np.where(scene.valid[..., None], scene.normals, np.nan)
    pixels = {
        "picture": displayed(shown, metrics.white_of(shown)),
        "true": outside_grey(0.5 + 0.5 * true),
        "given": outside_grey(0.5 + 0.5 * given),
        "refined": outside_grey(0.5 + 0.5 * refined),
        "error given": _painted(angles_between(given, true)),
        "error refined": _painted(angles_between(refined, true)),
    }
    return {
        name: as_png(np.rint(255 * np.clip(values[used], 0, 1)).astype(np.uint8))
        for name, values in pixels.items()
    }


def _brightness(scene: Scene) -> Array:
    return np.array([float(image[scene.valid].mean()) for image in scene.images])


def _painted(degrees: Array) -> Array:
    """Angles on the scale of all differences, by radians."""
    return np.asarray(PALETTE[Difference(np.radians(degrees)).indices()])


def draw_sheet(
    title: str, starts: Mapping[str, tuple[Mapping[str, bytes], Sequence[str]]]
) -> bytes:
    """PNG: the picture and the true normals; below a row for each start.

    Parameters
    ----------
    title
        Above all.
    starts
        By what the row is called: what `draw_panels` made, and the captions of both errors.
    """
    first, _ = next(iter(starts.values()))
    rows: list[Row] = [
        [Panel("brightest picture", _pixels(first["picture"])),
         Panel("true normals", _pixels(first["true"]))]
    ]  # fmt: skip
    for panels, (before, after) in starts.values():
        rows.append(
            [
                Panel("given", _pixels(panels["given"])),
                Panel(before, _pixels(panels["error given"])),
                Panel("refined", _pixels(panels["refined"])),
                Panel(after, _pixels(panels["error refined"])),
            ]
        )
    ticks = differences.tick_places(degrees=True)
    key = Key("angle to the true normals", PALETTE[: differences.STEPS], ticks)
    return as_png(sheet(rows, title=title, labels=["", *starts], keys=[key]))


def _pixels(png: bytes) -> NDArray[np.float64]:
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")) / 255.0
