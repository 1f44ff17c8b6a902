"""The relight view: its pixels are those of the package, and it does what is asked of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np
import pytest
from numpy.typing import NDArray

from browser import launched, visit
from pbrfit import Result, sh_basis
from pbrfit.io.display import ToneMap, encoded
from pbrfit.model import panorama
from pbrfit.model.lighting import rotated
from pbrfit.model.reflection import Model
from pbrfit.report.viewer import fragment, maps
from relight_view import (
    PAGE,
    READY,
    View,
    coded,
    difference,
    expected,
    made,
    opened,
    pixels_of_png,
    room,
)

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

AT_MOST = 2
"""Largest difference from the package's own 8-bit picture, in 1/255."""

MODELS: tuple[Model, ...] = ("paper", "principled")

BAND_MASK = np.arange(37 * 23).reshape(23, 37) % 5 > 0


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with launched() as found:
        yield found


@pytest.fixture(scope="module")
def furnished() -> Result:
    return room()


def of_model(result: Result, model: Model) -> Result:
    return dataclasses.replace(result, model=model)


def test_the_models_differ_by_more_than_the_bound(furnished: Result) -> None:
    """Else a view with the wrong model would pass."""
    light = furnished.lighting[0]
    paper, principled = (expected(of_model(furnished, model), light) for model in MODELS)
    assert difference(paper, principled)[0] > 5 * AT_MOST


def test_a_page_holds_the_shader_and_the_table_of_its_own_model(furnished: Result) -> None:
    paper, principled = (fragment(of_model(furnished, model)) for model in MODELS)
    for page, other, words in (
        (paper, principled, ('"bands":', "bandWeights")),
        (principled, paper, ('"lobes":', "slope3")),
    ):
        for word in words:
            assert word in page
            assert word not in other
    assert abs(len(paper) - len(principled)) < 60_000


def shown_off(view: View, address: str, true: NDArray[np.uint8]) -> int:
    """By how much, at most, what the view shows at an address is off, in 1/255."""
    view.go(address)
    return difference(view.saved(), true)[0]


def tilted(light: NDArray[np.float64], degrees: float) -> NDArray[np.float64]:
    """The light turned about X, from +Z towards +Y."""
    b = np.radians(degrees)
    turn = np.array([[1, 0, 0], [0, np.cos(b), np.sin(b)], [0, -np.sin(b), np.cos(b)]])
    d = panorama.directions(12, 24).reshape(-1, 3)
    # Light that came from d comes from turn · d now.
    solved = np.linalg.lstsq(sh_basis(d @ turn.T), sh_basis(d) @ light)[0]
    return np.asarray(solved, np.float64)


@pytest.mark.parametrize("model", MODELS)
def test_every_recovered_light_gives_the_pixels_of_the_package(
    browser: Browser, furnished: Result, tmp_path: Path, model: Model
) -> None:
    result = of_model(furnished, model)
    with opened(browser, result, tmp_path) as view:
        for name, light in zip(result.pictures, result.lighting, strict=True):
            view.go(f"light={name}&exposure=0")
            largest, mean = difference(view.saved(), expected(result, light))
            assert largest <= AT_MOST, name
            assert mean < 0.1
        turned = rotated(result.lighting[1], -130)
        true = expected(result, turned, exposure=0.5, tone_map="neutral")
        address = f"light={result.pictures[1]}&rotate=-130&exposure=0.5&tone=neutral"
        assert shown_off(view, address, true) <= AT_MOST


@pytest.mark.parametrize("degrees", [25.0, -170.5, 90.0])
def test_turned_lights_give_the_pixels_of_the_package(
    browser: Browser, furnished: Result, tmp_path: Path, degrees: float
) -> None:
    light = rotated(furnished.lighting[1], degrees)
    here = f"light={furnished.pictures[1]}&rotate={degrees}"
    with opened(browser, furnished, tmp_path) as view:
        true = expected(furnished, light, exposure=0.25)
        assert shown_off(view, f"{here}&exposure=0.25", true) <= AT_MOST
        true = expected(furnished, tilted(light, -35))
        assert shown_off(view, f"{here}&tilt=-35&exposure=0", true) <= AT_MOST


