"""The interactive relight view of a report: the model in a fragment shader, under lights to turn.

`view.html` and `viewer.css` are the markup, `relight.vert` and `relight.frag` the shaders, with
the model of the result from `paper.glsl` or `principled.glsl`.
`viewer.js` is the view; `planes.js` unpacks the maps, `picture.js` draws them, `light.js` turns
lights and `panorama.js` reads them. No part needs a server, a network or a build step.
"""

from __future__ import annotations

import json
import math
from html import escape
from importlib.resources import files
from string import Template
from typing import Any

import numpy as np

from pbrfit.io.display import encoded
from pbrfit.model.reflection import ggx_band_weights, render
from pbrfit.report.html import in_base64
from pbrfit.report.raster import picture_png, reduced
from pbrfit.report.viewer import lobes, maps
from pbrfit.result import metrics
from pbrfit.result.result import Result

STATIC_SIDE = 512
"""Longer side of the picture that stands in where the view cannot run."""

BAND_NODES = 1025
"""Roughnesses at which the shader knows h_l. Between them it interpolates, off by up to 5e-6."""

TINY_SIDE = 96
"""Maps smaller than this are enlarged pixel by pixel, as their pixels are what one looks at."""

WIDEST = 8
"""Ratio of the sides of the view, at most: a narrower picture has room around it to drag in."""

SCRIPTS = ("light.js", "panorama.js", "planes.js", "picture.js", "viewer.js")


def fragment(result: Result, max_side: int = 1024) -> str:
    """HTML of the relight view of a result: style, markup, maps and script in one.

    Larger maps are averaged down to `max_side` pixels on the longer side. It decides about the
    size: 2 to 9 bytes for a pixel, times 4/3 as text. Returns a fragment for the body of a page in
    UTF-8; it refers to nothing outside. Raises InputError if `max_side` is below 1.
    """
    small = maps.of_result(result, max_side)
    height, width = small.mask.shape
    # Of lamps, which the view's shader does not know, what l <= 3 holds.
    lights = result.sh_lighting()
    first = render(small.materials, small.normals, lights[0], result.fov, model=result.model)
    white = metrics.white_of(first) if small.mask.any() else 1.0
    exposure = round(0.0 - math.log2(white), 1)
    data = {
        "width": width,
        "height": height,
        "tangent": math.tan(math.radians(result.fov) / 2),
        "exposure": exposure,
        "units": maps.UNITS,
        "lights": [
            {"name": name, "coefficients": light.ravel().tolist()}
            for name, light in zip(result.pictures, lights, strict=True)
        ],
        **_table(result.model),
    }
    markup = Template(_text("view.html")).substitute(
        first=escape(result.pictures[0]),
        picture=in_base64(picture_png(reduced(encoded(first, exposure), STATIC_SIDE))),
        data=_json(data),
        maps=in_base64(maps.packed(small)),
    )
    tiny = " data-tiny" if max(height, width) < TINY_SIDE else ""
    stage = min(max(width / height, 1 / WIDEST), WIDEST)
    aspect = f' style="--relight-aspect: {stage:.6g}"'
    markup = markup.replace('data-state="loading"', f'data-state="loading"{tiny}{aspect}', 1)
    shown = _text("relight.frag").replace("MODEL\n", _text(f"{result.model}.glsl"), 1)
    shaders = _json({"vertex": _text("relight.vert"), "fragment": shown})
    script = "\n".join(
        ["(() => {", '"use strict";', f"const SHADERS = {shaders};", *map(_text, SCRIPTS), "})();"]
    )
    return f"<style>\n{_text('viewer.css')}</style>\n{markup}<script>\n{script}\n</script>\n"


def _table(model: str) -> dict[str, Any]:
    """What the shader of a model takes from a table, by name."""
    if model == "principled":
        return {"lobes": lobes.data()}
    bands, _ = ggx_band_weights(np.linspace(0, 1, BAND_NODES))
    return {"bands": [float(f"{value:.8g}") for value in bands.ravel()]}


def _text(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


def _json(content: Any) -> str:
    """JSON that cannot end the script element it stands in."""
    text = json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c")
