"""The relight view: its pixels are those of the package, and it does what is asked of it."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np
import pytest
from numpy.typing import NDArray

from browser import launched, visit, wait_until
from pbrfit import DirectionalLight, Environment, Result, relight
from pbrfit.display.tone import ToneMap, encoded
from pbrfit.kernel import sh_basis
from pbrfit.model import panorama
from pbrfit.model.lamps import Lamps
from pbrfit.model.lighting import rotated
from pbrfit.model.reflection import Model
from pbrfit.report.viewer import fragment, maps
from pbrfit.report.viewer.lights import AMBIENT
from relight_view import (
    READY,
    Light,
    View,
    coded,
    difference,
    expected,
    made,
    opened,
    page_of,
    pixels_of_png,
    room,
    tiles_of,
)
from scene_files import known

if TYPE_CHECKING:
    from playwright.sync_api import Browser, CDPSession, Page

AT_MOST = 2
"""Largest difference from the package's own 8-bit picture, in 1/255."""

MODELS: tuple[Model, ...] = ("paper", "principled")

VIEWS = ("relit", "albedo", "roughness", "metallic", "normals", "uncertainty", "strips")
"""What the keys 1 to 7 show."""

BAND_MASK = np.arange(37 * 23).reshape(23, 37) % 5 > 0


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with launched() as found:
        yield found


@pytest.fixture(scope="module")
def furnished() -> Result:
    return room()


@pytest.fixture
def view(browser: Browser, furnished: Result, tmp_path: Path) -> Iterator[View]:
    """The view of the furnished room, beside its pictures."""
    with opened(browser, furnished, tmp_path, tiles=tiles_of(furnished)) as found:
        yield found


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
        (paper, principled, ('"bands":', "bandWeights", "masking(")),
        (principled, paper, ('"lobes":', "slope3", "glass(")),
    ):
        for word in words:
            assert word in page
            assert word not in other
    assert abs(len(paper) - len(principled)) < 60_000


def shown_off(
    view: View, address: str, result: Result, light: Light | Sequence[Light], **options: Any
) -> int:
    """By how much, at most, what the view shows at an address is off, in 1/255.

    `options` are those of `expected`, an exposure as the address has it.
    """
    view.go(address)
    exposure = view.automatic() + options.pop("exposure", 0.0)
    options.setdefault("tone_map", "neutral")
    return difference(view.saved(), expected(result, light, exposure=exposure, **options))[0]


def tilted(light: NDArray[np.float64], degrees: float) -> NDArray[np.float64]:
    """The light turned about X, from +Z towards +Y."""
    b = np.radians(degrees)
    turn = np.array([[1, 0, 0], [0, np.cos(b), np.sin(b)], [0, -np.sin(b), np.cos(b)]])
    d = panorama.directions(12, 24).reshape(-1, 3)
    # Light that came from d comes from turn · d now.
    solved = np.linalg.lstsq(sh_basis(d @ turn.T), sh_basis(d) @ light, None)[0]
    return np.asarray(solved, np.float64)


LAMPS = [(-35, 35), (60, -20), (10, 85), (120, 20)]
"""Azimuth and elevation; the last shines from behind."""


@pytest.mark.parametrize(
    ("kind", "model"),
    [
        *(("room", "paper"), ("random", "principled")),
        *(("orthographic", "paper"), ("mirrors and metals", "principled")),
    ],
)
def test_a_lamp_gives_the_pixels_of_the_package(
    browser: Browser, furnished: Result, tmp_path: Path, model: Model, kind: str
) -> None:
    result = {
        "room": lambda: furnished,
        # Under a lamp, pixels of lower roughness show the last bits of the stored normals.
        "random": lambda: made(46, 74, roughness=(0.12, 1.0), mask=np.tile(BAND_MASK, (2, 2))),
        "orthographic": lambda: made(46, 74, roughness=(0.12, 1.0), fov=0.0),
        "mirrors and metals": lambda: made(46, 74, binary=True, fov=90.0),
    }[kind]()
    result = of_model(result, model)
    with opened(browser, result, tmp_path) as view:
        for azimuth, elevation in LAMPS:
            address = f"azimuth={azimuth}&elevation={elevation}&ambient=0"
            lamp = DirectionalLight(azimuth, elevation)
            assert shown_off(view, address, result, lamp) <= AT_MOST, (azimuth, elevation)
        plain = f"{address}&tone=none&exposure=1"
        assert shown_off(view, plain, result, lamp, exposure=1.0, tone_map="none") <= AT_MOST


