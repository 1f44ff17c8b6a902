"""How far the relight view's pixels are from the package's: the table of docs/report.md.

    python tools/relight_view_errors.py RESULT PANORAMA.hdr...

RESULT is shown by either model, and so are random materials.

Needs playwright and a Chromium, as the tests do, whose helpers it uses.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))

from browser import launched
from pbrfit import Environment, Result
from pbrfit.display.tone import ToneMap
from pbrfit.model.reflection import MODELS
from pbrfit.result.relighting import DirectionalLight
from relight_view import View, expected, made, opened

Pair = tuple[NDArray[np.uint8], NDArray[np.uint8]]

RANDOM_SIZE = (683, 1024)
LAMPS = [(-35, 35), (0, 0), (60, -20), (-80, 10), (10, 85)]
"""Azimuth and elevation in degrees."""

SHOWN: list[tuple[float, ToneMap]] = [(0.0, "none"), (1.5, "neutral")]
"""Exposures and tone maps."""


def main() -> None:
    """Print the table as Markdown."""
    folder, *files = map(Path, sys.argv[1:])
    maps = {str(folder): Result.load(folder), "random": made(*RANDOM_SIZE)}
    results = {
        f"{name}, {model}": replace(result, model=model)
        for name, result in maps.items()
        for model in MODELS
    }
    print("| maps | light | samples | mean | largest | share above 2 |\n|---|---|---|---|---|---|")
    with launched() as browser, tempfile.TemporaryDirectory() as place:
        for name, result in results.items():
            with opened(browser, result, Path(place)) as view:
                print_row(name, "its own lights", own_lights(view, result))
                print_row(name, f"{len(LAMPS)} lamps", lamps(view, result))
                if files:
                    print_row(name, f"{len(files)} panoramas", panoramas(view, result, files))


def own_lights(view: View, result: Result) -> Iterator[Pair]:
    """Pixels of the view and of the package under each recovered light."""
    for i, name in enumerate(result.pictures):
        for exposure, tone_map in SHOWN:
            view.go(f"light={name}&exposure={exposure}&tone={tone_map}")
            stops = view.automatic() + exposure
            light = result.lights[i]
            yield view.saved(), expected(result, light, exposure=stops, tone_map=tone_map)


def lamps(view: View, result: Result) -> Iterator[Pair]:
    """Pixels of the view and of the package under hard light."""
    for azimuth, elevation in LAMPS:
        light = DirectionalLight(azimuth, elevation)
        for exposure, tone_map in SHOWN:
            view.go(
                f"azimuth={azimuth}&elevation={elevation}&ambient=0&exposure={exposure}"
                f"&tone={tone_map}"
            )
            stops = view.automatic() + exposure
            yield view.saved(), expected(result, light, exposure=stops, tone_map=tone_map)


def panoramas(view: View, result: Result, files: list[Path]) -> Iterator[Pair]:
    """Pixels of the view and of the package under panoramas."""
    view.go("tone=none")
    for file in files:
        view.open(file)
        light = Environment.read(file)
        yield view.saved(), expected(result, light, exposure=view.automatic())


def print_row(maps: str, light: str, pairs: Iterator[Pair]) -> None:
    """One row: differences of all pairs."""
    apart = np.concatenate(
        [
            np.abs(found[..., :3].astype(np.int16) - true[..., :3])[true[..., 3] > 0].ravel()
            for found, true in pairs
        ]
    )
    print(
        f"| {maps} | {light} | {apart.size:,} | {apart.mean():.3f} | {apart.max()} "
        f"| {np.mean(apart > 2):.0e} |"
    )


if __name__ == "__main__":
    main()
