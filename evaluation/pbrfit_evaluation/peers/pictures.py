"""Maps of a scene as small pictures, and side by side."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from pbrfit.model.reflection import render
from pbrfit.result import metrics
from pbrfit.result.result import Result
from pbrfit.result.sheet import Panel, as_png, displayed, outside_grey, sheet
from pbrfit.scene.scene import Scene

MAPS = {
    "albedo": "albedo",
    "roughness": "roughness, white = 1",
    "metallic": "metallic, white = 1",
    "relit": "under a held-out light",
}
"""What is shown of each method, and how it is called."""


def draw_panels(scene: Scene, result: Result, picture: int, threads: int = 0) -> dict[str, bytes]:
    """PNGs of a method's maps by name, of the ground truth (``true ...``), and the picture."""
    truth = scene.truth
    assert truth is not None
    assert truth.relight_images is not None
    assert truth.relight_lighting is not None
    valid = scene.valid[..., None]
    relit = np.where(valid, truth.relight_images[0], np.nan)
    white = metrics.white_of(relit)
    found, lights = result.materials, truth.relight_lighting[:1]
    [rendered] = render(found, result.normals, lights, result.fov, threads, model=result.model)
    shown = np.where(valid, scene.images[picture], np.nan)
    panels = {"picture": displayed(shown, metrics.white_of(shown))}
    for prefix, materials, light in (("", found, rendered), ("true ", truth.materials, relit)):
        panels |= {
            f"{prefix}albedo": displayed(materials.albedo),
            f"{prefix}roughness": outside_grey(materials.roughness),
            f"{prefix}metallic": outside_grey(materials.metallic),
            f"{prefix}relit": displayed(light, white),
        }
    return {
        name: as_png(np.rint(255 * np.clip(pixels, 0, 1)).astype(np.uint8))
        for name, pixels in panels.items()
    }


def draw_sheet(panels: Mapping[str, Mapping[str, bytes]]) -> bytes:
    """PNG: a row each for the ground truth and every method, and the picture that peers were shown.

    Parameters
    ----------
    panels
        What `draw_panels` made, by the method in words.
    """
    first = next(iter(panels.values()))
    rows: list[Sequence[Panel | None]] = [
        [
            Panel("the picture peers see", _pixels(first["picture"])),
            *(Panel(caption, _pixels(first[f"true {name}"])) for name, caption in MAPS.items()),
        ]
    ]
    for of_method in panels.values():
        rows.append([None, *(Panel("", _pixels(of_method[name])) for name in MAPS)])
    labels = ["ground truth", *panels]
    return as_png(sheet([list(row) for row in rows], labels=labels))


def _pixels(png: bytes) -> NDArray[np.float64]:
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")) / 255.0
