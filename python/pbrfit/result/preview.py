"""Pictures for people: the preview of a result, and the contact sheet of a scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from pbrfit.model.materials import Materials
from pbrfit.result import differences, metrics
from pbrfit.result.data import ResultData
from pbrfit.result.differences import PALETTE, Difference
from pbrfit.result.relighting import DirectionalLight, relight
from pbrfit.result.sheet import Key, Panel, Row, displayed, outside_grey, sheet
from pbrfit.result.verdict import MARKS, PARAMETERS
from pbrfit.scene.arrays import SceneArrays
from pbrfit.values.arrays import Array, Codes, Floats, Mask

SHOWN, ACROSS = 24, 4
"""Pictures of a scene on its contact sheet at most, and those in a row."""

LAMP = DirectionalLight(-25.0, 30.0)
"""What a preview is lit by first."""


def preview(result: ResultData, scene: SceneArrays | None = None) -> Codes:
    """Sheet of a result: (H, W, 3) uint8 sRGB.

    Rows: the result under a lamp from the upper left, a picture (with `scene`), its reconstruction
    and residuals; maps, with verdicts; ground truth and errors; deviations; given and refined
    normals and the angle between them. Each where it is known, around the mask. All differences
    share one scale, angles by radians.
    """
    rows: list[Row] = [_pictures(result, scene)]
    labels = ["", "recovered"]
    # Names of the maps stand above the first row of them alone.
    of_normals = "normals" if result.normal_change is None else "normals, refined"
    verdicts = result.verdicts
    maps = [
        replace(one, note=verdicts[name].in_words(), mark=MARKS[verdicts[name].level])
        if name in verdicts
        else one
        for name, one in zip(PARAMETERS, _maps(result.materials, PARAMETERS), strict=True)
    ]
    rows.append([*maps, _normals(result.normals, of_normals)])
    ticks, white = differences.tick_places(), differences.WHITE
    keys = []
    if scene is not None:
        left_out = scene.weights is not None or scene.limits is not None
        not_used = {"not used": white} if left_out else {}
        keys.append(_key("residual, relative to the picture's RMS", ticks, not_used))
    truth = None if scene is None else scene.truth
    if truth is not None:
        rows.append([*_maps(truth.materials)])
        rows.append(_differences(differences.errors(result.materials, truth.materials)))
        labels += ["ground truth", "error"]
        keys.append(_key("error", ticks, {}))
    if result.uncertainty is not None:
        of_maps = differences.deviations(result.uncertainty)
        rows.append(_differences(of_maps))
        labels.append("deviation")
        marks = differences.deviation_marks(of_maps.values())
        keys.append(_key("standard deviation", ticks, marks))
    if result.given_normals is not None and result.normal_change is not None:
        rows.append(
            [
                _normals(result.given_normals, "given"),
                _normals(result.normals, "refined"),
                Panel("change", _painted(differences.turned(result.normal_change))),
            ]
        )
        labels.append("normals")
        as_it_was = {"unchanged": white}
        keys.append(_key("change of the normals", differences.tick_places(degrees=True), as_it_was))
    height, width = result.mask.shape
    title = f"{len(result.pictures)} pictures of {width} x {height}"
    if result.held_out is not None:
        title += f"; {result.held_out.in_words()}"
    # Without what lies outside the box around the mask.
    inside = tuple(slice(of.min(), of.max() + 1) for of in np.nonzero(result.mask))
    rows = [[one and replace(one, pixels=one.pixels[inside]) for one in row] for row in rows]
    return sheet(rows, title=title, labels=labels, keys=keys)


def contact_sheet(scene: SceneArrays) -> Codes:
    """Sheet for checking a scene: (H, W, 3) uint8 sRGB.

    A row about given normals; up to `SHOWN` pictures, evenly spread and all of one exposure, each
    above its histogram: from black to white in sRGB codes, the fullest class as high as the panel.
    """
    rows, keys = [], []
    if scene.normals_known:
        rows.append(_given_normals(scene))
        if scene.normal_sigma is not None:
            ticks = differences.tick_places(degrees=True)
            keys = [_key("standard deviation of the normals", ticks, {})]
    count = len(scene.images)
    chosen = np.unique(np.linspace(0, count - 1, min(count, SHOWN)).round().astype(int))
    found = [
        metrics.showable(scene.images[i], scene.valid, scene.channel_weights(i)) for i in chosen
    ]
    white = max(white for _, white in found)
    for first in range(0, len(chosen), ACROSS):
        of_row = range(first, min(first + ACROSS, len(chosen)))
        pictures = [np.where(scene.valid[..., None], found[k][0], np.nan) for k in of_row]
        names = [scene.names[chosen[k]] for k in of_row]
        shown = [displayed(picture, white) for picture in pictures]
        rows.append([Panel(name, picture) for name, picture in zip(names, shown, strict=True)])
        rows.append([Panel("", _histogram(picture, scene.valid)) for picture in shown])
    title = f"{count} pictures of {scene.width} x {scene.height}"
    if len(chosen) < count:
        title += f", {len(chosen)} of them shown"
    return sheet(rows, title=title, keys=keys)


def _histogram(picture: Floats, inside: Mask) -> Floats:
    """(H, W, 3): how often values in [0, 1] occur, as coloured areas on white, where `inside`."""
    height, width = inside.shape
    drawn = np.ones((height, width, 3))
    classes = np.arange(width) * 64 // width
    for channel in range(3):
        counts, _ = np.histogram(picture[inside, channel], 64, (0.0, 1.0))
        tops = height * counts[classes] / counts.max()
        area = np.arange(height, 0, -1)[:, None] <= tops
        drawn[area] *= 0.45 + 0.55 * np.eye(3)[channel]
    return drawn


def _given_normals(scene: SceneArrays) -> Row:
    """The normals, n·v, and their standard deviation where it is known."""
    cosine = np.einsum("...i,...i->...", scene.normals, scene.views)
    facing = np.repeat(outside_grey(cosine)[..., :1], 3, axis=-1)
    facing[cosine <= 0] = (0.84, 0.37, 0.0)  # vermillion, told apart by all common colour vision
    row: Row = [
        _normals(scene.normals, "normals: R right, G up"),
        Panel("n·v, orange faces away", facing),
    ]
    if scene.normal_sigma is not None:
        sigma = Difference(np.radians(scene.normal_sigma))
        row.append(Panel("standard deviation", _painted(sigma)))
    return row


def _pictures(result: ResultData, scene: SceneArrays | None) -> Row:
    """Relit, the first picture, its reconstruction, and the residual, as far as there are any."""
    relit = relight(result, LAMP)
    panels: Row = [Panel("relit", displayed(relit, metrics.white_of(relit)))]
    reconstruction, name = relight(result, picture=0), result.pictures[0]
    if scene is None:
        white = metrics.white_of(reconstruction)
        return [*panels, Panel(f"reconstruction of {name}", displayed(reconstruction, white))]
    weights = scene.channel_weights(0)
    residual, _, _ = differences.residual(reconstruction, scene.images[0], weights)
    picture, white = metrics.showable(scene.images[0], result.mask, weights)
    return [
        *panels,
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


def _normals(normals: Floats, caption: str) -> Panel:
    return Panel(caption, outside_grey(0.5 + 0.5 * normals))


def _differences(maps: Mapping[str, Difference]) -> Row:
    return [Panel("", _painted(maps[name])) for name in PARAMETERS]


def _key(caption: str, ticks: Mapping[float, str], marks: Mapping[str, int]) -> Key:
    patches = {label: PALETTE[index] for label, index in marks.items()}
    return Key(caption, PALETTE[: differences.STEPS], ticks, patches)


def _painted(difference: Difference) -> Array:
    return PALETTE[difference.indices()]
