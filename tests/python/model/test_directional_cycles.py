"""The same hard light in Cycles: an independent renderer on directions, units and lobes.

Needs a Python with bpy (`make cycles-env`, or PBRFIT_CYCLES_PYTHON) and skips without.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from pbrfit import DirectionalLight, Materials
from pbrfit.model.reflection import render_directional
from pbrfit_evaluation.cycles import why_not
from pbrfit_evaluation.cycles.process import find_python, run_worker

SIDE = 48
LIGHT = DirectionalLight(60, 30)
FINER = 4
"""Samples a pixel in each direction on our side: a narrow highlight is not even over a pixel."""

# RMS of the difference over RMS radiance. Lambert's law is the same; Cycles has other masking.
BOUNDS = {"matt": 0.001, "0.3": 0.008, "0.5": 0.01, "0.8": 0.035}

pytestmark = pytest.mark.skipif(why_not() is not None, reason=str(why_not()))


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> dict[str, NDArray[np.float32]]:
    folder = tmp_path_factory.mktemp("sun")
    worker = Path(__file__).parents[2] / "support" / "blender_sun.py"
    arguments = [str(x) for x in (LIGHT.azimuth, LIGHT.elevation, SIDE, *BOUNDS)]
    run_worker(find_python(), folder, 300, *arguments, worker=worker)
    return {name: np.load(folder / f"{name}.npy") for name in BOUNDS}


def ours(name: str) -> NDArray[np.float64]:
    """(SIDE, SIDE) radiance of the unit sphere, averaged over pixels; NaN at its rim."""
    fine = SIDE * FINER
    at = (2 * np.arange(fine) + 1 - fine) / fine
    x, y = np.meshgrid(at, -at)
    inside = x**2 + y**2 < 0.85
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    normals = np.where(inside[..., None], np.stack([x, y, z], axis=-1), np.nan)
    if name == "matt":
        radiance = np.maximum(normals @ LIGHT.direction, 0)  # Lambert's law
    else:
        one = np.where(inside, 1.0, np.nan)
        metal = Materials(np.repeat(one[..., None], 3, axis=-1), float(name) * one, one)
        lit = render_directional(metal, normals, LIGHT.direction, np.ones(3), 0.0)
        radiance = lit[..., 0]
    return np.asarray(radiance.reshape(SIDE, FINER, SIDE, FINER).mean(axis=(1, 3)))


@pytest.mark.parametrize("name", BOUNDS)
def test_a_sun_of_irradiance_pi_is_a_light_of_color_one(
    rendered: dict[str, NDArray[np.float32]], name: str
) -> None:
    found = ours(name)
    expected = rendered[name][..., 0].astype(np.float64)
    inside = np.isfinite(found)
    assert inside.sum() > 1000
    error = np.sqrt(np.mean((found - expected)[inside] ** 2) / np.mean(expected[inside] ** 2))
    assert error < BOUNDS[name], f"{name} is off by {error:.4f}"
