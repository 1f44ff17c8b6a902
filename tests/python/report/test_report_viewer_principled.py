"""The relight view of results of the principled model: its pixels are those of the package."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from test_report_viewer import AT_MOST, BAND_MASK

from browser import launched
from pbrfit import Result
from pbrfit.model import panorama
from pbrfit.model.lighting import rotated
from pbrfit.report.viewer import fragment
from relight_view import difference, expected, made, opened, room

if TYPE_CHECKING:
    from playwright.sync_api import Browser


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with launched() as found:
        yield found


@pytest.fixture(scope="module")
def furnished() -> Result:
    return principled(room())


def principled(result: Result) -> Result:
    return dataclasses.replace(result, model="principled")


def test_the_models_differ_by_more_than_the_bound(furnished: Result) -> None:
    """Else a view with the wrong model would pass."""
    light = furnished.lighting[0]
    other = expected(dataclasses.replace(furnished, model="paper"), light)
    assert difference(other, expected(furnished, light))[0] > 5 * AT_MOST


def test_recovered_lights_and_turned_ones_give_the_pixels_of_the_package(
    browser: Browser, furnished: Result, tmp_path: Path
) -> None:
    with opened(browser, furnished, tmp_path) as view:
        for name, light in zip(furnished.pictures, furnished.lighting, strict=True):
            view.go(f"light={name}&exposure=0")
            largest, mean = difference(view.saved(), expected(furnished, light))
            assert largest <= AT_MOST, name
            assert mean < 0.1
        view.go(f"light={furnished.pictures[1]}&rotate=-130&exposure=0.5&tone=neutral")
        turned = rotated(furnished.lighting[1], -130)
        true = expected(furnished, turned, exposure=0.5, tone_map="neutral")
        assert difference(view.saved(), true)[0] <= AT_MOST


@pytest.mark.parametrize(
    "options",
    [
        {"height": 1, "width": 1},
        {"height": 23, "width": 37, "fov": 0.0, "mask": BAND_MASK},
        {"height": 37, "width": 23, "fov": 90.0},
        {"height": 23, "width": 37, "binary": True, "fov": 90.0},
    ],
    ids=["one pixel", "orthographic, holes", "wide angle", "mirrors and metals"],
)
def test_any_size_camera_and_material_gives_the_pixels_of_the_package(
    browser: Browser, tmp_path: Path, options: dict[str, Any]
) -> None:
    result = principled(made(**options))
    with opened(browser, result, tmp_path) as view:
        for name, light in zip(result.pictures, result.lighting, strict=True):
            view.go(f"light={name}&exposure=0")
            largest, _ = difference(view.saved(), expected(result, light))
            assert largest <= AT_MOST, name


def test_roughness_and_metallic_are_added_and_kept_in_range(
    browser: Browser, tmp_path: Path
) -> None:
    result = principled(made(23, 37))
    with opened(browser, result, tmp_path) as view:
        for roughness, metallic in ((1, 0), (-1, 0), (0, 1), (0.3, -1)):
            true = expected(result, result.lighting[0], roughness=roughness, metallic=metallic)
            view.go(f"exposure=0&roughness={roughness}&metallic={metallic}")
            assert difference(view.saved(), true)[0] <= AT_MOST, (roughness, metallic)


def test_a_photographed_panorama_lights_as_the_package_has_it(
    browser: Browser, furnished: Result, tmp_path: Path, shared_data: Path
) -> None:
    file = shared_data / "hdri" / "studio_small_03_1k.hdr"
    light = panorama.project(panorama.read(file))
    with opened(browser, furnished, tmp_path) as view:
        view.open(file)
        view.control("exposure").fill("0")
        assert difference(view.saved(), expected(furnished, light))[0] <= AT_MOST


def test_a_page_holds_the_shader_and_the_table_of_its_own_model(furnished: Result) -> None:
    pages = {
        model: fragment(dataclasses.replace(furnished, model=model))
        for model in ("paper", "principled")
    }
    for model, table, shader in (
        ("paper", '"bands":', "bandWeights"),
        ("principled", '"lobes":', "slope3"),
    ):
        other = pages["principled" if model == "paper" else "paper"]
        assert table in pages[model] and shader in pages[model]  # noqa: PT018
        assert table not in other and shader not in other  # noqa: PT018
    assert np.abs(len(pages["paper"]) - len(pages["principled"])) < 60_000