@pytest.mark.parametrize("model", MODELS)
def test_ambient_light_is_the_mean_of_the_recovered_lights_and_a_lamp_may_be_soft(
    browser: Browser, furnished: Result, tmp_path: Path, model: Model
) -> None:
    result = of_model(furnished, model)
    luminance = result.lighting[:, 0] @ (0.2126, 0.7152, 0.0722) / (2 * math.sqrt(math.pi))
    mean = np.mean(result.lighting / luminance[:, None, None], axis=0)
    with opened(browser, result, tmp_path) as view:
        # At first there is a little of it, so that nothing is black.
        lights = [DirectionalLight(-35, 35), AMBIENT * mean]
        assert shown_off(view, "azimuth=-35", result, lights) <= AT_MOST
        lights = [DirectionalLight(70, 0), 0.5 * mean]
        address = "azimuth=70&elevation=0&ambient=0.5"
        assert shown_off(view, address, result, lights) <= AT_MOST
        soft = DirectionalLight(40, 20, softness=25)
        address = "azimuth=40&elevation=20&ambient=0&softness=25"
        assert shown_off(view, address, result, soft) <= AT_MOST


@pytest.mark.parametrize("model", MODELS)
def test_a_picture_that_was_lit_by_lamps_is_shown_under_them(
    browser: Browser, furnished: Result, tmp_path: Path, model: Model
) -> None:
    directions = np.array([[0.6, 0.0, 0.8], [0.0, 0.6, 0.8], [-0.8, 0.0, 0.6]])
    lamps = Lamps(
        pictures=np.array([0, 0, 1]),
        places=directions,
        colors=np.full((3, 3), (0.9, 0.7, 0.5)),
        near=np.zeros(3, bool),
    )
    result = dataclasses.replace(
        of_model(furnished, model), lamps=lamps, lighting=0.2 * furnished.lighting
    )
    with opened(browser, result, tmp_path) as view:
        for i, name in enumerate(result.pictures[:2]):
            light = result.lights[i]
            assert shown_off(view, f"light={name}", result, [light]) <= AT_MOST


def test_turned_lights_and_tone_maps_give_the_pixels_of_the_package(
    view: View, furnished: Result
) -> None:
    tones: tuple[ToneMap, ...] = ("none", "neutral")
    for degrees in (25.0, -170.5, 90.0):
        light = rotated(furnished.lighting[1], degrees)
        here = f"light={furnished.pictures[1]}&rotate={degrees}"
        address = f"{here}&exposure=0.25"
        assert shown_off(view, address, furnished, light, exposure=0.25) <= AT_MOST
        assert shown_off(view, f"{here}&tilt=-35", furnished, tilted(light, -35)) <= AT_MOST
    light = furnished.lighting[0]
    for tone_map, exposure in itertools.product(tones, (-2.0, 1.5)):
        address = f"light={furnished.pictures[0]}&exposure={exposure}&tone={tone_map}"
        of: dict[str, Any] = {"exposure": exposure, "tone_map": tone_map}
        assert shown_off(view, address, furnished, light, **of) <= AT_MOST


