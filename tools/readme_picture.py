"""The picture that README.md starts with: what a demo recovered, above the truth.

python tools/readme_picture.py DEMO OUT.png, with what `pbrfit demo DEMO` wrote.
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

from pbrfit import DirectionalLight, Result, Scene, relight
from pbrfit.display import tone
from pbrfit.io import images
from pbrfit.result import metrics
from pbrfit.result.sheet import Panel, Row, displayed, outside_grey, sheet

LAMP = DirectionalLight(-50, 35, (1.6, 1.6, 1.6))


def main() -> None:
    """Write the sheet."""
    demo, out = Path(sys.argv[1]), Path(sys.argv[2])
    found = Result.load(demo / "result")
    scene = Scene.load(demo / "scene")
    assert scene.truth is not None
    true = dataclasses.replace(found, materials=scene.truth.materials)
    picture = scene.images[0]
    white = metrics.white_of(picture)
    again = relight(found, found.lighting[0])
    rows: list[Row] = []
    names = ("albedo", "roughness", "metallic", "under a lamp of your own")
    for result, captions in ((found, names), (true, [""] * len(names))):
        maps = (
            displayed(result.albedo),
            outside_grey(result.roughness),
            outside_grey(result.metallic),
            tone.encoded(relight(result, LAMP)),
        )
        rows.append([Panel(name, pixels) for name, pixels in zip(captions, maps, strict=True)])
    rows[0].insert(0, Panel(f"{found.pictures[0]}, rendered again", displayed(again, white)))
    rows[1].insert(0, Panel("", displayed(picture, white)))
    images.write_png(out, sheet(rows, labels=["recovered", "truth"]), "srgb")


if __name__ == "__main__":
    main()
