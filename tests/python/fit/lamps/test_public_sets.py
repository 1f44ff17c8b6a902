"""The start on rendered pictures with true normals, of others' making."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from pbrfit import Scene
from pbrfit.fit.lamps.shape import first_shape
from pbrfit.fit.lamps.start import start_of_known_lamps, start_of_unknown_lamps
from pbrfit.fit.windows import without_shape
from pbrfit.io import images
from pbrfit.model.geometry import angles_between

DATA = Path(os.environ.get("PBRFIT_DATA", Path(__file__).parents[4] / "../shared/data"))
BUNNY = DATA / "bunny_ps"

PANELS = DATA / "photographs"

pytestmark = pytest.mark.slow


@pytest.mark.skipif(not PANELS.is_dir(), reason="needs PBRFIT_DATA with photographs")
@pytest.mark.parametrize("name", ["realrti_3", "realrti_4"])
def test_a_panel_stands_upright(name: str) -> None:
    """Other cues do not mind by more than 3 in the logarithm of the likelihood, 60° askew."""
    scene = Scene.load(PANELS / name, max_size=192, color_space="linear")
    mean = first_shape(without_shape(scene)).normals
    mean = np.nanmean(mean, axis=(0, 1))
    assert mean[2] > np.cos(np.radians(15.0)) * np.linalg.norm(mean)


@pytest.mark.skipif(not BUNNY.is_dir(), reason="needs PBRFIT_DATA with bunny_ps")
@pytest.mark.parametrize(
    ("name", "known", "unknown"),
    [("bunny_lambert_noshadow_12", 1.0, 10.0), ("bunny_specular_25", 5.5, 12.0)],
)
def test_bunny(name: str, known: float, unknown: float) -> None:
    true = np.load(BUNNY / "gt_normal.npy").astype(np.float64)
    mask = images.read_data(BUNNY / "mask.png")[..., 0] >= 0.5
    with np.load(BUNNY / f"{name}.npz") as arrays:
        samples = arrays["images"].astype(np.float64)
        lamps = arrays["lights"].astype(np.float64)
    samples = samples if samples.ndim == 4 else samples[..., None]
    usable = np.broadcast_to(mask[..., None], samples.shape)
    views = np.zeros((*mask.shape, 3))
    views[..., 2] = 1.0

    def error(normals: np.ndarray) -> float:
        return float(angles_between(normals, true)[mask].mean())

    equal = np.ones(len(lamps))
    assert error(start_of_known_lamps(samples, usable, mask, views, lamps, equal).normals) < known
    assert error(start_of_unknown_lamps(samples, usable, mask, views).normals) < unknown
