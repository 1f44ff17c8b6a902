"""The relight view in a browser, beside what the package itself says about the same pixels."""

from __future__ import annotations

import base64
import dataclasses
import functools
import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from browser import Visit, visit, wait_until
from pbrfit import DirectionalLight, Environment, Result, decompose, relight
from pbrfit.display.tone import ToneMap, encoded
from pbrfit.model.materials import Materials
from pbrfit.report import viewer
from pbrfit.report.html import document
from pbrfit.report.viewer import film, fragment, maps
from pbrfit.report.viewer.film import Tile
from pbrfit.report.viewer.lights import Lighting
from pbrfit.result.relighting import LampLight
from pbrfit.synthetic import make_scene
from pbrfit.synthetic.lights import random_lights
from scene_files import known, lights_of, truth_of

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator, Page

Light = NDArray[np.float64] | DirectionalLight | Environment | LampLight
"""As `relight` takes it."""

READY = '.relight-view[data-state="ready"]'


def room(size: int = 24, lights: int = 3) -> Result:
    """A room with its true materials and lights, names and all."""
    scene = make_scene("room", size=size, lights=lights)
    found, maps = decompose(scene, iterations=1), truth_of(scene).materials
    return dataclasses.replace(found, materials=maps, lighting=lights_of(scene))