@pytest.mark.parametrize(
    ("model", "options"),
    [
        ("paper", {"height": 1, "width": 1}),
        ("paper", {"height": 23, "width": 37, "fov": 0.0, "mask": BAND_MASK}),
        ("principled", {"height": 37, "width": 23, "fov": 90.0}),
        ("principled", {"height": 23, "width": 37, "grey": True}),
        ("paper", {"height": 23, "width": 37, "binary": True, "fov": 90.0, "mask": BAND_MASK}),
        ("principled", {"height": 23, "width": 37, "binary": True, "fov": 90.0}),
    ],
)
def test_any_size_camera_and_material_gives_the_pixels_of_the_package(
    browser: Browser, tmp_path: Path, options: dict[str, Any], model: Model
) -> None:
    result = of_model(made(**options), model)
    with opened(browser, result, tmp_path) as view:
        for name, light in zip(result.pictures, result.lighting, strict=True):
            assert shown_off(view, f"light={name}", result, light) <= AT_MOST


@pytest.mark.parametrize("model", MODELS)
def test_roughness_and_metallic_are_added_and_kept_in_range(
    browser: Browser, tmp_path: Path, model: Model
) -> None:
    result = of_model(made(23, 37), model)
    with opened(browser, result, tmp_path) as view:
        for roughness, metallic in ((1, 0), (-1, 0), (0, 1), (0.3, -1)):
            added = {"roughness": roughness, "metallic": metallic}
            address = f"light={result.pictures[0]}&roughness={roughness}&metallic={metallic}"
            off = shown_off(view, address, result, result.lighting[0], **added)
            assert off <= AT_MOST, address


HOLES = np.arange(150 * 211).reshape(150, 211) % 7 > 0


@pytest.mark.parametrize(
    ("size", "options", "max_side", "shape"),
    [
        ((150, 211), {"mask": HOLES, "fov": 40.0}, 100, (71, 100, 4)),
        pytest.param((700, 1400), {}, 1024, (512, 1024, 4), marks=pytest.mark.slow),
        ((60, 1500), {}, 4096, (60, 1500, 4)),
    ],
)
def test_maps_are_averaged_down_to_the_largest_side(
    browser: Browser,
    tmp_path: Path,
    size: tuple[int, int],
    options: dict[str, Any],
    max_side: int,
    shape: tuple[int, ...],
) -> None:
    result = made(*size, **options)
    address, light = f"light={result.pictures[0]}", result.lighting[0]
    with opened(browser, result, tmp_path, max_side=max_side) as view:
        assert shown_off(view, address, result, light, max_side=max_side) <= AT_MOST
        assert view.saved().shape == shape


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
        view.adjust()
        view.control("roughness").fill("0.25")
        for name, pixels in shown.items():
            view.page.get_by_role("radio", name=name).check()
            assert difference(view.saved(), coded(pixels, BAND_MASK))[0] <= 1, name


def test_the_picture_can_be_saved(view: View, furnished: Result) -> None:
    view.adjust()
    view.choose(furnished.pictures[0])
    view.control("rotate").fill("-20")
    wait_until(view.page, "location.hash.includes('rotate=-20')")
    with view.page.expect_download() as download:
        view.page.get_by_role("button", name="Save PNG").click()
    assert download.value.suggested_filename == f"relit-{furnished.pictures[0]}--20.png"
    found = pixels_of_png(Path(download.value.path()).read_bytes())
    light = rotated(furnished.lighting[0], -20)
    true = expected(furnished, light, exposure=view.automatic(), tone_map="neutral")
    assert difference(found, true)[0] <= AT_MOST


@pytest.mark.parametrize(
    ("name", "model"), [("studio_small_03_1k", "paper"), ("kloppenheim_05_1k", "principled")]
)
def test_a_panorama_from_a_file_lights_as_the_package_has_it(
    browser: Browser, furnished: Result, tmp_path: Path, shared_data: Path, name: str, model: Model
) -> None:
    furnished = of_model(furnished, model)
    file = shared_data / "hdri" / f"{name}.hdr"
    light = Environment.read(file)
    with opened(browser, furnished, tmp_path) as view:
        assert view.open(file) == f"{name}.hdr: 1024 × 512."
        assert view.state()["light"] == f"{name}.hdr"
        # The exposure is found here as elsewhere: the 98th percentile becomes white.
        white = np.nanpercentile(relight(furnished, light), 98)
        assert view.automatic() == pytest.approx(-math.log2(white), abs=0.11)

        def off(light: Environment) -> int:
            true = expected(furnished, light, exposure=view.automatic(), tone_map="neutral")
            return difference(view.saved(), true)[0]

        assert off(light) <= AT_MOST
        view.adjust()
        view.control("rotate").fill("-60")
        assert off(light.turned(-60)) <= AT_MOST
        # It stays in the filmstrip beside the recovered lights, which are as they were found.
        view.choose(furnished.pictures[2])
        np.testing.assert_array_equal(view.light(), furnished.lighting[2])
        view.choose(f"{name}.hdr")
        view.control("rotate").fill("0")
        assert off(light) <= AT_MOST


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


