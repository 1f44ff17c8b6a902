"""Normals before and after, the true ones, and how far off they are: pictures, and a sheet."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from pbrfit import metrics
from pbrfit.colormap import blue_to_yellow
from pbrfit.evaluation.normal_errors import Array, Floats, angles
from pbrfit.evaluation.real.pictures import masked, used_part
from pbrfit.scene import Scene
from pbrfit.sheet import Key, Panel, Row, as_png, displayed, outside_grey, sheet

LARGEST = 30.0
"""Degrees that have the last colour."""

TICKS = (0, 5, 10, 20, 30)


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
        "error given": _colours(angles(given, true)),
        "error refined": _colours(angles(refined, true)),
    }
    return {
        name: as_png(np.rint(255 * np.clip(values[used], 0, 1)).astype(np.uint8))
        for name, values in pixels.items()
    }


def _brightness(scene: Scene) -> Array:
    return np.array([float(image[scene.valid].mean()) for image in scene.images])


def _colours(degrees: Array) -> Array:
    scaled = blue_to_yellow(np.nan_to_num(degrees) / LARGEST)
    return np.asarray(outside_grey(np.where(np.isnan(degrees)[..., None], np.nan, scaled)))


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
    bar = blue_to_yellow(np.linspace(0, 1, 256))
    ticks = {tick / LARGEST: f"{tick}°{' and more' if tick == LARGEST else ''}" for tick in TICKS}
    key = Key("angle to the true normals", bar, ticks)
    return as_png(sheet(rows, title=title, labels=["", *starts], key=key))


def _pixels(png: bytes) -> NDArray[np.float64]:
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")) / 255.0
