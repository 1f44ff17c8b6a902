"""The interactive view of a result: the model in a fragment shader, under lights to be moved.

`view.html` and `viewer.css` are the markup. `relight.vert` and `relight.frag` are the shaders; what
a kind of light needs of a model stands in `MODEL_sh.glsl`, `MODEL_lamp.glsl` and
`MODEL_environment.glsl`, and is compiled into programs for that kind alone. `viewer.js` is the
view; `planes.js` unpacks the maps, `picture.js` draws them, `light.js` turns SH lights, `lamp.js`
places lamps, `panorama.js` reads panoramas, `environment.js` blurs them, `stage.js` zooms,
`reveal.js` compares, `address.js` reads and writes the page's address. No part needs a server, a
network or a build step.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from html import escape
from string import Template
from typing import Any

import numpy as np

from pbrfit._core import environment_lobes
from pbrfit.display.tone import encoded
from pbrfit.model.reflection import Model, ggx_band_weights
from pbrfit.report import figures, raster
from pbrfit.report.html import address, in_base64, text_of
from pbrfit.report.viewer import film, maps
from pbrfit.report.viewer.film import Tile
from pbrfit.report.viewer.lights import Lighting, exposure_of
from pbrfit.result import differences
from pbrfit.result.differences import PALETTE
from pbrfit.result.result import Result
from pbrfit.result.verdict import PARAMETERS

STATIC_SIDE = 512
"""Longer side of the picture that stands in where the view cannot run."""

DEVIATION_SIDE = 512
"""Longer side of the maps of deviations."""

BAND_NODES = 1025
"""Roughnesses at which the shader knows h_l. Between them it interpolates, off by up to 5e-6."""

TINY_SIDE = 96
"""Maps smaller than this are enlarged pixel by pixel, as their pixels are what one looks at."""

LARGEST_SIDE = 4096
"""Longer side of the maps that a page may hold, in pixels."""

SCRIPTS = (
    "light.js",
    "lamp.js",
    "environment.js",
    "panorama.js",
    "planes.js",
    "picture.js",
    "stage.js",
    "reveal.js",
    "address.js",
    "viewer.js",
)


def fragment(
    result: Result,
    max_side: int = LARGEST_SIDE,
    tiles: Sequence[Tile] | None = None,
    head: str = "",
) -> str:
    """HTML of the view of a result: style, markup, maps and script in one.

    Larger maps are averaged down to `max_side` pixels on the longer side. It decides about the
    size: 2 to 9 bytes for a pixel, times 4/3 as text. `tiles` are the pictures, None = drawn from
    the result; `head` is HTML above the picture. Returns a fragment for the body of a page in
    UTF-8; it refers to nothing outside.
    """
    shown = maps.of_result(result, max_side)
    height, width = shown.mask.shape
    lighting = Lighting(result)
    tiles = film.of_lights(lighting) if tiles is None else tiles
    exposure = exposure_of(lighting.under_lamp(lighting.small))
    data = {
        "width": width,
        "height": height,
        "tangent": math.tan(math.radians(result.fov) / 2),
        "tiny": max(height, width) < TINY_SIDE,
        "units": maps.UNITS,
        "deviations": _deviations(result),
        **lighting.data([tile.exposure for tile in tiles], exposure),
        **_tables(result.model),
    }
    still = lighting.under_lamp(maps.of_result(result, min(max_side, STATIC_SIDE)))
    picture = raster.picture_png(encoded(still, exposure, "neutral"))
    markup = Template(_text("view.html")).substitute(
        head=head,
        picture=in_base64(picture),
        width=width,
        height=height,
        scale=figures.palette_stops(),
        poor=figures.css(PALETTE[differences.VERMILLION]),
        tiles="".join(map(_tile, result.pictures, tiles)),
        compared="".join(
            f'<option value="{escape(name)}">{escape(name)}</option>'
            for name, tile in zip(result.pictures, tiles, strict=True)
            if tile.original
        ),
        data=_json(data),
        maps=in_base64(maps.packed(shown)),
    )
    style = f"<style>\n{_text('viewer.css')}</style>\n"
    return f"{style}{markup}<script>{script(result.model)}</script>\n"


def script(model: Model) -> str:
    """The script in a `fragment`, for the page's `html.policy`."""
    return "\n".join(
        [
            "\n(() => {",
            '"use strict";',
            f"const SHADERS = {_json(_shaders(model))};",
            *map(_text, SCRIPTS),
            "})();\n",
        ]
    )


def _tile(name: str, tile: Tile) -> str:
    original = " data-original" if tile.original else ""
    text = escape(name)
    return (
        f'<label class="relight-tile" title="{text}"><input type="radio" name="light" '
        f'value="{text}"><img src="{tile.address}" alt=""{original} decoding="async">'
        f"<span>{text}</span></label>\n"
    )


def _deviations(result: Result) -> dict[str, str]:
    """Maps of the standard deviations, in the colours of the report, as addresses."""
    if result.uncertainty is None:
        return {}
    of_maps = differences.deviations(result.uncertainty)
    return {
        name: address(
            raster.difference_png(raster.reduced_difference(of_maps[name], DEVIATION_SIDE))
        )
        for name in PARAMETERS
    }


def _shaders(model: Model) -> dict[str, str]:
    """GLSL by what it is: of each kind of light what the model needs."""
    return {
        "vertex": _text("relight.vert"),
        "fragment": _text("relight.frag"),
        "model": _text("principled.glsl") if model == "principled" else "",
        "sh": _text(f"{model}_sh.glsl"),
        "lamps": _text("lamps.glsl") + _text(f"{model}_lamp.glsl"),
        "environment": _text("environment.glsl") + _text(f"{model}_environment.glsl"),
    }


def _tables(model: Model) -> dict[str, Any]:
    """What the shaders of a model take from tables, by name."""
    # By which panoramas are reflected, as float32 texels of four numbers.
    table = environment_lobes(model)
    rows, columns, count = table.shape[:3]
    nodes = in_base64(table.astype("<f4").tobytes())
    found = {"environmentLobes": {"columns": columns * count, "rows": rows, "nodes": nodes}}
    if model == "principled":
        return found | {"lobes": maps.lobes()}
    bands, _ = ggx_band_weights(np.linspace(0, 1, BAND_NODES))
    return found | {"bands": [float(f"{value:.8g}") for value in bands.ravel()]}


def _text(name: str) -> str:
    return text_of(f"viewer/{name}")


def _json(content: Any) -> str:
    """JSON that cannot end the script element it stands in."""
    text = json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c")