def made(
    height: int,
    width: int,
    *,
    fov: float = 60.0,
    mask: NDArray[np.bool_] | None = None,
    grey: bool = False,
    binary: bool = False,
    roughness: tuple[float, float] = (0.0, 1.0),
    seed: int = 0,
) -> Result:
    """A result of random materials, normals all over the sphere and two random lights.

    `binary`: roughness and metallic are 0 or 1; else `roughness` is in a range.
    """
    rng = np.random.default_rng(seed)
    mask = np.ones((height, width), bool) if mask is None else mask
    normals = rng.normal(size=(height, width, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    albedo = rng.random((height, width, 3))
    finish = rng.random((2, height, width))
    finish[0] = roughness[0] + (roughness[1] - roughness[0]) * finish[0]
    lighting = random_lights(2, rng)
    if binary:
        finish = np.rint(finish)
    if grey:
        albedo, lighting = np.repeat(albedo[..., :1], 3, -1), np.repeat(lighting[..., :1], 3, -1)
    outside = ~mask
    for plane in (albedo, normals, *finish):
        plane[outside] = np.nan
    return dataclasses.replace(
        _template(),
        materials=Materials(albedo, finish[0], finish[1]),
        lighting=lighting,
        normals=normals,
        mask=mask,
        fov=fov,
    )


@functools.cache
def _template() -> Result:
    """A result, of which only what no picture shows is kept."""
    return decompose(make_scene("room", size=8, lights=2), iterations=1)


def expected(
    result: Result,
    light: Light | Sequence[Light],
    *,
    exposure: float = 0.0,
    tone_map: ToneMap = "none",
    max_side: int = 1024,
    roughness: float = 0.0,
    metallic: float = 0.0,
) -> NDArray[np.uint8]:
    """(H, W, 4) uint8 sRGB of the result, at the view's size; transparent outside the mask.

    Several lights add up. `exposure` is in all.
    """
    several: Sequence[Light] = light if isinstance(light, list) else [cast(Light, light)]
    small = maps.of_result(result, max_side)
    finish = Materials(
        small.materials.albedo,
        np.clip(small.materials.roughness + roughness, 0, 1),
        np.clip(small.materials.metallic + metallic, 0, 1),
    )
    shown = dataclasses.replace(result, materials=finish, normals=small.normals, mask=small.mask)
    radiance = np.sum([relight(shown, one) for one in several], axis=0)
    return coded(encoded(radiance, exposure, tone_map), small.mask)


def tiles_of(result: Result) -> list[Tile]:
    """Its reconstructions in the place of pictures."""
    made = film.of_lights(Lighting(result))
    return [dataclasses.replace(tile, original=True) for tile in made]


def coded(display: NDArray[Any], mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Values in [0, 1] as 8 bits, with alpha."""
    color = np.where(mask[..., None], display, 0.0)
    codes = np.rint(255 * np.concatenate([color, mask[..., None]], axis=-1))
    return np.asarray(codes.astype(np.uint8))


def difference(found: NDArray[np.uint8], true: NDArray[np.uint8]) -> tuple[int, float]:
    """Largest and mean difference of colours inside the mask, in 1/255; alpha has to be equal."""
    assert found.shape == true.shape
    np.testing.assert_array_equal(found[..., 3], true[..., 3])
    inside = true[..., 3] > 0
    apart = np.abs(found[inside].astype(int) - true[inside].astype(int))
    return int(apart.max()), float(apart.mean())


def pixels_of_png(content: bytes) -> NDArray[np.uint8]:
    """(H, W, 4) uint8."""
    with Image.open(io.BytesIO(content)) as picture:
        assert (picture.format, picture.mode) == ("PNG", "RGBA")
        return np.asarray(picture)


@dataclasses.dataclass
class View:
    """The view in an open page."""

    page: Page
    troubles: list[str]

    def go(self, address: str) -> None:
        """Change the part of the address after #, and wait until the view has read it."""
        self.page.evaluate(
            """address => new Promise((done) => {
                if (location.hash === '#' + address) return done();
                addEventListener('hashchange', () => setTimeout(done), { once: true });
                location.hash = address;
            })""",
            address,
        )

    def saved(self) -> NDArray[np.uint8]:
        """The pixels that Save PNG writes, (H, W, 4)."""
        code = self.page.evaluate(
            """async () => {
                const { view } = document.querySelector('.relight-view');
                const bytes = new Uint8Array(await (await view.png()).arrayBuffer());
                return btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(''));
            }"""
        )
        return pixels_of_png(base64.b64decode(code))

    def automatic(self) -> float:
        """Stops that the view adds to those of its slider."""
        return float(
            self.page.evaluate(
                "(({ view }) => view.exposure() - view.state.exposure)"
                "(document.querySelector('.relight-view'))"
            )
        )

    def adjust(self) -> None:
        """Open the panel."""
        self.page.get_by_role("button", name="Adjust light and picture").click()

    def box(self) -> dict[str, float]:
        """Where the picture is on the screen, whatever is seen of it."""
        return dict(known(self.page.locator(".relight-canvas").bounding_box()))  # type: ignore[arg-type]

    def choose(self, light: str) -> None:
        """Choose a light in the filmstrip; "" is the lamp."""
        self.page.locator("input[type=radio][name=light]").evaluate_all(
            "(inputs, light) => inputs.find(({ value }) => value === light).click()", light
        )

    def control(self, name: str) -> Locator:
        """A slider or menu."""
        return self.page.locator(f"input[type=range][name={name}], select[name={name}]")

    def state(self) -> dict[str, Any]:
        return dict(self.page.evaluate("document.querySelector('.relight-view').view.state"))

    def light(self) -> NDArray[np.float64]:
        """(16, 3): the chosen light before it is turned."""
        values = self.page.evaluate(
            "(({ view }) => Array.from(view.find(view.state.light).sh))"
            "(document.querySelector('.relight-view'))"
        )
        return np.array(values).reshape(16, 3)

    def open(self, *files: Path) -> str:
        """Choose a panorama; return what the view says about it."""
        before = self.message()
        self.page.locator('input[type="file"]').set_input_files(list(files))
        wait_until(
            self.page,
            "before => document.querySelector('.relight-message').textContent !== before",
            arg=before,
        )
        wait_until(
            self.page,
            "!/^(Reading|$)/.test(document.querySelector('.relight-message').textContent)",
        )
        return self.message()

    def message(self) -> str:
        return self.page.locator(".relight-message").first.inner_text()


def page_of(
    result: Result, max_side: int = 1024, tiles: Sequence[Tile] | None = None, before: str = ""
) -> str:
    """A page that holds the view alone; `before` is a script that runs first."""
    view = f"<script>{before}</script>" + fragment(result, max_side, tiles)
    return document("view", view, within=[before, viewer.script(result.model)])


@contextmanager
def opened(
    browser: Browser,
    result: Result,
    folder: Path,
    max_side: int = 1024,
    width: int = 1280,
    tiles: Sequence[Tile] | None = None,
) -> Iterator[View]:
    """The view of a result in a page of its own; nothing may go wrong there meanwhile."""
    file = folder / "page.html"
    file.write_text(page_of(result, max_side, tiles), encoding="utf-8")
    visited: Visit
    with visit(browser, file, width=width) as visited:
        visited.page.wait_for_selector(READY)
        yield View(visited.page, visited.troubles)
        assert visited.troubles == []
