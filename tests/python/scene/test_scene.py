"""Scene checks its arrays when it is made."""

from __future__ import annotations

import dataclasses
import logging
from typing import Any

import numpy as np
import pytest

from pbrfit import InputError, Materials, Objective, Scene, Truth
from pbrfit.io.color import Conversion, Curve, decode_srgb
from pbrfit.io.file_noise import FileNoise
from pbrfit.model.lamps import Lamps
from pbrfit.synthetic import make_scene
from scene_files import known

H, W, N = 3, 4, 2
FACING = np.broadcast_to([0.0, 0.0, 1.0], (H, W, 3))


def scene(**changes: Any) -> Scene:
    arguments: dict[str, Any] = {"images": np.ones((N, H, W, 3), np.float32), "normals": FACING}
    return Scene(**(arguments | changes))


def with_value(shape: tuple[int, ...], index: tuple[Any, ...], value: float) -> Any:
    array = np.ones(shape, np.float32)
    array[index] = value
    return array


def truth(**changes: Any) -> Truth:
    maps = Materials(np.ones((H, W, 3)), np.ones((H, W)), np.ones((H, W)))
    arguments: dict[str, Any] = {"materials": maps, "lighting": np.ones((N, 16, 3))}
    return Truth(**(arguments | changes))


def test_defaults_are_filled_in() -> None:
    made = scene(normals=3 * FACING, mask=np.ones((H, W), bool))
    assert made.names == ("picture_00", "picture_01")
    assert made.mask is None
    assert made.valid.all()
    assert (made.height, made.width, made.fov) == (H, W, 60.0)
    np.testing.assert_array_equal(made.normals, FACING)


def test_what_the_mask_leaves_out_need_not_be_sound() -> None:
    mask = np.ones((H, W), bool)
    mask[1, 2] = False
    images, normals = with_value((N, H, W, 3), (0, 1, 2, 0), np.nan), FACING.copy()
    normals[1, 2] = np.nan
    for unsound in (np.nan, -1.0, np.inf, 5.0):
        weights = with_value((N, H, W), (slice(None), 1, 2), unsound)
        made = scene(images=images, normals=normals, mask=mask, weights=weights)
        assert np.isnan(made.normals[1, 2]).all()
        assert np.isfinite(made.normals[mask]).all()
        np.testing.assert_array_equal(made.valid, mask)
        np.testing.assert_array_equal(
            known(made.weights), np.broadcast_to(mask[..., None], (N, H, W, 3))
        )


