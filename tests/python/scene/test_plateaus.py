"""Plateaus of clipped float pictures are found, and what only looks like them is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from pbrfit.io.color import decode_srgb, encode_srgb
from pbrfit.io.limits import AT_LEAST
from pbrfit.scene.plateaus import NEXT_VALUES, plateaus
from pbrfit.synthetic import make_scene
from scene_files import known

SIDE = 32


def pictures(count: int = 4) -> NDArray[np.float32]:
    rng = np.random.default_rng(3)
    return rng.random((count, SIDE, SIDE, 3)).astype(np.float32)


def found(images: NDArray[np.floating], mask: NDArray[np.bool_] | None = None) -> object:
    counted = None if mask is None else [mask] * len(images)
    return plateaus(images, counted, [True] * len(images))


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_a_common_limit_is_found_in_every_channel_that_reaches_it(kind: type) -> None:
    images: NDArray[np.floating] = pictures().astype(kind)
    images[..., 2] *= 0.5
    clipped = np.minimum(images, kind(0.95))
    limits = known(plateaus(clipped, None, [True] * 4))
    np.testing.assert_array_equal(limits == AT_LEAST, images >= kind(0.95))
    assert not limits[..., 2].any()


@pytest.mark.parametrize(("repeats", "clipped"), [(9, False), (10, True)])
def test_ten_repeats_of_the_maximum_are_no_chance(repeats: int, clipped: bool) -> None:
    images = pictures(1)
    plane = images[0, ..., 1].ravel()
    images[0, ..., 1] = np.minimum(plane, np.sort(plane)[-repeats]).reshape(SIDE, SIDE)
    limits = plateaus(images, None, [True])
    assert (limits is not None) == clipped
    if limits is not None:
        assert np.count_nonzero(limits[..., 1]) == np.count_nonzero(limits) == repeats


@pytest.mark.parametrize(("values", "clipped"), [(NEXT_VALUES - 1, False), (NEXT_VALUES, True)])
def test_a_signal_of_few_values_is_not_continuous(values: int, clipped: bool) -> None:
    image = np.full((1, SIDE, SIDE, 3), 1.0)
    image.reshape(-1, 3)[:values] = 1 - np.arange(1, values + 1)[:, None] / 64
    assert (found(image) is not None) == clipped


@pytest.mark.parametrize(("gap", "clipped"), [(13, True), (15, False)])
def test_a_constant_surface_stands_apart(gap: int, clipped: bool) -> None:
    """A gap of 13.8 times the mean of the next ones has a chance of one in a million."""
    plane = np.linspace(0, 1, SIDE * SIDE)
    step = plane[1]
    plane[-50:] = plane[-51] + gap * step
    image = np.repeat(plane.reshape(1, SIDE, SIDE, 1), 3, axis=-1)
    assert (found(image) is not None) == clipped
    twice = np.concatenate([image, image])  # to the last bit the same in two pictures
    assert found(twice) is not None


def test_former_codes_repeat_everywhere_and_are_no_plateau() -> None:
    codes = np.round(255 * encode_srgb(0.9 * pictures().astype(np.float64))) / 255
    images = decode_srgb(codes).astype(np.float32)
    assert found(images) is None
    halves = pictures().astype(np.float16).astype(np.float32)
    assert found(halves) is None
    assert found(np.minimum(images, images[0, 0, 0, 0])) is not None


def test_what_is_outside_the_mask_does_not_tell() -> None:
    images = pictures()
    images[:, :4] = 7.0
    mask = np.ones((SIDE, SIDE), bool)
    assert found(images) is not None
    mask[:4] = False
    assert found(images, mask) is None


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize("kind", ["room", "spheres", "textured"])
def test_rendered_scenes_have_none(kind: str, noise: float) -> None:
    scene = make_scene(kind, size=48, lights=6, held_out=1, seed=1, noise=noise)
    assert scene.limits is None
    assert "exposure" not in scene.assumed
    highest = np.quantile(scene.images[:, scene.valid], 0.99)
    clipped = replace(scene, images=np.minimum(scene.images, highest))
    np.testing.assert_array_equal(
        (known(clipped.limits) == AT_LEAST)[:, scene.valid],
        (scene.images >= highest)[:, scene.valid],
    )
    assert clipped.assumed["exposure"].startswith("of the values 1 % overexposed")