def test_every_kind_of_radiance_file_is_read_as_by_the_package(view: View, tmp_path: Path) -> None:
    """Rows as they are, in runs and in old runs take turns."""
    coders: tuple[Callable[[NDArray[np.uint8]], bytes], ...] = (lambda row: row.tobytes(), runs)
    pairs = zip(pixels_of(18, 9), itertools.cycle((*coders, old_runs)), strict=False)
    file = tmp_path / "ünit.hdr"
    file.write_bytes(hdr(b"".join(coder(row) for row, coder in pairs), 18, 9, b"EXPOSURE=2\n"))
    levels = Environment.read(file).blurred.levels()
    assert view.open(file) == f"{file.name}: 18 × 9."
    found = view.page.evaluate(
        "(({ view }) => [...view.opened.environment.levels.slice(3), "
        "...view.opened.environment.hemispheres].map(({ texels }) => Array.from(texels)))"
        "(document.querySelector('.relight-view'))"
    )
    for ours, theirs in zip(levels[3:], found, strict=True):
        np.testing.assert_allclose(np.ravel(ours), theirs, rtol=2e-5)


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
        "expected a panorama of 14 × 7 to 8192 × 4096 pixels, found 12 × 6",
    ),
    "too large": (hdr(b"", 16384, 8192), "8192 × 4096 pixels, found 16384 × 8192"),
    "cut off": (hdr(GOOD[:-9], 16, 8), "expected 8 rows, found the end of the file in row 7"),
    "too long a run": (
        hdr(b"\2\2\0\x10" + b"\xff\x07" * 8, 16, 8),
        "expected 16 pixels a row, found more in row 0",
    ),
    "a run of nothing": (hdr(b"\1\1\1\5", 16, 8), "found more in row 0"),
}


def test_broken_panoramas_are_refused_in_words_and_change_nothing(
    view: View, furnished: Result, tmp_path: Path
) -> None:
    before = view.saved()
    for name, (content, message) in BROKEN.items():
        file = tmp_path / f"{name}.hdr"
        file.write_bytes(content)
        said = view.open(file)
        assert said.startswith(f"{name}.hdr: ")
        assert message in said
    np.testing.assert_array_equal(view.saved(), before)
    assert view.state()["light"] == ""
    tiles = view.page.locator("input[name=light]").count()
    assert tiles == 1 + len(furnished.pictures)


def test_a_panorama_can_be_dropped_on_the_picture(view: View) -> None:
    content = hdr(GOOD, 16, 8)
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
    wait_until(
        view.page,
        "document.querySelector('.relight-message').textContent.startsWith('dropped.hdr: 16')",
    )
    assert not view.page.locator(".relight-drop").is_visible()
    assert view.state()["light"] == "dropped.hdr"