@pytest.mark.parametrize("tone_map", ["none", "neutral"])
@pytest.mark.parametrize("exposure", [-2.0, 1.5])
def test_exposure_and_tone_map_are_those_of_the_package(
    browser: Browser, furnished: Result, tmp_path: Path, tone_map: ToneMap, exposure: float
) -> None:
    true = expected(furnished, furnished.lighting[0], exposure=exposure, tone_map=tone_map)
    with opened(browser, furnished, tmp_path) as view:
        assert shown_off(view, f"exposure={exposure}&tone={tone_map}", true) <= AT_MOST


@pytest.mark.parametrize(
    "options",
    [
        {"height": 1, "width": 1},
        {"height": 23, "width": 37, "mask": BAND_MASK},
        {"height": 23, "width": 37, "fov": 0.0},
        {"height": 37, "width": 23, "fov": 90.0},
        {"height": 23, "width": 37, "grey": True},
        {"height": 23, "width": 37, "binary": True, "fov": 90.0, "mask": BAND_MASK},
    ],
    ids=["one pixel", "holes", "orthographic", "wide angle", "grey", "mirrors and metals"],
)
@pytest.mark.parametrize("model", MODELS)
def test_any_size_camera_and_material_gives_the_pixels_of_the_package(
    browser: Browser, tmp_path: Path, options: dict[str, Any], model: Model
) -> None:
    result = of_model(made(**options), model)
    with opened(browser, result, tmp_path) as view:
        for name, light in zip(result.pictures, result.lighting, strict=True):
            assert shown_off(view, f"light={name}&exposure=0", expected(result, light)) <= AT_MOST


@pytest.mark.parametrize("model", MODELS)
def test_roughness_and_metallic_are_added_and_kept_in_range(
    browser: Browser, tmp_path: Path, model: Model
) -> None:
    result = of_model(made(23, 37), model)
    with opened(browser, result, tmp_path) as view:
        for roughness, metallic in ((1, 0), (-1, 0), (0, 1), (0.3, -1)):
            true = expected(result, result.lighting[0], roughness=roughness, metallic=metallic)
            address = f"exposure=0&roughness={roughness}&metallic={metallic}"
            assert shown_off(view, address, true) <= AT_MOST, address


def test_large_maps_are_averaged_down(browser: Browser, tmp_path: Path) -> None:
    holes = np.arange(150 * 211).reshape(150, 211) % 7 > 0
    check_averaged(browser, made(150, 211, mask=holes, fov=40.0), tmp_path, 100, (71, 100, 4))


@pytest.mark.slow
def test_the_largest_maps_there_are_are_averaged_down(browser: Browser, tmp_path: Path) -> None:
    check_averaged(browser, made(700, 1400), tmp_path, 1024, (512, 1024, 4))


def check_averaged(
    browser: Browser, result: Result, folder: Path, max_side: int, shape: tuple[int, ...]
) -> None:
    with opened(browser, result, folder, max_side=max_side) as view:
        view.go("exposure=0")
        found = view.saved()
    assert found.shape == shape
    true = expected(result, result.lighting[0], max_side=max_side)
    assert difference(found, true)[0] <= AT_MOST


def test_maps_can_be_looked_at(browser: Browser, tmp_path: Path) -> None:
    result = made(23, 37, mask=BAND_MASK)
    finish = np.clip(result.roughness + 0.25, 0, 1)
    shown = {
        "albedo": encoded(result.albedo),
        "roughness": np.repeat(finish[..., None], 3, axis=-1),
        "metallic": np.repeat(result.metallic[..., None], 3, axis=-1),
        "normals": 0.5 + 0.5 * result.normals,
    }
    with opened(browser, result, tmp_path) as view:
        view.control("roughness").fill("0.25")
        for name, pixels in shown.items():
            view.page.get_by_role("radio", name=name).check()
            assert difference(view.saved(), coded(pixels, BAND_MASK))[0] <= 1, name


