"""Raw files: how LibRaw is asked to develop them, and what comes of one."""

from __future__ import annotations

import io
import struct
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from pbrfit import InputError, Scene
from pbrfit.io import images, raw_files
from pbrfit.io.color import REC709, rgb_to_xyz
from pbrfit.io.limits import AT_LEAST, AT_MOST
from scene_files import known

H, W = 12, 16
HEAD = b"II*\0\x08\0\0\0\0\0"


class FakeRaw:
    """What `rawpy.imread` gives, of a picture of 16 bits."""

    def __init__(self, developed: NDArray[np.uint16], flip: int = 0) -> None:
        rows, columns = developed.shape[:2][:: -1 if flip & 4 else 1]
        self.developed = developed
        self.asked: dict[str, Any] = {}
        self.sizes = SimpleNamespace(height=rows, width=columns, flip=flip)
        self.raw_image_visible = np.full((rows, columns), 500, np.uint16)
        self.raw_colors_visible = np.tile([[0, 1], [3, 2]], (rows // 2, columns // 2))
        self.white_level = 1000
        self.camera_white_level_per_channel: list[int] | None = None
        self.black_level_per_channel = [0, 0, 0, 0]
        self.camera_whitebalance = [2.0, 1.0, 1.5, 0.0]
        self.color_matrix = np.eye(3, 4)
        self.rgb_xyz_matrix = np.zeros((4, 3))
        self.thumb: bytes | None = None

    def __enter__(self) -> FakeRaw:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def postprocess(self, **asked: Any) -> NDArray[np.uint16]:
        self.asked = asked
        return self.developed

    def extract_thumb(self) -> Any:
        if self.thumb is None:
            raise FakeError(b"No thumbnail in file")
        return SimpleNamespace(data=self.thumb)


class FakeError(Exception):
    pass


def codes() -> NDArray[np.uint16]:
    return np.random.default_rng(0).integers(1, 65535, (H, W, 3)).astype(np.uint16)


@pytest.fixture
def raw(monkeypatch: pytest.MonkeyPatch) -> FakeRaw:
    """A raw file that the module named rawpy gives for any content."""
    return use(monkeypatch, FakeRaw(codes()))


def use(monkeypatch: pytest.MonkeyPatch, fake: FakeRaw) -> FakeRaw:
    def imread(file: io.BytesIO) -> FakeRaw:
        if file.read() == HEAD + b"damaged":
            raise FakeError(b"Unsupported file format\nor not RAW file")
        return fake

    module = SimpleNamespace(
        imread=imread, LibRawError=FakeError, ColorSpace=SimpleNamespace(sRGB="sRGB")
    )
    monkeypatch.setitem(sys.modules, "rawpy", module)
    return fake


def written(folder: Path, content: bytes = b"", name: str = "a.nef") -> Path:
    path = folder / name
    path.write_bytes(HEAD + content)
    return path


@pytest.mark.parametrize("suffix", ["dng", "nef", "cr2", "cr3", "arw", "raf", "orf", "rw2", "NEF"])
def test_it_is_developed_to_linear_light_that_no_picture_s_content_changes(
    raw: FakeRaw, tmp_path: Path, suffix: str
) -> None:
    picture = images.read_picture(written(tmp_path, name=f"a.{suffix}"))
    assert raw.asked == {
        "gamma": (1, 1),
        "no_auto_bright": True,
        "adjust_maximum_thr": 0.0,
        "use_camera_wb": True,
        "output_bps": 16,
        "output_color": "sRGB",
    }
    np.testing.assert_allclose(picture.pixels, raw.developed / 65535, rtol=1e-6)
    assert picture.color == "linear Rec.709, camera white balance 2, 1, 1.5 (raw file, LibRaw)"
    assert (picture.stored is None, picture.limits, picture.alpha) == (False, None, None)
    assert picture.taken.focal_length_35mm is None
    assert known(picture.stored).in_words() == "16-bit RAW"


def test_codes_at_the_end_are_limits(raw: FakeRaw, tmp_path: Path) -> None:
    raw.developed[1, 2] = (65535, 0, 7)
    limits = known(images.read_picture(written(tmp_path)).limits)
    assert limits[1, 2].tolist() == [AT_LEAST, AT_MOST, 0]
    assert np.count_nonzero(limits) == 2
    high = known(images.read_picture(written(tmp_path), code_range=(0, 100)).limits)
    np.testing.assert_array_equal(high == AT_LEAST, raw.developed > 25700)


def test_a_clipped_sample_bounds_the_colours_around_it(raw: FakeRaw, tmp_path: Path) -> None:
    raw.raw_image_visible[4, 6] = 990  # red, 0.99 of the white level
    raw.raw_image_visible[8, 8] = 989
    limits = known(images.read_picture(written(tmp_path)).limits)
    expected = np.zeros((H, W, 3), int)
    expected[2:7, 4:9, 0] = AT_LEAST
    np.testing.assert_array_equal(limits, expected)


def test_clipped_channels_bound_colours_they_are_taken_from(raw: FakeRaw, tmp_path: Path) -> None:
    raw.color_matrix[0, :3] = (1.5, -0.5, 0.0)
    raw.raw_image_visible[5, 6] = 1000  # the second green
    limits = known(images.read_picture(written(tmp_path)).limits)
    assert limits[5, 6].tolist() == [AT_MOST, AT_LEAST, 0]


def test_without_a_matrix_of_the_file_it_follows_from_that_of_xyz(raw: FakeRaw) -> None:
    """A camera whose channels are those of sRGB needs none, whatever their scale."""
    raw.color_matrix[:] = 0
    to_linear = np.linalg.inv(rgb_to_xyz(REC709))
    raw.rgb_xyz_matrix[:3] = np.diag([3.0, 2.0, 1.0]) @ to_linear
    matrix = known(raw_files._matrix(raw))
    np.testing.assert_allclose(matrix, np.eye(3), atol=1e-12)
    raw.rgb_xyz_matrix[:] = 0
    assert raw_files._matrix(raw) is None


def test_a_sensor_of_another_shape_leaves_the_developed_codes(raw: FakeRaw, tmp_path: Path) -> None:
    raw.raw_image_visible = np.full((H + 2, W), 1000, np.uint16)
    raw.raw_colors_visible = np.zeros((H + 2, W), np.uint8)
    assert images.read_picture(written(tmp_path)).limits is None


@pytest.mark.parametrize(
    "head", [b"II*\0", b"IIU\0", b"IIRO"], ids=["TIFF", "Panasonic", "Olympus"]
)
@pytest.mark.usefixtures("raw")
def test_the_focal_length_of_its_own_exif(tmp_path: Path, head: bytes) -> None:
    # One entry that points to the EXIF directory, which has one of its own.
    own = struct.pack("<IHHHIII", 8, 1, 0x8769, 4, 1, 26, 0)
    own += struct.pack("<HHHIII", 1, 0xA405, 3, 1, 35, 0)
    path = tmp_path / "a.rw2"
    path.write_bytes(head + own)
    assert images.read_picture(path).taken.focal_length_35mm == 35


@pytest.mark.parametrize(
    ("content", "options", "message"),
    [
        (b"damaged", {}, r"a.nef: expected a raw file that LibRaw reads, found Unsupported file"),
        (b"", {"color_space": "srgb"}, "a.nef: expected colour space linear .*, found srgb"),
        (b"", {"layer": "x"}, "a.nef: expected an EXR file with layer x, found RAW"),
    ],
)
@pytest.mark.usefixtures("raw")
def test_what_cannot_be_read_is_refused_in_one_line(
    tmp_path: Path, content: bytes, options: Any, message: str
) -> None:
    with pytest.raises(InputError, match=message) as caught:
        images.read_picture(written(tmp_path, content), **options)
    assert "\n" not in str(caught.value)


def test_channels_that_are_none_are_refused(raw: FakeRaw, tmp_path: Path) -> None:
    raw.developed = raw.developed[..., :1]
    with pytest.raises(InputError, match=r"a.nef: expected three channels of 16 bits, found"):
        images.read_picture(written(tmp_path))


def test_without_rawpy_it_says_what_to_do(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "rawpy", None)
    with pytest.raises(InputError, match=r"a.nef: .* pip install 'pbrfit\[raw\]', or develop"):
        images.read_picture(written(tmp_path))


@pytest.mark.parametrize("read", [images.read_data, images.read_ids, images.read_channels])
@pytest.mark.usefixtures("raw")
def test_maps_are_in_no_raw_file(tmp_path: Path, read: Any) -> None:
    with pytest.raises(InputError, match=r"a.nef: expected EXR, HDR, .*, found a raw file"):
        read(written(tmp_path))


BLACK, WHITE = 128, 4095

NEUTRAL = (0.5, 1.0, 0.8)
"""What the camera's channels are of white: the balance is 2, 1, 1.25."""

XYZ_TO_CAMERA = (0.67, -0.06, -0.10, -0.43, 1.25, 0.20, -0.09, 0.22, 0.57)


def write_dng(path: Path, white_share: NDArray[np.floating[Any]], orientation: int = 1) -> None:
    """Write a picture of a white card whose radiance (H, W), of the green white level, is given.

    The pattern is R G, G B; sensors stop at their white level.
    """
    share = np.array(white_share, np.float64)
    share[0::2, 0::2] *= NEUTRAL[0]
    share[1::2, 1::2] *= NEUTRAL[2]
    bayer = np.rint(BLACK + np.minimum(share, 1) * (WHITE - BLACK)).astype(np.uint16)

    def rationals(values: tuple[float, ...]) -> tuple[int, ...]:
        return tuple(part for value in values for part in (round(10_000 * value), 10_000))

    tags = [
        (271, "s", 0, "Acme", False),
        (272, "s", 0, "Acme One", False),
        (274, "H", 1, orientation, False),
        (33421, "H", 2, (2, 2), False),  # repeated pattern
        (33422, "B", 4, (0, 1, 1, 2), False),
        (50706, "B", 4, (1, 4, 0, 0), False),  # version
        (50708, "s", 0, "Acme One", False),
        (50714, "H", 1, BLACK, False),
        (50717, "H", 1, WHITE, False),
        (50721, "2i", 9, rationals(XYZ_TO_CAMERA), False),
        (50728, "2I", 3, rationals(NEUTRAL), False),
        (50778, "H", 1, 21, False),  # D65
    ]
    tifffile.imwrite(path, bayer, photometric=32803, planarconfig=1, extratags=tags, metadata=None)


@pytest.fixture
def libraw() -> None:
    pytest.importorskip("rawpy")


@pytest.mark.usefixtures("libraw")
@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_a_white_card_is_grey_by_its_share_of_white_level(tmp_path: Path, orientation: int) -> None:
    """Whatever else is in the picture, and whether or not anything is near the white level."""
    card = np.full((40, 60), 0.25)
    card[:, 30:] = 0.125
    card[4:8, 40:44] = 4.0
    write_dng(tmp_path / "a.dng", card, orientation)
    picture = images.read_picture(tmp_path / "a.dng")
    seen = np.rot90(card, {1: 0, 3: 2, 6: -1, 8: 1}[orientation])
    assert picture.pixels.shape == (*seen.shape, 3)
    for level in (0.25, 0.125):
        inside = seen == level
        middle = np.median(picture.pixels[inside], axis=0)
        np.testing.assert_allclose(middle, level, rtol=2e-3)
    assert (known(picture.limits)[seen == 4.0] == AT_LEAST).all()
    assert not known(picture.limits)[seen == 0.25].any()
    assert picture.color.startswith("linear Rec.709, camera white balance 2, 1, 1.25")


@pytest.mark.usefixtures("libraw")
def test_a_scene_of_raw_files(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    across = np.linspace(0.1, 0.3, 64)
    for i in range(3):
        write_dng(tmp_path / "images" / f"{i}.dng", np.tile(across * (i + 1) / 3, (48, 1)))
    scene = Scene.load(tmp_path)
    ratio = np.median(scene.images[2][:, 8:-8] / scene.images[0][:, 8:-8])
    assert ratio == pytest.approx(3, rel=1e-2)
    assert not scene.normals_known