def test_the_lamp_goes_where_the_pointer_is(view: View, furnished: Result) -> None:
    box = view.box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    mouse = view.page.mouse
    mouse.move(x, y)
    mouse.down()
    assert view.state()["azimuth"] == pytest.approx(0, abs=0.2)
    mouse.move(x + box["width"] / 4, y, steps=3)
    assert view.state()["azimuth"] == pytest.approx(44, abs=0.2)
    mouse.move(x, y - box["height"] / 4, steps=3)
    mouse.up()
    mouse.move(x, y)
    placed = view.state()
    assert placed["elevation"] == pytest.approx(44, abs=0.2)
    lamp = DirectionalLight(placed["azimuth"], placed["elevation"])
    wait_until(view.page, "location.hash.includes('elevation')")
    address = view.page.url.partition("#")[2]
    assert shown_off(view, f"{address}&ambient=0", furnished, lamp) <= AT_MOST
    # Beside the picture it stays at the edge.
    box = view.box()
    mouse.move(box["x"] - 40, y)
    mouse.down()
    mouse.up()
    assert view.state()["azimuth"] == pytest.approx(-88, abs=0.2)
    view.go(f"{address}&ambient=0.1")
    view.saved()
    # A mark shows where it is.
    mark = known(view.page.locator(".relight-lamp").bounding_box())
    box = view.box()
    place = [(mark[a] + mark["width"] / 2 - box[a]) / box["width"] for a in ("x", "y")]
    assert place == pytest.approx([0.5, 0.25], abs=0.005)


def test_a_drag_turns_the_light_of_a_picture(view: View, furnished: Result) -> None:
    view.choose(furnished.pictures[0])
    box = view.box()
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
    true = expected(furnished, light, exposure=view.automatic(), tone_map="neutral")
    assert difference(view.saved(), true)[0] <= AT_MOST


def test_keys_move_the_light_and_home_brings_it_back(view: View, furnished: Result) -> None:
    view.page.locator(".relight-canvas").focus()
    keys = ("ArrowRight", "ArrowRight", "Shift+ArrowLeft", "ArrowUp", "Shift+ArrowDown")
    for key in keys:
        view.page.keyboard.press(key)
    assert (view.state()["azimuth"], view.state()["elevation"]) == (-35 + 9, 35 + 4)
    view.page.keyboard.press("Home")
    assert (view.state()["azimuth"], view.state()["elevation"]) == (-35, 35)
    view.page.keyboard.press("]")
    assert view.state()["light"] == furnished.pictures[0]
    for key in keys:
        view.page.keyboard.press(key)
    assert (view.state()["rotate"], view.state()["tilt"]) == (9, 4)
    wait_until(view.page, "document.querySelector('[name=rotate]').value === '9'")
    assert view.control("rotate").get_attribute("aria-valuetext") == "+9°"
    view.page.keyboard.press("Home")
    assert (view.state()["rotate"], view.state()["tilt"]) == (0, 0)
    for _ in range(37):
        view.page.keyboard.press("ArrowRight")
        view.page.keyboard.press("ArrowUp")
    assert (view.state()["rotate"], view.state()["tilt"]) == (-175, 90)
    view.adjust()
    for end in (180, -180):
        view.control("rotate").fill(str(end))
        assert view.state()["rotate"] == end
    view.go("rotate=725")
    assert view.state()["rotate"] == 5


def test_keys_do_everything(view: View, furnished: Result) -> None:
    def stage(name: str) -> Any:
        return view.page.evaluate(f"document.querySelector('.relight-view').view.stage.{name}")

    press = view.page.keyboard.press
    for number, shown in enumerate(VIEWS, start=1):
        press(str(number))
        assert view.state()["view"] == shown
    press("1")
    press("+")
    assert stage("zoom") == 1.25
    view.page.locator(".relight-canvas").focus()
    press("h")
    before = stage("at[0]")
    press("ArrowRight")
    view.page.wait_for_timeout(50)
    assert stage("at[0]") != before
    press("h")
    press("0")
    assert stage("zoom") == 1
    press("c")
    # A picture is compared under its own light.
    assert view.state()["picture"] == view.state()["light"] == furnished.pictures[0]
    press("]")
    assert view.state()["picture"] == view.state()["light"] == furnished.pictures[1]
    press("d")
    wait_until(view.page, "document.querySelector('.relight-difference')")
    assert not view.page.locator(".relight-reveal").is_visible()
    assert "4 × difference of" in view.page.locator(".relight-names").inner_text()
    press("d")
    press("c")
    assert view.state()["picture"] == ""
    wait_until(view.page, "document.querySelector('.relight-before').hidden")
    press("l")
    assert view.state()["light"] == ""
    press("a")
    assert view.page.locator(".relight-panel").is_visible()
    press("a")
    press("?")
    assert view.page.locator(".relight-keys").is_visible()
    press("Escape")
    assert not view.page.locator(".relight-keys").is_visible()
    press("r")
    wait_until(view.page, "location.hash === ''")