BAD_ARRAYS: dict[str, tuple[dict[str, Any], str]] = {
    "grey pictures": ({"images": np.ones((N, H, W))}, r"images: expected shape .N, H, W, 3."),
    "no pictures": ({"images": np.ones((0, H, W, 3))}, r"images: expected shape"),
    "integer pictures": ({"images": np.ones((N, H, W, 3), int)}, "images: expected linear float32"),
    "one picture": ({"images": np.ones((1, H, W, 3))}, "images: expected at least two.*lighting"),
    "NaN pixel": (
        {"images": with_value((N, H, W, 3), (1, 2, 3, 0), np.nan)},
        "picture_01: expected finite pixels, found 1 .* row 2, column 3",
    ),
    "infinite pixel": (
        {"images": with_value((N, H, W, 3), (0, 0, 0, 2), np.inf)},
        "picture_00: expected finite pixels",
    ),
    "normals of another size": ({"normals": np.ones((H, W + 1, 3))}, r"normals: .*\(3, 5, 3\)"),
    "zero normal": ({"normals": FACING * np.eye(H, W)[..., None]}, "normals: .* found 9 that are"),
    "NaN normals": (
        {"normals": np.full((H, W, 3), np.nan)},
        "normals: expected unit vectors, found 12",
    ),
    "infinite normals": (
        {"normals": np.full((H, W, 3), np.inf)},
        "normals: expected unit vectors, found 12",
    ),
    "empty mask": ({"mask": np.zeros((H, W), bool)}, "mask: expected at least one pixel"),
    "mask of another size": ({"mask": np.ones((H, H), bool)}, r"mask: expected shape \(3, 4\)"),
    "float segments": ({"segments": np.ones((H, W))}, "segments: expected integer ids"),
    "segments of another size": ({"segments": np.ones((W, H), int)}, "segments: expected"),
    "NaN light": ({"lighting": np.full((N, 16, 3), np.nan)}, "lighting: expected finite"),
    "light of order 2": ({"lighting": np.ones((N, 9, 3))}, r"lighting: .* \(2, 16, 3\)"),
    "weights of another size": (
        {"weights": np.ones((H, N))},
        r"weights: expected shape \(3, 4\), \(2, 3, 4\) or \(2, 3, 4, 3\), found \(3, 2\)",
    ),
    "weights of four channels": ({"weights": np.ones((N, H, W, 4))}, "weights: expected shape"),
    "complex weights": ({"weights": np.ones((H, W), complex)}, "weights: expected real numbers"),
    "ragged weights": ({"weights": [[1.0], [1.0, 2.0]]}, "weights: expected an array"),
    "negative weight": (
        {"weights": with_value((H, W), (1, 2), -1e-9)},
        r"weights: expected finite numbers, 0 or more, found -1e-09 at \(1, 2\)",
    ),
    "NaN weight": (
        {"weights": with_value((N, H, W), (1, 0, 3), np.nan)},
        r"weights: .* found nan at \(1, 0, 3\)",
    ),
    "infinite weight": ({"weights": with_value((H, W), (0, 0), np.inf)}, "weights: .* found inf"),
    "weight beyond float32": (
        {"weights": np.full((H, W), 1e39)},
        r"weights: .* found 1e\+39 at \(0, 0\)",
    ),
    "no weight": ({"weights": np.zeros((H, W))}, "weights: .* found none in picture_00"),
    "no weight in a picture": (
        {"weights": np.array([[[1.0]], [[0.0]]]) * np.ones((H, W))},
        "weights: .* in every channel of every picture, found none in picture_01",
    ),
    "no weight in a channel": (
        {"weights": with_value((N, H, W, 3), (1, ..., 2), 0.0)},
        "weights: .* found none in the blue of picture_01",
    ),
    "no weight inside the mask": (
        {"weights": np.eye(H, W), "mask": np.eye(H, W) == 0},
        "weights: .* found none in picture_00",
    ),
    "NaN pixel of some weight": (
        {
            "images": with_value((N, H, W, 3), (1, 2, 3, 0), np.nan),
            "weights": with_value((N, H, W), (0, 2, 3), 0.0),
        },
        "picture_01: expected finite pixels, found 1 .* row 2, column 3",
    ),
    "limits of another size": ({"limits": np.zeros((N, H, W))}, "limits: expected shape"),
    "another limit": ({"limits": np.full((N, H, W, 3), 3)}, "limits: expected 0, 1 or 2"),
    "limits alone": (
        {"limits": np.ones((N, H, W, 3))},
        "limits: expected some sample at no limit in every picture",
    ),
    "sigma of another size": (
        {"normal_sigma": np.ones((H, W + 1))},
        r"normal_sigma: expected shape \(3, 4\), found \(3, 5\)",
    ),
    "one sigma": ({"normal_sigma": 3.0}, r"normal_sigma: expected shape \(3, 4\), found \(\)"),
    "complex sigma": (
        {"normal_sigma": np.ones((H, W), complex)},
        "normal_sigma: expected real numbers, found complex128",
    ),
    "negative sigma": (
        {"normal_sigma": with_value((H, W), (1, 2), -0.5)},
        "normal_sigma: expected finite degrees, 0 or more, found -0.5 at .1, 2.",
    ),
    "NaN sigma": (
        {"normal_sigma": with_value((H, W), (2, 3), np.nan)},
        "normal_sigma: .*found nan at .2, 3.",
    ),
    "sigma beyond float32": (
        {"normal_sigma": np.full((H, W), 1e39)},
        r"normal_sigma: .*found 1e\+39 at .0, 0.",
    ),
    "one name": ({"names": ("a",)}, "names: expected 2 different names"),
    "equal names": ({"names": ("a", "a")}, "names: expected 2 different names"),
    "fov 180": ({"fov": 180.0}, r"fov: expected 0 or degrees in \[0.001, 180\), found 180"),
    "fov NaN": ({"fov": np.nan}, "fov: expected"),
    "fov below 0": ({"fov": -1.0}, "fov: expected"),
    "true maps of another size": (
        {"truth": truth(materials=Materials(np.ones((H, W, 3)), np.ones((H, 9)), np.ones((H, W))))},
        r"truth: expected roughness of shape \(3, 4\), found \(3, 9\)",
    ),
    "too few true lights": (
        {"truth": truth(lighting=np.ones((1, 16, 3)))},
        r"truth: expected lighting of shape \(2, 16, 3\)",
    ),
    "held-out lights without pictures": (
        {"truth": truth(relight_lighting=np.ones((1, 16, 3)))},
        "truth: expected relight_images",
    ),
    "held-out pictures without lights": (
        {"truth": truth(relight_images=np.ones((1, H, W, 3)))},
        "truth: expected relight_lighting",
    ),
}