def test_the_picture_can_be_saved(browser: Browser, furnished: Result, tmp_path: Path) -> None:
    with opened(browser, furnished, tmp_path) as view:
        view.control("rotate").fill("-20")
        view.page.wait_for_function("location.hash === '#rotate=-20'")
        with view.page.expect_download() as download:
            view.page.get_by_role("button", name="Save PNG").click()
        assert download.value.suggested_filename == f"relit-{furnished.pictures[0]}--20.png"
        found = pixels_of_png(Path(download.value.path()).read_bytes())
        light = rotated(furnished.lighting[0], -20)
        true = expected(furnished, light, exposure=view.state()["exposure"])
        assert difference(found, true)[0] <= AT_MOST


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("name", ["studio_small_03_1k", "kloppenheim_05_1k"])
def test_a_panorama_from_a_file_lights_as_the_package_has_it(
    browser: Browser,
    furnished: Result,
    tmp_path: Path,
    shared_data: Path,
    name: str,
    model: Model,
) -> None:
    furnished = of_model(furnished, model)
    file = shared_data / "hdri" / f"{name}.hdr"
    pixels = panorama.read(file)
    light = panorama.project(pixels)
    with opened(browser, furnished, tmp_path) as view:
        assert not view.control("window").is_visible()
        message = view.open(file)
        lost = panorama.lost_energy(pixels, light)
        assert message == (
            f"{name}.hdr: 1024 × 512. {100 * lost:.0f} % of its energy is in detail finer than "
            "this light has (l > 3)."
        )
        np.testing.assert_allclose(view.light(), light, atol=1e-6 * np.abs(light).max())
        assert view.state()["light"] == f"{name}.hdr"
        view.control("exposure").fill("0")
        true = expected(furnished, light)
        assert difference(view.saved(), true)[0] <= AT_MOST
        view.control("rotate").fill("-60")
        true = expected(furnished, panorama.project(pixels, rotate=-60))
        assert difference(view.saved(), true)[0] <= AT_MOST
        # Its name stays in the menu beside the recovered lights.
        view.control("light").select_option(furnished.pictures[2])
        np.testing.assert_array_equal(view.light(), furnished.lighting[2])
        view.control("light").select_option(f"{name}.hdr")
        np.testing.assert_allclose(view.light(), light, atol=1e-6 * np.abs(light).max())
        view.control("rotate").fill("0")
        for window in panorama.WINDOWS:  # against ringing, as the package has them
            view.control("window").select_option(window)
            windowed = panorama.windowed(light, window)
            np.testing.assert_allclose(view.light(), windowed, atol=1e-6 * np.abs(light).max())
            true = expected(furnished, windowed, exposure=view.state()["exposure"])
            assert difference(view.saved(), true)[0] <= AT_MOST
        # Recovered lights stay as they were found.
        view.control("light").select_option(furnished.pictures[1])
        np.testing.assert_array_equal(view.light(), furnished.lighting[1])
        view.page.wait_for_function("document.querySelector('[name=window]').offsetParent === null")


def hdr(rows: bytes, width: int = 8, height: int = 4, header: bytes = b"") -> bytes:
    return (
        b"#?RADIANCE\n# by hand\n" + header + b"FORMAT=32-bit_rle_rgbe\n\n"
        b"-Y %d +X %d\n" % (height, width) + rows
    )


def pixels_of(width: int, height: int) -> NDArray[np.uint8]:
    """RGBE, with runs and without, and black."""
    rng = np.random.default_rng(3)
    values = rng.integers(3, 255, (height, width, 4), dtype=np.uint8)
    values[..., 3] = rng.integers(124, 132, (height, width))
    values[1, 2:7] = values[1, 2]
    values[2, 3] = 0
    return values


def runs(row: NDArray[np.uint8]) -> bytes:
    """One row, channel by channel: runs of 2 or more as such."""
    coded_row = b"\2\2" + len(row).to_bytes(2, "big")
    for channel in row.T:
        i = 0
        while i < len(channel):
            same = 1
            while i + same < len(channel) and channel[i + same] == channel[i] and same < 127:
                same += 1
            coded_row += bytes([128 + same if same > 1 else 1, channel[i]])
            i += same
    return coded_row


def old_runs(row: NDArray[np.uint8]) -> bytes:
    """One row, pixel by pixel, repetitions as (1, 1, 1, count)."""
    coded_row, i = b"", 0
    while i < len(row):
        same = 1
        while i + same < len(row) and (row[i + same] == row[i]).all():
            same += 1
        coded_row += row[i].tobytes() + (bytes([1, 1, 1, same - 1]) if same > 1 else b"")
        i += same
    return coded_row