def test_the_wheel_zooms_about_the_pointer_and_the_hand_moves_the_picture(view: View) -> None:

    def under(x: float, y: float) -> tuple[float, float]:
        box = view.box()
        return (x - box["x"]) / box["width"], (y - box["y"]) / box["height"]

    box = view.box()
    x, y = box["x"] + 0.3 * box["width"], box["y"] + 0.6 * box["height"]
    view.page.mouse.move(x, y)
    for _ in range(4):
        view.page.mouse.wheel(0, -200)
    view.page.wait_for_timeout(50)
    assert view.box()["width"] > 2 * box["width"]
    assert under(x, y) == pytest.approx((0.3, 0.6), abs=0.01)
    lamp = view.state()["azimuth"]
    view.page.get_by_role("button", name="Move the picture").click()
    view.page.mouse.move(x, y)
    view.page.mouse.down()
    view.page.mouse.move(x + 40, y + 25, steps=3)
    view.page.mouse.up()
    assert under(x + 40, y + 25) == pytest.approx((0.3, 0.6), abs=0.01)
    assert view.state()["azimuth"] == lamp
    view.page.mouse.dblclick(x, y)
    assert view.box() == pytest.approx(box, abs=0.5)
    # The picture is the same whatever is seen of it.
    assert view.saved().shape == (24, 24, 4)


def test_a_picture_is_compared_up_to_a_border_that_moves(view: View, furnished: Result) -> None:
    border = view.page.get_by_role("slider", name="Border between picture and relit")
    assert not border.is_visible()
    view.page.get_by_role("button", name="Compare with a picture").click()
    assert border.get_attribute("aria-valuenow") == "50"
    before = view.page.locator(".relight-before")
    assert before.is_visible()
    box = view.box()
    middle = known(border.bounding_box())
    assert middle["x"] + middle["width"] / 2 == pytest.approx(box["x"] + box["width"] / 2, abs=1)
    border.focus()
    view.page.keyboard.press("ArrowRight")
    assert border.get_attribute("aria-valuenow") == "52"
    lamp = view.state()["azimuth"]
    view.page.keyboard.press("Home")
    assert border.get_attribute("aria-valuenow") == "0"
    assert view.state()["azimuth"] == lamp
    y = middle["y"] + middle["height"] / 2
    view.page.mouse.move(box["x"], y)
    view.page.mouse.down()
    view.page.mouse.move(box["x"] + 0.25 * box["width"], y, steps=3)
    view.page.mouse.up()
    assert border.get_attribute("aria-valuenow") == "25"
    assert "inset(0" in before.evaluate("image => image.style.clipPath")
    wait_until(view.page, "location.hash.includes('picture=')")
    # Any picture can be chosen.
    view.adjust()
    view.control("picture").select_option(furnished.pictures[2])
    wait_until(
        view.page,
        "name => document.querySelector('.relight-before').alt === `Picture ${name}`",
        arg=furnished.pictures[2],
    )
    view.control("picture").select_option("")
    wait_until(view.page, "document.querySelector('.relight-before').hidden")


def test_without_pictures_nothing_is_compared(
    browser: Browser, furnished: Result, tmp_path: Path
) -> None:
    with opened(browser, furnished, tmp_path) as view:
        assert not view.page.get_by_role("button", name="Compare with a picture").is_visible()
        assert view.page.locator(".relight-tile img").count() == len(furnished.pictures)


