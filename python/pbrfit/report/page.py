"""The page of a result: its sections put together, small enough to be sent."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

from pbrfit.io.json_files import as_json
from pbrfit.io.resampling import reduced_size
from pbrfit.model.reflection import Model
from pbrfit.report import (
    budget,
    figures,
    held_out,
    lamps,
    maps,
    normals,
    surroundings,
    verdict,
    viewer,
)
from pbrfit.report import lights as of_lights
from pbrfit.report import pictures as of_pictures
from pbrfit.report.html import (
    THEME_BUTTON,
    Cell,
    Table,
    document,
    heads,
    number,
    paragraph,
    table,
    text_of,
)
from pbrfit.report.notation import angle, percent, plain
from pbrfit.report.pictures import Picture
from pbrfit.result import differences
from pbrfit.result.advice import next_steps
from pbrfit.result.drawing import draw_history
from pbrfit.result.metrics import PROTOCOL
from pbrfit.result.result import Result
from pbrfit.scene.scene import Scene
from pbrfit.threads import in_pieces

OPEN_TABLE = 24
"""Tables with more rows are folded away."""

PLOTTED = 5
"""Points of a history below which a plot says no more than the table of stages."""

TITLES = {
    "summary": "How the fit went",
    "maps": "Maps",
    "pictures": "Pictures and residuals",
    "lights": "Lights",
    "lamps": "Lamps",
    "surroundings": "Surroundings",
    "history": "Error against run time",
    held_out.ANCHOR: "How it was chosen",
    "origin": "Run details",
}
"""Headings by anchor, in their order; sections without content are left out."""

REFLECTION: Mapping[Model, str] = {
    "paper": "Surfaces reflect by the paper's model, eq. 12, which no renderer has: metals "
    "and dark glossy surfaces of these maps look different there.",
    "principled": "Surfaces reflect by the principled model, as in Blender, glTF and game engines, "
    "integrated over the light: the maps mean the same there.",
}
"""What the maps are maps of."""


def page(result: Result, scene: Scene | None, remark: str) -> str:
    """HTML of a result, at most `budget.LIMIT` bytes; the remark says why there is no scene."""
    longer = max(result.mask.shape)
    pictures = of_pictures.examine(result, scene, budget.SIDES[0])
    tiles = None
    if scene is not None:
        tiles = viewer.film.of_scene(
            scene, [one.white for one in pictures], budget.FILM_SHARE * budget.LIMIT
        )
    view, (view_side, _) = budget.largest_that_fits(
        lambda choice: viewer.fragment(result, choice[0], tiles, _head(result)),
        [one for one in budget.choices(longer, budget.VIEW_SIDES) if one[1]],
        budget.VIEW_SHARE * budget.LIMIT,
    )
    truth = None
    if scene is not None and scene.truth is not None and "albedo_rmse" in result.metrics:
        truth = scene.truth.materials
    blocks = [*maps.blocks(result, truth), *normals.blocks(result)]
    tables = "".join(table(content) for content in verdict.key_numbers(result, pictures))
    fixed = {
        "relight": view,
        "summary": "".join(paragraph(text) for text in verdict.sentences(result, pictures))
        + f'<div class="numbers">{tables}</div>'
        + _size_remark("Maps of the view above", view_side, result),
        "lamps": lamps.section(result),
        "surroundings": surroundings.section(result),
        "history": _history(result),
        held_out.ANCHOR: held_out.section(result),
        "origin": _origin(result),
    }

    def whole(choice: budget.Choice) -> str:
        side, count = choice
        chosen = [pictures[i] for i in np.linspace(0, len(pictures) - 1, count).round().astype(int)]
        of_choice = {
            "maps": _size_remark("Maps", side, result) + maps.section(blocks, result, side),
            "pictures": _pictures(scene, remark, pictures, chosen, side),
            "lights": _lights(pictures, chosen) if result.lamps is None else "",
        }
        return _document(result, fixed | of_choice)

    every = budget.choices(longer, budget.SIDES, len(pictures))
    return budget.largest_that_fits(whole, every, budget.LIMIT)[0]


def _document(result: Result, sections: Mapping[str, str]) -> str:
    body = [
        sections["relight"],
        "<main>",
        *(
            f'<section id="{key}"><details{" open" * (key == "summary")}>'
            f"<summary><h2>{escape(title)}</h2></summary>{sections[key]}</details></section>"
            for key, title in TITLES.items()
            if sections[key]
        ),
        "</main>",
    ]
    return document(
        _title(result),
        "\n".join(body),
        style=text_of("style.css"),
        script=text_of("enlarge.js"),
        within=[viewer.script(result.model)],
        look="report",
    )


def _head(result: Result) -> str:
    """What stands above the picture: title, usable maps, what is explained, what would help."""
    verdicts = f'<div class="verdicts">{verdict.chips(result)}</div>'
    notes = [held_out.sentence(result)]
    notes += [f"Next: {escape(one)}." for one in next_steps(result)[:1]]
    if reduced := result.assumed.get("size"):
        notes.append(f"{max(result.mask.shape)} px fit: {escape(reduced)}.")
    told = f'<p class="told">{" ".join(filter(None, notes))}</p>'
    return f"<header><h1>{escape(_title(result))}</h1>{verdicts}{THEME_BUTTON}{told}</header>"


def _title(result: Result) -> str:
    count = len(result.pictures)
    of = f"{count} pictures" if count > 1 else "one picture"
    name = result.source.path.name if result.source is not None else ""
    # A folder that is called scene has no name yet.
    return f"{name}: materials from {of}" if name not in ("", "scene") else f"Materials from {of}"


def _size_remark(what: str, side: int, result: Result) -> str:
    height, width = reduced_size(result.mask.shape, side)
    said = f"have the resolution of the fit, {width} × {height}"
    if (height, width) != result.mask.shape:
        full = f"{result.mask.shape[1]} × {result.mask.shape[0]}"
        said = f"are averaged down from {full} to {width} × {height}"
    return paragraph(f"{what} {said} pixels.", "note")


def _pictures(
    scene: Scene | None,
    remark: str,
    pictures: Sequence[Picture],
    chosen: Sequence[Picture],
    side: int,
) -> str:
    shown, count = len(chosen), len(pictures)
    size = height, width = reduced_size(pictures[0].radiance[0].shape, side)
    text = f"{width} × {height} pixels each."
    if shown < count:
        text = (
            f"{shown} of {count} pictures are shown, evenly spread, and {count - shown} left out, "
            f"to keep the page small. {text}"
        )
    parts = [paragraph(text, "note")]
    if scene is None:
        parts.append(paragraph(remark))
        parts.append(paragraph("White is the 98th percentile of each reconstruction.", "note"))
    else:
        parts.append(paragraph(_how_to_read(pictures)))
        weighed = scene.weights is not None or scene.limits is not None
        marks = {"left out: clipped, dark or of weight 0": differences.WHITE} if weighed else {}
        parts.append(figures.difference_key("residual, relative to the picture's RMS", marks))
    cards = in_pieces(0, lambda one: _card(one, side, size), chosen)
    parts.append(figures.grid(cards, "pictures" if scene is not None else "maps"))
    if scene is not None:
        title = f"Residuals of all {len(pictures)} pictures"
        parts.append(_numbers(title, of_pictures.table(pictures)))
    return "".join(parts)


def _how_to_read(pictures: Sequence[Picture]) -> str:
    text = (
        "The picture, its reconstruction from the maps and its light, and the difference. Both "
        "have the same exposure: white is the 98th percentile of the picture. The colours of the "
        "residual mean the same in all pictures, and on all pages."
    )
    names = [
        f"{one.name} ({percent(one.fit.share)})" for one in of_pictures.worst(pictures) if one.fit
    ]
    if len(pictures) > len(names):
        text += f" Largest residuals: {', '.join(names)}."
    return text


def _card(one: Picture, side: int, size: tuple[int, int]) -> str:
    made = one.files(side)
    if one.fit is None:
        [file] = made
        content = figures.picture(file, size, f"Reconstruction of {one.name}")
        return figures.figure(content, one.name, "reconstruction")
    alts = (f"Picture {one.name}", f"Reconstruction of {one.name}", f"Residual of {one.name}")
    content = "".join(figures.picture(of, size, alt) for of, alt in zip(made, alts, strict=True))
    remark = f"RMSE {plain(one.fit.rmse)}, {percent(one.fit.share)} relative to the picture's RMS"
    if one.fit.left_out > 0:
        remark += f"; {percent(one.fit.left_out)} of the samples left out"
    return figures.figure(f'<div class="three">{content}</div>', one.name, remark)


def _lights(pictures: Sequence[Picture], chosen: Sequence[Picture]) -> str:
    text = (
        "Each light on a matt white ball, on a mirror, and as a panorama of all directions: the "
        "centre is into the picture, away from the viewer, right is right, up is up; light that "
        "comes from the viewer is at the left and right edge. The ring marks the main direction, "
        "hatching where radiance is negative, as a sum of spherical harmonics can be; "
        "the patch is the mean colour. Each light has its own exposure: white is the 98th "
        "percentile of its panorama."
    )
    parts = [paragraph(text)]
    if len(chosen) < len(pictures):
        parts.append(paragraph("Lights of the pictures that are shown above.", "note"))
    parts.append(figures.grid(map(_light, chosen), "lights"))
    parts.append(_numbers(f"All {len(pictures)} lights in numbers", _light_table(pictures)))
    return "".join(parts)


def _light(one: Picture) -> str:
    assert one.light_pngs is not None
    balls, radiance = one.light_pngs
    content = figures.picture(
        balls, of_lights.BALLS_SIZE, f"Light of {one.name} on a white and a mirror ball"
    ) + figures.picture(radiance, of_lights.PANORAMA_SIZE, f"Panorama of the light of {one.name}")
    light = one.light
    remark = (
        f"from azimuth {angle(light.azimuth)}, elevation {angle(light.elevation)}; "
        f"negative {percent(light.negative)}"
    )
    color = f'<span class="patch" style="background:{figures.css_of_light(light.color)}"></span>'
    return figures.figure(f'<div class="light">{content}{color}</div>', one.name, remark)


def _light_table(pictures: Sequence[Picture]) -> Table:
    names = ("mean radiance", "azimuth", "elevation", "directed", "colour R, G, B", "negative")
    rows = [
        [
            Cell(one.name),
            number(plain(one.light.mean), one.light.mean),
            number(angle(one.light.azimuth), one.light.azimuth),
            number(angle(one.light.elevation), one.light.elevation),
            number(percent(one.light.directed), one.light.directed),
            number(", ".join(f"{part:.2f}" for part in one.light.color)),
            number(percent(one.light.negative), one.light.negative),
        ]
        for one in pictures
    ]
    caption = (
        "Mean radiance over all directions, in the pictures' unit. Azimuth 0 is the viewer, "
        "positive to the right; elevation is up. Directed: 0 % for uniform light, 100 % for one "
        "direction. Negative: luminance of negative radiance as a share of that of positive "
        "radiance; 45 % for light from a single direction, cut at l = 3."
    )
    return Table(heads("picture", *names), rows, caption)


def _history(result: Result) -> str:
    if len(result.history.rows) < PLOTTED:
        return _stages(result)
    what = "Root mean square errors against run time and against iterations"
    text = "Residual of the pictures" + (
        " and errors of the maps against ground truth"
        if "albedo_rmse" in result.history.columns
        else ""
    )
    return (
        paragraph(f"{text}, while the fit ran. history.csv has the numbers.")
        + figures.plot(draw_history(result.history), what)
        + _stages(result)
    )


def _stages(result: Result) -> str:
    """What ran, one after the other; nothing for results of a version that did not tell."""
    if not result.stages:
        return ""
    rows = [
        (Cell(one.name, "name"), number(f"{one.seconds:.2f}", one.seconds), Cell(one.note))
        for one in result.stages
    ]
    columns = [*heads("stage", "seconds"), Cell("")]
    return table(Table(columns, rows, f"Stages of solver {result.options.solver}:"))


def _origin(result: Result) -> str:
    from pbrfit import __version__

    parts = [f"<h3>Assumptions</h3>{_list(result.assumed)}"] if result.assumed else []
    if result.left_out:
        items = "".join(f"<li>{escape(line)}</li>" for line in result.left_out)
        parts.append(f"<h3>Left out</h3><ul>{items}</ul>")
    options = {name: json.dumps(value) for name, value in as_json(result.options).items()}
    parts.append(_folded("Options", _list(options)))
    if result.inputs:
        rows = [(Cell(name), Cell(digest, "hash")) for name, digest in result.inputs.items()]
        files = table(Table((Cell("file"), Cell("SHA-256")), rows))
        parts.append(_folded(f"Input files ({len(result.inputs)})", files))
    conventions = (
        "Camera space has X to the right, Y up, Z towards the viewer. Colours are linear "
        "Rec.709 with white D65, except as pictures on this page, which have the sRGB curve.",
        "Lights are real spherical harmonics without Condon–Shortley phase up to l = 3, index "
        "l(l+1)+m, and point from the surface to where light comes from.",
        REFLECTION[result.model],
    )
    parts += ["<h3>Conventions</h3>", *map(paragraph, conventions)]
    parts.append(paragraph(f"Errors: {PROTOCOL}. Page written by pbrfit {__version__}.", "note"))
    return "".join(parts)


def _list(entries: Mapping[str, str]) -> str:
    return table(Table((), [(Cell(name, "name"), Cell(text)) for name, text in entries.items()]))


def _numbers(title: str, content: Table) -> str:
    """A table that is folded where it is long, except on paper."""
    opened = "" if len(content.rows) > OPEN_TABLE else " open"
    return _folded(title, table(content), f' class="numbers-of-all"{opened}')


def _folded(title: str, content: str, how: str = "") -> str:
    return f"<details{how}><summary>{escape(title)}</summary>{content}</details>"