@pytest.mark.parametrize("kind", ["as it is", "runs", "old runs"])
@pytest.mark.parametrize("width", [14, 16])
def test_every_kind_of_radiance_file_is_read_as_by_the_package(
    browser: Browser, furnished: Result, tmp_path: Path, kind: str, width: int
) -> None:
    coder = {"as it is": lambda row: row.tobytes(), "runs": runs, "old runs": old_runs}[kind]
    rows = pixels_of(width, width // 2)
    content = hdr(b"".join(coder(row) for row in rows), width, width // 2, b"EXPOSURE=2\n")
    file = tmp_path / "ünit.hdr"
    file.write_bytes(content)
    pixels = panorama.read(file)
    with opened(browser, furnished, tmp_path) as view:
        assert view.open(file).startswith(f"ünit.hdr: {width} × {width // 2}. ")
        light = panorama.project(pixels)
        np.testing.assert_allclose(view.light(), light, atol=1e-9 * np.abs(light).max())


GOOD = b"".join(runs(row) for row in pixels_of(16, 8))
BROKEN = {
    "a photograph": (b"\xff\xd8\xff\xe0photo", "expected a Radiance .hdr file, found something"),
    "nothing": (b"", "expected a Radiance .hdr file, found something else"),
    "no end of header": (b"#?RADIANCE\nFORMAT=32", "found a header without end"),
    "another encoding": (
        b"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 2 +X 4\n",
        "expected FORMAT=32-bit_rle_rgbe, found FORMAT=32-bit_rle_xyze",
    ),
    "turned": (b"#?RADIANCE\n\n+X 16 -Y 8\n" + GOOD, "expected a resolution as -Y 512 +X 1024"),
    "empty": (hdr(b"", 0, 0), "expected a resolution as"),
    "no panorama": (hdr(GOOD, 16, 9), "twice as wide as high (equirectangular), found 16 × 9"),
    "too small": (
        hdr(b"".join(row.tobytes() for row in pixels_of(12, 6)), 12, 6),
        "expected a panorama of 14 × 7 pixels or more, found 12 × 6",
    ),
    "cut off": (hdr(GOOD[:-9], 16, 8), "expected 8 rows, found the end of the file in row 7"),
    "too long a run": (
        hdr(b"\2\2\0\x10" + b"\xff\x07" * 8, 16, 8),
        "expected 16 pixels a row, found more in row 0",
    ),
    "a run of nothing": (hdr(b"\1\1\1\5", 16, 8), "found more in row 0"),
}


def test_broken_panoramas_are_refused_in_words_and_change_nothing(
    browser: Browser, furnished: Result, tmp_path: Path
) -> None:
    with opened(browser, furnished, tmp_path) as view:
        before = view.saved()
        for name, (content, message) in BROKEN.items():
            file = tmp_path / f"{name}.hdr"
            file.write_bytes(content)
            said = view.open(file)
            assert said.startswith(f"{name}.hdr: ")
            assert message in said
        np.testing.assert_array_equal(view.saved(), before)
        assert view.state()["light"] == furnished.pictures[0]
        assert view.page.locator("select[name=light] option").count() == len(furnished.pictures)


def test_a_panorama_can_be_dropped_on_the_picture(
    browser: Browser, furnished: Result, tmp_path: Path
) -> None:
    content = hdr(GOOD, 16, 8)
    with opened(browser, furnished, tmp_path) as view:
        transfer = view.page.evaluate_handle(
            """bytes => {
                const transfer = new DataTransfer();
                transfer.items.add(new File([new Uint8Array(bytes)], "dropped.hdr"));
                return transfer;
            }""",
            list(content),
        )
        canvas = view.page.locator(".relight-canvas")
        canvas.dispatch_event("dragover", {"dataTransfer": transfer})
        assert view.page.locator(".relight-drop").is_visible()
        canvas.dispatch_event("drop", {"dataTransfer": transfer})
        view.page.wait_for_function(
            "document.querySelector('.relight-message').textContent.startsWith('dropped.hdr: 16')"
        )
        assert not view.page.locator(".relight-drop").is_visible()
        assert view.state()["light"] == "dropped.hdr"


def test_a_drag_of_a_quarter_of_the_width_turns_by_45_degrees(
    browser: Browser, furnished: Result, tmp_path: Path
) -> None:
    with opened(browser, furnished, tmp_path) as view:
        box = view.page.locator(".relight-canvas").bounding_box()
        assert box is not None
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        mouse = view.page.mouse
        mouse.move(x, y)
        mouse.down()
        mouse.move(x + box["width"] / 4, y - box["width"] / 8, steps=5)
        mouse.up()
        mouse.move(x, y)
        turned = view.state()
        assert turned["rotate"] == pytest.approx(45, abs=0.5)
        assert turned["tilt"] == pytest.approx(22.5, abs=0.5)
        light = tilted(rotated(furnished.lighting[0], turned["rotate"]), turned["tilt"])
        true = expected(furnished, light, exposure=turned["exposure"])
        assert difference(view.saved(), true)[0] <= AT_MOST


def test_keys_turn_the_light_and_home_turns_it_back(
    browser: Browser, furnished: Result, tmp_path: Path
) -> None:
    with opened(browser, furnished, tmp_path) as view:
        view.page.locator(".relight-canvas").focus()
        for key in ("ArrowRight", "ArrowRight", "Shift+ArrowLeft", "ArrowUp", "Shift+ArrowDown"):
            view.page.keyboard.press(key)
        assert (view.state()["rotate"], view.state()["tilt"]) == (9, 4)
        view.page.wait_for_function("document.querySelector('[name=rotate]').value === '9'")
        assert view.control("rotate").get_attribute("aria-valuetext") == "+9°"
        view.page.keyboard.press("Home")
        assert (view.state()["rotate"], view.state()["tilt"]) == (0, 0)
        for _ in range(37):
            view.page.keyboard.press("ArrowRight")
            view.page.keyboard.press("ArrowUp")
        assert (view.state()["rotate"], view.state()["tilt"]) == (-175, 90)
        for end in (180, -180):
            view.control("rotate").fill(str(end))
            assert view.state()["rotate"] == end
        view.go("rotate=725")
        assert view.state()["rotate"] == 5


def test_one_finger_turns_the_light_on_a_phone(
    browser: Browser, furnished: Result, tmp_path: Path
) -> None:
    file = tmp_path / "page.html"
    file.write_text(PAGE.format(fragment(furnished)), encoding="utf-8")
    context = browser.new_context(
        viewport={"width": 375, "height": 700}, has_touch=True, is_mobile=True
    )
    page: Page = context.new_page()
    page.goto(file.as_uri())
    page.wait_for_selector(READY)
    assert page.evaluate("document.documentElement.scrollWidth") <= 375
    box = page.locator(".relight-canvas").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    session = context.new_cdp_session(page)
    moves = [(x, y), (x + 20, y - 5), (x + box["width"] / 4, y - box["width"] / 4)]
    for kind, points in (
        ("touchStart", moves[:1]),
        *(("touchMove", [point]) for point in moves[1:]),
        ("touchEnd", []),
    ):
        session.send(
            "Input.dispatchTouchEvent",
            {"type": kind, "touchPoints": [{"x": a, "y": b} for a, b in points]},
        )
    page.wait_for_function("document.querySelector('.relight-view').view.state.rotate !== 0")
    state = page.evaluate("document.querySelector('.relight-view').view.state")
    assert state["rotate"] == pytest.approx(45, abs=1)
    assert state["tilt"] == pytest.approx(45, abs=1)
    assert page.evaluate("window.scrollY") == 0
    context.close()


def test_the_address_says_what_is_shown_and_brings_it_back(
    browser: Browser, furnished: Result, tmp_path: Path
) -> None:
    name = 'a "b" <c> & ü</script>'
    result = dataclasses.replace(furnished, pictures=(name, *furnished.pictures[1:]))
    with opened(browser, result, tmp_path) as view:
        option = view.page.locator("select[name=light] option").first
        assert option.inner_text() == name
        assert "#" not in view.page.url
        view.control("light").select_option(result.pictures[1])
        view.control("rotate").fill("30")
        view.control("tone").select_option("neutral")
        view.page.wait_for_function("location.hash.includes('tone')")
        address = view.page.url.partition("#")[2]
        assert address == f"light={result.pictures[1]}&rotate=30&tone=neutral"
        before = view.saved()
        view.page.get_by_role("button", name="Reset").click()
        view.page.wait_for_function("location.hash === ''")
        assert view.state()["light"] == name
        view.go(address)
        np.testing.assert_array_equal(view.saved(), before)
        view.go(f"light={quote(name)}")
        assert view.state()["light"] == name
        assert view.state()["rotate"] == 0
        view.go("rotate=20&light=elsewhere.hdr&exposure=x&view=upside")
        assert view.message() == (
            "Address of the page: light elsewhere.hdr is not in this page; a panorama has to be "
            "opened again; exposure: expected a number, found x; view: expected one of relit, "
            "albedo, roughness, metallic, normals, found upside."
        )
        assert view.state()["rotate"] == 20
        view.go("lights")  # an anchor of the page around
        assert view.state()["rotate"] == 20


def test_nothing_is_drawn_without_a_change(
    browser: Browser, furnished: Result, tmp_path: Path
) -> None:
    with opened(browser, furnished, tmp_path) as view:
        view.page.wait_for_timeout(100)
        view.page.evaluate(
            """() => {
                const gl = document.querySelector('.relight-canvas').getContext('webgl2');
                const draw = gl.drawArrays.bind(gl);
                window.drawn = 0;
                gl.drawArrays = (...given) => { window.drawn += 1; draw(...given); };
                const request = window.requestAnimationFrame.bind(window);
                window.asked = 0;
                window.requestAnimationFrame = (f) => { window.asked += 1; return request(f); };
            }"""
        )
        view.page.wait_for_timeout(500)
        assert view.page.evaluate("[window.drawn, window.asked]") == [0, 0]
        # Several changes before the next frame are drawn once.
        view.page.evaluate(
            """() => {
                const { view } = document.querySelector('.relight-view');
                for (let i = 0; i < 10; i++) view.change({ rotate: i });
            }"""
        )
        view.page.wait_for_timeout(500)
        assert view.page.evaluate("[window.drawn, window.asked]") == [1, 1]


def test_a_lost_context_comes_back_with_the_same_picture(
    browser: Browser, furnished: Result, tmp_path: Path
) -> None:
    with opened(browser, furnished, tmp_path) as view:
        before = view.saved()
        view.page.evaluate(
            """() => {
                const gl = document.querySelector('.relight-canvas').getContext('webgl2');
                window.extension = gl.getExtension('WEBGL_lose_context');
                window.extension.loseContext();
            }"""
        )
        view.page.wait_for_function("document.querySelector('.relight-message').textContent !== ''")
        assert "waiting for it" in view.message()
        view.control("rotate").fill("30")  # a change meanwhile does no harm
        view.page.evaluate("window.extension.restoreContext()")
        view.page.wait_for_function("document.querySelector('.relight-message').textContent === ''")
        view.control("rotate").fill("0")
        np.testing.assert_array_equal(view.saved(), before)


@pytest.mark.parametrize(
    ("missing", "said"),
    [
        (
            "HTMLCanvasElement.prototype.getContext = () => null",
            "this browser, or its graphics settings, has no WebGL 2",
        ),
        (
            "delete window.DecompressionStream",
            "this browser is from before 2023 and cannot unpack the maps",
        ),
    ],
)
def test_where_the_view_cannot_run_there_are_a_message_and_one_picture(
    browser: Browser, furnished: Result, tmp_path: Path, missing: str, said: str
) -> None:
    file = tmp_path / "page.html"
    head = f"<script>{missing}</script>"
    file.write_text(PAGE.format(head + fragment(furnished)), encoding="utf-8")
    with visit(browser, file) as visited:
        page = visited.page
        page.wait_for_selector('.relight-view[data-state="static"]')
        assert page.locator(".relight-message").first.inner_text() == (
            f"No interactive view: {said}. This is one picture of it."
        )
        picture = page.locator(".relight-static")
        assert picture.is_visible()
        assert picture.evaluate("image => [image.naturalWidth, image.naturalHeight]") == [24, 24]
        assert not page.locator(".relight-canvas").is_visible()
        assert page.locator("input[name=rotate]").is_disabled()
        assert not page.locator(".relight-help").is_visible()


def test_the_first_exposure_shows_the_first_light_well(
    browser: Browser, furnished: Result, tmp_path: Path
) -> None:
    dark = dataclasses.replace(furnished, lighting=furnished.lighting / 1000)
    with opened(browser, dark, tmp_path) as view:
        exposure = view.state()["exposure"]
        assert 8 < exposure < 12
        assert float(view.control("exposure").input_value()) == exposure
        found = view.saved()
        assert 100 < np.mean(found[..., :3]) < 220
        assert difference(found, expected(dark, dark.lighting[0], exposure=exposure))[0] <= AT_MOST
        assert maps.of_result(dark, 1024).mask.all()
