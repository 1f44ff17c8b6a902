"""Pictures for people: the preview of a result and plots of its history."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pbrfit.model.materials import Materials
from pbrfit.result import differences, metrics
from pbrfit.result.data import ResultData
from pbrfit.result.differences import PALETTE, Difference
from pbrfit.result.relighting import rendered_picture
from pbrfit.result.sheet import Key, Panel, Row, displayed, outside_grey, sheet
from pbrfit.result.verdict import MARKS, PARAMETERS
from pbrfit.scene.arrays import SceneArrays


def preview(result: ResultData, scene: SceneArrays | None = None) -> NDArray[np.uint8]:
    """Sheet of a result: (H, W, 3) uint8 sRGB.

    Rows: a picture (with `scene`), its reconstruction and residuals; maps, with verdicts; ground
    truth and errors; deviations; given and refined normals and the angle between them. Each where
    it is known. All differences share one scale, angles by radians.
    """
    rows: list[Row] = [_pictures(result, scene)]
    labels = ["", "recovered"]
    # Names of the maps stand above the first row of them alone.
    of_normals = "normals" if result.normal_change is None else "normals, refined"
    verdicts = {} if result.uncertainty is None else result.uncertainty.verdicts
    maps = [
        replace(one, note=verdicts[name].in_words(), mark=MARKS[verdicts[name].level])
        if name in verdicts
        else one
        for name, one in zip(PARAMETERS, _maps(result.materials, PARAMETERS), strict=True)
    ]
    rows.append([*maps, _normals(result.normals, of_normals)])
    on_scale = ["residual, relative to the picture's RMS"] if scene is not None else []
    left_out = scene is not None and (scene.weights is not None or scene.limits is not None)
    white = ["not used"] if left_out else []
    marks: dict[str, tuple[float, float, float]] = {}
    truth = None if scene is None else scene.truth
    if truth is not None:
        rows.append([*_maps(truth.materials)])
        rows.append(_differences(differences.errors(result.materials, truth.materials)))
        labels += ["ground truth", "error"]
        on_scale.append("error")
    if result.uncertainty is not None:
        of_maps = differences.deviations(result.uncertainty)
        rows.append(_differences(of_maps))
        labels.append("deviation")
        on_scale.append("standard deviation")
        for label, index in differences.deviation_marks(of_maps.values()).items():
            if index == differences.WHITE:
                white.insert(0, label)
            else:
                marks[label] = _color(index)
    if white:
        marks = {" or ".join(white): _color(differences.WHITE)} | marks
    keys = []
    if on_scale:
        keys.append(_key("; ".join(on_scale), differences.tick_places(), marks))
    if result.given_normals is not None and result.normal_change is not None:
        rows.append(
            [
                _normals(result.given_normals, "given"),
                _normals(result.normals, "refined"),
                Panel("change", _painted(differences.turned(result.normal_change))),
            ]
        )
        labels.append("normals")
        as_it_was = {"unchanged": _color(differences.WHITE)}
        keys.append(_key("change of the normals", differences.tick_places(degrees=True), as_it_was))
    height, width = result.mask.shape
    # No run time: the same input gives the same bits.
    title = (
        f"{len(result.pictures)} pictures of {width} x {height}, "
        f"{result.history.iterations} iterations"
    )
    if result.held_out is not None:
        title += f"; {result.held_out.in_words()}"
    return sheet(rows, title=title, labels=labels, keys=keys)


def normals_preview(scene: SceneArrays) -> NDArray[np.uint8]:
    """Sheet for checking normals: (H, W, 3) uint8 sRGB.

    The first picture, the normals, n·v, and their standard deviation, where the scene has it.
    """
    cosine = np.einsum("...i,...i->...", scene.normals, scene.views)
    facing = np.repeat(outside_grey(cosine)[..., :1], 3, axis=-1)
    facing[cosine <= 0] = (0.84, 0.37, 0.0)  # vermillion, told apart by all common colour vision
    image, white = metrics.showable(scene.images[0], scene.valid, scene.channel_weights(0))
    image = np.where(scene.valid[..., None], image, np.nan)
    row: Row = [
        Panel(f"picture {scene.names[0]}", displayed(image, white)),
        Panel("normals: R right, G up", outside_grey(0.5 + 0.5 * scene.normals)),
        Panel("n·v, orange faces away", facing),
    ]
    if scene.normal_sigma is None:
        return sheet([row])
    sigma = Difference(np.radians(scene.normal_sigma))
    ticks = differences.tick_places(degrees=True)
    return sheet(
        [[*row, Panel("standard deviation", _painted(sigma))]],
        keys=[_key("standard deviation of the normals", ticks, {})],
    )


def _pictures(result: ResultData, scene: SceneArrays | None) -> Row:
    """The first picture, its reconstruction, and the residual, as far as there are pictures."""
    reconstruction = rendered_picture(result, 0)
    name = result.pictures[0]
    if scene is None:
        white = metrics.white_of(reconstruction)
        return [Panel(f"reconstruction of {name}", displayed(reconstruction, white))]
    weights = scene.channel_weights(0)
    residual = differences.residual(reconstruction, scene.images[0], weights)
    picture, white = metrics.showable(scene.images[0], result.mask, weights)
    return [
        Panel(f"picture {name}", displayed(picture, white)),
        Panel("reconstruction", displayed(reconstruction, white)),
        Panel("residual", _painted(residual)),
    ]


def _maps(materials: Materials, captions: Sequence[str] = ("", "", "")) -> list[Panel]:
    albedo, roughness, metallic = captions
    return [
        Panel(albedo, displayed(materials.albedo)),
        Panel(roughness and f"{roughness}, white = 1", outside_grey(materials.roughness)),
        Panel(metallic and f"{metallic}, white = 1", outside_grey(materials.metallic)),
    ]


def _normals(normals: NDArray[np.float64], caption: str) -> Panel:
    return Panel(caption, outside_grey(0.5 + 0.5 * normals))


def _differences(maps: Mapping[str, Difference]) -> Row:
    return [Panel("", _painted(maps[name])) for name in PARAMETERS]


def _key(
    caption: str, ticks: Mapping[float, str], marks: Mapping[str, tuple[float, float, float]]
) -> Key:
    return Key(caption, PALETTE[: differences.STEPS], ticks, marks)


def _painted(difference: Difference) -> NDArray[np.float64]:
    return PALETTE[difference.indices()]


def _color(index: int) -> tuple[float, float, float]:
    red, green, blue = PALETTE[index].tolist()
    return red, green, blue