@pytest.mark.parametrize("name", BAD_ARRAYS)
def test_bad_arrays_are_named_in_one_line(name: str) -> None:
    changes, message = BAD_ARRAYS[name]
    with pytest.raises(InputError, match=message) as caught:
        scene(**changes)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("flip", "cause"),
    [
        ((1, 1, -1), "Z points away from the viewer"),
        ((1, -1, 1), "Y points down (the DirectX convention)"),
        ((-1, 1, 1), "X points left"),
        ((-1, -1, -1), "all three axes are reversed"),
    ],
)
def test_a_flipped_axis_is_named(
    flip: tuple[int, int, int], cause: str, caplog: pytest.LogCaptureFixture
) -> None:
    made = make_scene("room", size=32, lights=2, held_out=1)
    assert not caplog.records
    with caplog.at_level(logging.WARNING, "pbrfit"):
        Scene(images=made.images, normals=made.normals * flip, fov=made.fov)
    [record] = caplog.records
    assert "face away from the camera; likely " in record.message
    assert cause in record.message


@pytest.mark.parametrize(("away", "warned"), [(0, False), (5, False), (6, True)])
def test_a_warning_is_due_above_5_percent(
    away: int, warned: bool, caplog: pytest.LogCaptureFixture
) -> None:
    normals = np.zeros((10, 10, 3))
    normals[..., 2] = 1.0
    normals.reshape(-1, 3)[:away, 2] = -1.0
    normals[..., 0] = np.linspace(-0.5, 0.5, 10)  # not all equal, which has a warning of its own
    Scene(images=np.ones((2, 10, 10, 3)), normals=normals)
    assert [r for r in caplog.records if "face away" in r.getMessage()] == caplog.records
    assert bool(caplog.records) == warned


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.float16, np.int64, bool])
@pytest.mark.parametrize("shape", [(H, W), (N, H, W), (N, H, W, 3)])
def test_weights_are_kept_for_each_value(shape: tuple[int, ...], kind: Any) -> None:
    weights = (np.arange(np.prod(shape)).reshape(shape) % 4).astype(kind)
    given = weights.copy()
    made = scene(weights=weights)
    assert made.weights is not None
    assert made.weights.shape == (N, H, W, 3)
    assert made.weights.dtype == np.float32
    expected = np.broadcast_to(given if given.ndim == 4 else given[..., None], (N, H, W, 3))
    np.testing.assert_array_equal(made.weights, expected)
    np.testing.assert_array_equal(weights, given)
    np.testing.assert_array_equal(made.valid, (expected > 0).any(axis=(0, 3)))
    again = known(scene(weights=made.weights).weights)
    np.testing.assert_array_equal(again, expected)
    assert (again.strides[0] == 0, again.strides[3] == 0) == (given.ndim == 2, given.ndim < 4)


