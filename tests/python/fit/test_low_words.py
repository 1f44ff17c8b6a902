"""Targets and directions of 48 bits: what float32 leaves of numbers that came in float64."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import pbrfit
import reference
from pbrfit import Objective, Scene, _core
from pbrfit._core import InputError
from pbrfit.model import reflection as model
from pbrfit.synthetic import make_scene

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def room() -> Scene:
    """Pictures rendered in float64 from what is known."""
    scene = make_scene("room", size=24, lights=6, seed=3, held_out=1)
    assert scene.truth is not None
    assert scene.truth.lighting is not None
    pictures = model.render(scene.truth.materials, scene.normals, scene.truth.lighting, scene.fov)
    return dataclasses.replace(scene, images=pictures)


def squares_at_truth(scene: Scene) -> float:
    objective = Objective(scene)
    assert scene.truth is not None
    materials = scene.truth.materials
    x = objective.pack(
        materials.albedo, materials.roughness, materials.metallic, scene.truth.lighting
    )
    pixels = np.arange(objective.pixels, dtype=np.uint64)
    _, _, squares = objective.problem.normal_equations(objective.for_core(x), pixels)
    return float(squares.sum() / objective.samples)


def test_pictures_in_float64_are_explained_to_the_last_digit(room: Scene) -> None:
    assert squares_at_truth(room) < 1e-29
    rounded = dataclasses.replace(room, images=room.images.astype(np.float32))
    assert 1e-17 < squares_at_truth(rounded) < 1e-15


def test_pictures_that_float32_holds_need_no_remainders(
    room: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[np.dtype[Any]] = []

    class Watched:
        def __new__(cls, images: Any, *args: Any, **kwargs: Any) -> Any:
            given.extend({image.dtype for image in images})
            return problem(images, *args, **kwargs)

    problem = _core.Problem
    monkeypatch.setattr("pbrfit.fit.objective._core.Problem", Watched)
    rounded = room.images.astype(np.float32)
    for images in (rounded, rounded.astype(np.float64), room.images):
        Objective(dataclasses.replace(room, images=images))
    assert given == [np.float32, np.float32, np.float64]


class Example:
    """Random pixels and pictures, with a random point that explains nothing."""

    def __init__(self, channels: int = 3, weights: bool = False) -> None:
        rng = np.random.default_rng(4)
        p, n, c = 150, 4, channels
        self.normals = reference.unit(rng.normal(size=(p, 3)) * 0.5 + (0, 0, 1))
        self.views = reference.unit(rng.normal(size=(p, 3)) * 0.2 + (0, 0, 1))
        self.targets = rng.random((n, p, c))
        self.images = self.targets.astype(np.float32)
        self.weights = rng.random((n, p)).astype(np.float32) if weights else None
        albedo, r, m = rng.random((p, c)), rng.random(p), rng.random(p)
        lights = rng.normal(size=(n, 16, c))
        self.x = np.concatenate([albedo.T.ravel(), r, m, lights.ravel()])
        self.by_light = reference.shade(
            self.normals, self.views, np.broadcast_to(albedo, (p, 3)), r, m
        )[:, :c]
        self.radiance = np.einsum("pck,nkc->npc", self.by_light, lights)
        self.omega = np.ones((n, p)) if self.weights is None else self.weights.astype(np.float64)

    def problem(self, images: Any = None) -> _core.Problem:
        """Of 48 bits, or of these pictures."""
        if images is None:
            images = list(self.targets)
        return _core.Problem(images, self.normals, self.views, weights=self.weights)


PIXELS = np.random.default_rng(0).permutation(150)[:140].astype(np.uint64)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("weights", [False, True])
def test_float64_paths_take_notice(channels: int, weights: bool) -> None:
    example = Example(channels, weights)
    problem, x = example.problem(), example.x
    residual = example.radiance - example.targets
    omega = example.omega
    _, _, squares = problem.normal_equations(x, PIXELS)
    expected = np.einsum("np,npc->p", omega, residual**2)[PIXELS]
    np.testing.assert_allclose(squares, expected, rtol=1e-12)
    # From products at the very material, and so to fewer digits.
    _, squares = problem.fit_materials(x, PIXELS, *2 * (np.empty(0),), steps=0, exact_steps=0)
    np.testing.assert_allclose(squares, expected, rtol=1e-10)
    np.testing.assert_array_equal(problem.residuals(x, PIXELS).shape, (4, len(PIXELS), channels))
    np.testing.assert_allclose(problem.residuals(x, PIXELS), residual[:, PIXELS], rtol=1e-7)
    _, right = problem.light_equations(x[: -4 * 16 * channels])
    expected = np.einsum("np,npc,pck->cnk", omega, example.targets, example.by_light)
    np.testing.assert_allclose(right, expected, rtol=1e-11, atol=1e-11)


def test_small_residuals_keep_their_digits() -> None:
    example = Example()
    small = 1e-12 * np.random.default_rng(1).normal(size=example.targets.shape)
    targets = example.radiance - small
    problem = example.problem(list(targets))
    found = problem.residuals(example.x, PIXELS)
    np.testing.assert_allclose(found, small[:, PIXELS], atol=3e-14)


def test_the_fast_evaluation_takes_no_notice() -> None:
    example = Example()
    with_them, gradient = example.problem().value_and_grad(example.x)
    without, same = example.problem(example.images).value_and_grad(example.x)
    assert with_them == without
    np.testing.assert_array_equal(gradient, same)


def test_single_pictures_are_double_ones_without_remainders() -> None:
    example = Example()
    single = example.images
    double = list(single.astype(np.float64))
    mixed = [double[0], single[1], double[2], single[3]]
    whole = example.problem(single).normal_equations(example.x, PIXELS)
    for images in (list(single), double, mixed):
        for a, b in zip(
            whole, example.problem(images).normal_equations(example.x, PIXELS), strict=True
        ):
            np.testing.assert_array_equal(a, b)


class Told:
    """A series that claims another length than it has."""

    def __init__(self, images: list[Array], count: int) -> None:
        self._images, self._count = images, count

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[Array]:
        return iter(self._images)


def changed(picture: Any) -> list[Any]:
    images: list[Any] = list(Example().targets)
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
        (Told(list(Example().targets), 3), "expected 3 pictures, found 4"),
        (Told(list(Example().targets), 5), "expected 5 pictures, found 4"),
        (Told(list(Example().targets), 1 << 40), "expected at most 2147483648 pixels times"),
    ],
)
def test_bad_series_are_refused(images: Any, message: str) -> None:
    with pytest.raises(InputError, match=f"^images: {message}"):
        Example().problem(images)


def test_an_error_of_a_series_is_its_own() -> None:
    def images() -> Iterator[Array]:
        yield Example().targets[0]
        raise OSError("no more")

    class Broken(Told):
        def __iter__(self) -> Iterator[Array]:
            return images()

    with pytest.raises(OSError, match="no more"):
        Example().problem(Broken([], 4))


def test_pictures_beyond_float32_are_no_warning() -> None:
    """Divided by the scene scale they are as good as any."""
    scene = make_scene("spheres", size=8, lights=3, seed=1, held_out=1)
    bright = dataclasses.replace(
        scene, images=scene.images.astype(np.float64) * 1e200, truth=None, lighting=None
    )
    assert pbrfit.Objective(bright).problem.pixels == int(scene.valid.sum())
