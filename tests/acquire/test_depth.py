"""Depth by Marigold and Depth Anything, end to end with tiny networks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquire.tiny_maps import picture, save_tiny_depth_anything, save_tiny_marigold_depth
from pbrfit.acquire import depth as depths
from pbrfit.acquire import marigold


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(save_tiny_marigold_depth(tmp_path_factory.mktemp("marigold_depth")))


@pytest.mark.parametrize("size", [(97, 131), (64, 64)])
def test_marigold_gives_relative_depth_of_any_size(network: str, size: tuple[int, int]) -> None:
    options: dict[str, Any] = {"model": network, "device": "cpu"}
    found, record = marigold.depth_of(picture(*size), ensemble=2, **options)
    assert found.shape == size
    assert np.isfinite(found).all()
    assert np.ptp(found) > 0
    assert (record["model"], record["ensemble"], record["resolution"]) == (network, 2, 64)
    same, _ = marigold.depth_of(picture(*size), ensemble=2, **options)
    np.testing.assert_array_equal(found, same)
    other, _ = marigold.depth_of(picture(*size), ensemble=2, seed=5, **options)
    assert np.abs(found - other).max() > 1e-4


@pytest.mark.parametrize("metric", [True, False])
def test_depth_anything_says_what_its_depth_is(tmp_path: Path, metric: bool) -> None:
    model = str(save_tiny_depth_anything(tmp_path, metric=metric))
    found, is_metric, record = depths.by_depth_anything(picture(97, 131), model=model, device="cpu")
    assert is_metric == metric == record["metric"]
    assert found.shape == (97, 131)
    assert np.isfinite(found).all()