def test_what_has_no_weight_need_not_be_sound() -> None:
    images, normals = with_value((N, H, W, 3), (1, 0, 0, 2), np.nan), FACING.copy()
    images[:, 1, 2] = np.inf
    normals[1, 2] = 0.0
    weights = np.ones((N, H, W))
    weights[1, 0, 0] = weights[:, 1, 2] = 0
    made = scene(images=images, normals=normals, weights=weights)
    assert made.valid.sum() == H * W - 1
    assert not made.valid[1, 2]
    assert np.isnan(made.normals[1, 2]).all()
    assert np.isfinite(made.normals[made.valid]).all()
    assert all(np.isfinite(made.samples(i)).all() for i in range(N))
    assert made.samples(1)[0].tolist() == [0, 0, 0]
    assert made.samples(0)[0].tolist() == [1, 1, 1]


def test_a_value_without_weight_leaves_the_other_channels() -> None:
    images, weights = np.ones((N, H, W, 3)), np.ones((N, H, W, 3))
    images[1, 0, 0, 0], weights[1, 0, 0, 0] = np.nan, 0
    made = scene(images=images, weights=weights)
    assert made.valid.all()
    assert made.samples(1)[0].tolist() == [0, 1, 1]
    told = known(made.channel_weights(1))
    assert told[0, 0].tolist() == [0, 1, 1]
    weights[1, 0, 0] = 1
    with pytest.raises(InputError, match="picture_01: expected finite pixels"):
        scene(images=images, weights=weights)


def test_normals_that_are_all_equal_are_used_with_a_warning(
    caplog: pytest.LogCaptureFixture,
) -> None:
    mask = np.zeros((H, W), bool)
    mask[1:, 1:] = True
    normals = np.arange(H * W * 3.0).reshape(H, W, 3) + 1
    normals[mask] = (0.0, 0.6, 0.8)
    assert not caplog.records
    made = scene(normals=normals, mask=mask)
    [record] = caplog.records
    assert record.getMessage() == (
        "normals: all equal, (0, 0.6, 0.8); on anything but a flat surface shape is taken for "
        "material and light"
    )
    np.testing.assert_allclose(made.normals[mask], [[0, 0.6, 0.8]] * 6)
    caplog.clear()
    normals[1, 1] = (0.0, 0.601, 0.8)
    scene(normals=normals, mask=mask)
    one = np.zeros((H, W), bool)
    one[0, 0] = True  # a single pixel has a single normal
    scene(normals=normals, mask=one)
    assert not caplog.records


def test_negative_values_are_fitted_as_they_are_and_counted() -> None:
    made = make_scene("room", size=8, lights=4, held_out=1)
    images = np.array(made.images)
    assert "negative" not in Scene(images=images, normals=made.normals).assumed
    images[0, 0, :4] = -0.5
    mask = np.ones((8, 8), bool)
    mask[0, 3] = False
    weights = np.ones((4, 8, 8))
    weights[0, 0, 2] = 0
    whole = Scene(images=images, normals=made.normals)
    assert whole.assumed["negative"] == (  # 12 of 768
        "1.6 % of the values are below 0, down to -0.5: fitted as they are"
    )
    masked = Scene(images=images, normals=made.normals, mask=mask)
    assert masked.assumed["negative"].startswith("1.2 % of the values")  # 9 of 756
    weighted = Scene(images=images, normals=made.normals, weights=weights)
    assert weighted.assumed["negative"].startswith("1.2 % of the values")  # 9 of 765
    # A note goes away with what it is about.
    mask[0] = False
    assert "negative" not in dataclasses.replace(whole, mask=mask).assumed
    # They count in the loss: black instead of them is another scene.
    clipped = Scene(images=np.maximum(images, 0), normals=made.normals)
    x = Objective(clipped).start()
    losses = [Objective(one).value_and_grad(x)[0] for one in (whole, clipped)]
    assert losses[0] > losses[1]