def test_deviations_are_shown_where_there_are_some(
    browser: Browser, furnished: Result, tmp_path: Path
) -> None:
    assert furnished.uncertainty is not None
    with opened(browser, furnished, tmp_path) as view:
        view.page.get_by_role("radio", name="uncertainty").check()
        menu = view.page.get_by_role("combobox", name="Uncertainty of")
        shown = view.page.locator(".relight-deviation")
        for name in ("roughness", "metallic", "albedo"):
            menu.select_option(name)
            wait_until(
                view.page,
                "name => document.querySelector('.relight-deviation').alt.endsWith(name)",
                arg=name,
            )
            assert shown.evaluate("image => [image.naturalWidth, image.hidden]") == [24, False]
        view.page.get_by_role("radio", name="relit").check()
        wait_until(view.page, "document.querySelector('.relight-deviation').hidden")
    without = dataclasses.replace(furnished, uncertainty=None)
    with opened(browser, without, tmp_path) as view:
        assert not view.page.get_by_role("radio", name="uncertainty").is_visible()
        view.page.keyboard.press("6")
        assert view.state()["view"] == "relit"


def test_every_control_has_a_name_and_can_be_reached(view: View) -> None:
    view.adjust()
    nameless = view.page.evaluate(
        """() => [...document.querySelectorAll('button, input, select, canvas, [role]')]
            .filter((e) => e.checkVisibility() && !e.closest('[aria-hidden=true]'))
            .filter((e) => !(e.getAttribute('aria-label') || e.innerText?.trim() || e.alt
                || e.labels?.[0]?.innerText.trim()))
            .map((e) => e.outerHTML.slice(0, 120))"""
    )
    assert nameless == []
    unseen = view.page.evaluate(
        """async () => {
            const found = [];
            const wanted = [...document.querySelectorAll('button, input, select, [tabindex]')]
                .filter((e) => e.checkVisibility());
            for (const e of wanted) {
                e.focus();
                if (document.activeElement !== e) found.push(e.outerHTML.slice(0, 120));
            }
            return found;
        }"""
    )
    assert unseen == []
    # From the picture on: what is shown, tools, the panel, the filmstrip.
    order = []
    view.page.locator(".relight-canvas").focus()
    for _ in range(40):
        view.page.keyboard.press("Tab")
        order.append(view.page.evaluate("document.activeElement.name"))
        if order[-1] == "light":
            break
    wanted = ["view", "compare", "hand", "zoomout", "zoomin", "adjust", "azimuth", "save", "light"]
    assert [name for name in order if name in wanted] == wanted


def fingers(session: CDPSession, kind: str, points: list[tuple[float, float]]) -> None:
    """One event of a touch screen."""
    touches = [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(points)]
    session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": touches})


def test_one_finger_moves_the_lamp_on_a_phone_and_two_zoom(
    browser: Browser, furnished: Result, tmp_path: Path
) -> None:
    file = tmp_path / "page.html"
    file.write_text(page_of(furnished), encoding="utf-8")
    context = browser.new_context(
        viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True
    )
    page: Page = context.new_page()
    page.goto(file.as_uri())
    page.wait_for_selector(READY)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    tools = page.locator(".relight-tools .tool:visible, .chip span")
    assert min(tools.evaluate_all("(all) => all.map((e) => e.offsetHeight)")) >= 44
    box = known(page.locator(".relight-canvas").bounding_box())
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    session = context.new_cdp_session(page)
    fingers(session, "touchStart", [(x, y)])
    fingers(session, "touchMove", [(x + 20, y - 5)])
    fingers(session, "touchMove", [(x + box["width"] / 4, y)])
    fingers(session, "touchEnd", [])
    wait_until(page, "document.querySelector('.relight-view').view.state.azimuth > 40")
    state = page.evaluate("document.querySelector('.relight-view').view.state")
    assert state["azimuth"] == pytest.approx(44, abs=1)
    assert state["elevation"] == pytest.approx(0, abs=1)
    assert page.evaluate("window.scrollY") == 0
    fingers(session, "touchStart", [(x - 30, y), (x + 30, y)])
    for apart in (40, 60, 75):
        fingers(session, "touchMove", [(x - apart, y), (x + apart, y)])
    fingers(session, "touchEnd", [])
    zoom = page.evaluate("document.querySelector('.relight-view').view.stage.zoom")
    assert zoom == pytest.approx(2.5, abs=0.1)
    context.close()


