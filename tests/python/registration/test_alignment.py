"""Pictures of one view are compared by their edges, whatever lights them."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from pbrfit.registration import alignment
from pbrfit.registration.alignment import Alignment
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import make_scene
from scene_files import known

Picture = NDArray[np.floating[Any]]


@cache
def room(size: int = 192, lights: int = 5) -> Scene:
    return make_scene("furnished", size=size, lights=lights, held_out=1, seed=11)


def moved(image: Picture, right: Any, down: Any) -> Picture:
    """Content displaced by so many pixels, between pixels by cubic splines."""
    row, column = np.mgrid[: image.shape[0], : image.shape[1]]
    planes = [
        map_coordinates(image[..., c], [row - down, column - right], order=3, mode="nearest")
        for c in range(3)
    ]
    return np.stack(planes, axis=-1).clip(0)


def between(
    first: Picture, second: Picture, mask: NDArray[np.bool_] | None = None
) -> Alignment | None:
    """How the second lies relative to the first."""
    fields = [alignment.edges(image, mask) for image in (first, second)]
    return alignment.compare(*fields, pixel=max(first.shape) / max(fields[0].shape))


@pytest.mark.parametrize(("right", "down"), [(2.0, 0.0), (0.0, -3.0), (1.5, 2.5), (-6.3, 4.2)])
def test_a_shift_is_measured_under_another_light(right: float, down: float) -> None:
    first, second = room().images[:2]
    found = known(between(first, moved(second, right, down)))
    np.testing.assert_allclose(found.shift, (right, down), atol=0.25)
    assert found.agreement > 0.6
    assert found.moved > 0.5


def test_shifts_of_large_pictures_are_in_their_own_pixels() -> None:
    image = np.kron(room(192).images[0], np.ones((4, 4, 1)))
    assert max(image.shape) > alignment.SIDE
    found = known(between(image, np.roll(image, (0, 9), axis=(0, 1))))
    assert found.pixel == 1.5
    np.testing.assert_allclose(found.shift, (9, 0), atol=0.4)


def test_what_the_mask_leaves_out_is_not_compared() -> None:
    first, second = (image.copy() for image in room().images[:2])
    mask = np.ones(first.shape[:2], bool)
    mask[:, 96:] = False
    second[:, 100:] = moved(second, 5, 0)[:, 100:]
    seen, masked = (known(between(first, second, use)) for use in (None, mask))
    assert seen.moved > 0.2
    assert masked.moved < 0.02
    first[:, 96:] = np.nan
    assert between(first, second, mask) == pytest.approx(masked)


def test_pictures_without_edges_cannot_be_compared() -> None:
    even = np.full((80, 80, 3), 0.4)
    assert between(even, room(80).images[0]) is None
    assert between(even, even) is None
    assert not np.abs(alignment.edges(np.zeros((9, 9, 3)))).any()