def coded(curve: Curve) -> Scene:
    """Values of 8-bit files as that curve decodes them, with what rounding left of the first."""
    values = np.arange(N * H * W * 3).reshape(N, H, W, 3) / 255
    images = (decode_srgb(values) if curve == "srgb" else values).astype(np.float32)
    noise = FileNoise(Conversion(curve), 256, np.full(3, 1 / 12), 0.0)
    return scene(images=images, response=curve, file_noise=(noise, None), assumed={"color": "sRGB"})


@pytest.mark.parametrize(("curve", "other"), [("srgb", "linear"), ("linear", "srgb")])
def test_files_are_decoded_by_another_curve_and_back(curve: Curve, other: Curve) -> None:
    first = coded(curve)
    assert first.decoded_by(curve) is first
    found = first.decoded_by(other)
    assert found.response == other
    np.testing.assert_allclose(found.images, coded(other).images, atol=1e-7)
    np.testing.assert_allclose(found.decoded_by(curve).images, first.images, atol=1e-7)
    for one in (first, found):  # the same values, whatever decodes them
        values = one.file_values(one.images)
        np.testing.assert_allclose(values.ravel(), np.arange(values.size) / 255, atol=1e-6)
    assert found.assumed["color"].startswith(f"{other}: pictures that were left out are explained")
    floors = [one.noise_floor(0) for one in (found, coded(other), first)]
    as_other, expected, before = (np.asarray(floor, np.float64) for floor in floors)
    np.testing.assert_allclose(as_other, expected, rtol=1e-3)
    assert not np.allclose(as_other, before, rtol=0.1)


def test_pictures_of_no_integer_files_have_no_other_curve() -> None:
    made = scene()
    assert made.response is None
    assert made.file_values(made.images) is made.images
    with pytest.raises(InputError, match=r"^response: expected files of integers for linear"):
        made.decoded_by("linear")


def test_a_scene_of_some_pictures_has_what_is_theirs() -> None:
    rng = np.random.default_rng(0)
    images, lighting = rng.random((3, H, W, 3)), rng.random((3, 16, 3))
    all_of = scene(
        images=images,
        weights=images[..., 0],
        limits=np.where(images > 0.7, np.uint8(1), np.uint8(0)),
        names=("a", "b", "c"),
        lighting=lighting,
        lamps=Lamps(np.arange(3), np.eye(3)),
        segments=np.ones((H, W), int),
        truth=truth(lighting=lighting),
    )
    found = all_of.of_pictures([2, 0])
    assert found.names == ("c", "a")
    for name in ("images", "weights", "limits", "lighting"):
        np.testing.assert_array_equal(getattr(found, name), getattr(all_of, name)[[2, 0]])
    np.testing.assert_array_equal(known(found.lamps).places, np.eye(3)[[2, 0]])
    np.testing.assert_array_equal(known(found.truth).lighting, found.lighting)
    assert found.segments is all_of.segments


def test_masked_values_of_pictures_have_no_weight() -> None:
    plain = scene()
    images = np.ma.array(plain.images)
    images[1, 0, 1, 2] = np.ma.masked
    found = scene(images=images)
    assert not isinstance(found.images, np.ma.MaskedArray)
    expected = np.ones(plain.images.shape)
    expected[1, 0, 1, 2] = 0
    np.testing.assert_array_equal(known(found.weights), expected)
    assert scene(images=np.ma.array(plain.images)).weights is None


@pytest.mark.parametrize(
    "name", ["normals", "depth", "segments", "mask", "weights", "lighting", "normal_sigma"]
)
def test_other_masked_arrays_are_refused_by_name(name: str) -> None:
    plain = scene()
    n, height, width, _ = plain.images.shape
    shape = {"normals": (height, width, 3), "lighting": (n, 16, 3)}.get(name, (height, width))
    values = np.ma.array(np.ones(shape, int if name == "segments" else float))
    values[0, 0] = np.ma.masked
    with pytest.raises(InputError, match=f"^{name}: expected an array without a mask"):
        scene(**{name: values})
