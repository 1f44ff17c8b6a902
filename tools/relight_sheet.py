"""The picture of docs/relight.md: a result relit, above its true materials under the same lights.

python tools/relight_sheet.py DEMO PANORAMA OUT.png, with what `pbrfit demo DEMO` wrote.
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pbrfit import DirectionalLight, Environment, Result, Scene, relight
from pbrfit.display import tone
from pbrfit.io import images
from pbrfit.result.metrics import white_of
from pbrfit.result.sheet import Panel, Row, sheet

SCALE = 2


def main() -> None:
    """Write the sheet, and print how far the rows are apart."""
    demo, sky, out = Path(sys.argv[1]), Path(sys.argv[2]), Path(sys.argv[3])
    found = Result.load(demo / "result")
    truth = Scene.load(demo / "scene").truth
    assert truth is not None
    true = dataclasses.replace(found, materials=truth.materials)
    environment = Environment.read(sky)
    lights: dict[str, NDArray[np.float64] | DirectionalLight | Environment] = {
        "--sh, of light_00": found.lighting[0],
        "--env": environment,
        "--env --rotate 180": environment.turned(180),
        "--light -40,30": DirectionalLight(-40, 30),
        "--light 100,10": DirectionalLight(100, 10),
    }
    rows: list[Row] = [[], []]
    for name, light in lights.items():
        expected, relit = (relight(result, light) for result in (true, found))
        exposure = -np.log2(white_of(expected))
        error = np.sqrt(np.mean((relit - expected) ** 2) / np.mean(expected**2))
        print(f"{name}: RMSE / RMS {error:.3f}")
        for row, caption, picture in zip(
            rows, (name, "true materials"), (relit, expected), strict=True
        ):
            row.append(Panel(caption, _enlarged(tone.encoded(picture, exposure, "neutral"))))
    images.write_png(out, sheet(rows), "srgb")


def _enlarged(shown: NDArray[np.float64]) -> NDArray[np.float64]:
    return shown.repeat(SCALE, axis=0).repeat(SCALE, axis=1)


if __name__ == "__main__":
    main()
