"""Targets and directions of 48 bits: what float32 leaves of numbers that came in float64."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import pbrfit
from pbrfit import Objective, Scene
from pbrfit._core import InputError
from pbrfit.model import reflection as model
from pbrfit.synthetic import make_scene
from random_pixels import Array, Example, Kind
from scene_files import lights_of, truth_of
from scene_kinds import at_truth, sum_sq_at


@pytest.fixture(scope="module")
def room() -> Scene:
    """Pictures rendered in float64 from what is known."""
    scene = make_scene("room", size=24, lights=6, seed=3, held_out=1)
    pictures = model.render(truth_of(scene).materials, scene.normals, lights_of(scene), scene.fov)
    return dataclasses.replace(scene, images=pictures)


def squares_at_truth(scene: Scene) -> float:
    objective = Objective(scene)
    return float(sum_sq_at(objective, at_truth(objective, scene)).sum() / objective.samples)


def test_pictures_in_float64_are_explained_to_the_last_digit(room: Scene) -> None:
    assert squares_at_truth(room) < 1e-29
    rounded = dataclasses.replace(room, images=room.images.astype(np.float32))
    assert 1e-17 < squares_at_truth(rounded) < 1e-15


def example_of(channels: int = 3, weights: int | None = None) -> Example:
    """Pixels whose pictures nothing explains."""
    return Example(Kind(channels=channels, weights=weights), 150, 4, noise=0.3)


PIXELS = np.random.default_rng(0).permutation(150)[:140].astype(np.uint64)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("weights", [None, 2])
def test_float64_paths_take_notice(channels: int, weights: int | None) -> None:
    example = example_of(channels, weights)
    problem, x = example.problem(), example.x()
    expected = example.squares(example.unknowns(example.truth))[PIXELS]
    np.testing.assert_allclose(problem.normal_equations(x, PIXELS)[2], expected, rtol=1e-12)
    # From products at the very material, and so to fewer digits.
    _, squares = problem.fit_materials(x, PIXELS, *2 * (np.empty(0),), steps=0, exact_steps=0)
    np.testing.assert_allclose(squares, expected, rtol=1e-10)
    residual = (example.radiance(example.truth) - example.targets)[PIXELS].swapaxes(0, 1)
    np.testing.assert_allclose(problem.residuals(x, PIXELS), residual, rtol=1e-7)
    _, right = problem.light_equations(x[: example.kind.unknowns * 150])
    weighted = example.omega * example.targets
    expected = np.einsum("pnc,pck->cnk", weighted, example.slopes()[1])
    np.testing.assert_allclose(right, expected, rtol=1e-11, atol=1e-11)


def test_small_residuals_keep_their_digits() -> None:
    example = example_of()
    small = 1e-12 * np.random.default_rng(1).normal(size=example.targets.shape)
    example.targets = example.radiance(example.truth) - small
    found = example.problem().residuals(example.x(), PIXELS)
    np.testing.assert_allclose(found, small[PIXELS].swapaxes(0, 1), atol=3e-14)


def pictures() -> list[Array]:
    return list(np.ascontiguousarray(example_of().targets.swapaxes(0, 1)))


class Told:
    """A series that claims another length than it has."""

    def __init__(self, images: list[Array], count: int) -> None:
        self._images, self._count = images, count

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[Array]:
        return iter(self._images)


def changed(picture: Any) -> list[Any]:
    images: list[Any] = [*pictures()]
    images[2] = picture
    return images


@pytest.mark.parametrize(
    ("images", "message"),
    [
        ([], "expected at least one picture, found none"),
        ([None], "expected an array of float32 in 2 dimensions, found NoneType"),
        (changed(np.zeros((150, 1))), r"expected shape \[150, 3\], found shape \[150, 1\]"),
        (changed(np.zeros((150, 3), int)), "expected an array of float32 in 2 dim.*found int64"),
        (changed(np.zeros((3, 50, 3))), r"expected an array of float64 in 2 dim.*\[3, 50, 3\]"),
        (changed(np.full((150, 3), np.nan)), "expected finite numbers, found NaN at 900"),
        (changed(np.full((150, 3), 1e20)), "expected numbers up to 1e16 in size, .* at 900"),
        (Told(pictures(), 3), "expected 3 pictures, found 4"),
        (Told(pictures(), 5), "expected 5 pictures, found 4"),
        (Told(pictures(), 1 << 40), "expected at most 2147483648 pixels times"),
    ],
)
def test_bad_series_are_refused(images: Any, message: str) -> None:
    with pytest.raises(InputError, match=f"^images: {message}"):
        example_of().problem(images=images)


def test_pictures_beyond_float32_are_no_warning() -> None:
    """Divided by the scene scale they are as good as any."""
    scene = make_scene("spheres", size=8, lights=3, seed=1, held_out=1)
    bright = dataclasses.replace(
        scene, images=scene.images.astype(np.float64) * 1e200, truth=None, lighting=None
    )
    assert pbrfit.Objective(bright).problem.pixels == int(scene.valid.sum())