def test_it_opens_zoomed_to_what_was_fitted(browser: Browser, tmp_path: Path) -> None:
    mask = np.zeros((40, 40), bool)
    mask[12:22, 4:14] = True
    stage = "document.querySelector('.relight-view').view.stage"
    where = f"(({{zoom, centre}}) => [zoom, ...centre])({stage})"
    with opened(browser, made(40, 40, mask=mask), tmp_path) as view:
        at_first = view.page.evaluate(where)
        assert 3 < at_first[0] <= 4
        assert at_first[1:] == pytest.approx([9 / 40, 17 / 40])
        for key in "-+0":
            view.page.keyboard.press(key)
        assert view.page.evaluate(where) == at_first


def test_the_address_says_what_is_shown_and_brings_it_back(
    browser: Browser, furnished: Result, tmp_path: Path
) -> None:
    name = 'a "b" <c> & ü</script>'
    result = dataclasses.replace(furnished, pictures=(name, *furnished.pictures[1:]))
    with opened(browser, result, tmp_path) as view:
        tile = view.page.locator(".relight-tile:has(input[name=light]) span").nth(1)
        assert tile.inner_text() == name
        assert "#" not in view.page.url
        view.adjust()
        view.choose(result.pictures[1])
        view.control("rotate").fill("30")
        view.control("tone").select_option("none")
        wait_until(view.page, "location.hash.includes('tone')")
        address = view.page.url.partition("#")[2]
        assert address == f"light={result.pictures[1]}&rotate=30&tone=none"
        before = view.saved()
        view.page.get_by_role("button", name="Reset").click()
        wait_until(view.page, "location.hash === ''")
        assert view.state()["light"] == ""
        view.go(address)
        np.testing.assert_array_equal(view.saved(), before)
        view.go(f"light={quote(name)}")
        assert view.state()["light"] == name
        assert view.state()["rotate"] == 0
        view.go("rotate=20&light=elsewhere.hdr&exposure=x&view=upside&picture=none")
        assert view.message() == (
            "Address of the page: light elsewhere.hdr is not in this page; a panorama has to be "
            "opened again; exposure: expected a number, found x; view: expected one of relit, "
            "albedo, roughness, metallic, normals, uncertainty, strips, found upside; picture none "
            "is not in this page."
        )
        assert view.state()["rotate"] == 20
        view.go("lights")  # an anchor of the page around
        assert view.state()["rotate"] == 20


def test_a_lost_context_comes_back_with_the_same_picture(view: View) -> None:
    before = view.saved()
    view.page.evaluate(
        """() => {
            const gl = document.querySelector('.relight-canvas').getContext('webgl2');
            window.extension = gl.getExtension('WEBGL_lose_context');
            window.extension.loseContext();
        }"""
    )
    wait_until(view.page, "document.querySelector('.relight-message').textContent !== ''")
    assert "waiting for it" in view.message()
    view.go("azimuth=30")  # a change meanwhile does no harm
    view.page.evaluate("window.extension.restoreContext()")
    wait_until(view.page, "document.querySelector('.relight-message').textContent === ''")
    view.go("azimuth=-35")
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
    file.write_text(page_of(furnished, before=missing), encoding="utf-8")
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
        assert page.locator("input[name=view]").first.is_disabled()


def test_exposures_show_the_lamp_and_every_light_well(
    browser: Browser, furnished: Result, tmp_path: Path
) -> None:
    dark = dataclasses.replace(furnished, lighting=furnished.lighting / 1000)
    with opened(browser, dark, tmp_path) as view:
        assert 100 < np.mean(view.saved()[..., :3]) < 220
        assert view.state()["exposure"] == 0
        view.choose(dark.pictures[0])
        assert 8 < view.automatic() < 12
        found = view.saved()
        assert 100 < np.mean(found[..., :3]) < 220
        true = expected(dark, dark.lighting[0], exposure=view.automatic(), tone_map="neutral")
        assert difference(found, true)[0] <= AT_MOST
        assert maps.of_result(dark, 1024).mask.all()
