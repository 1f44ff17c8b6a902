"""The objective of pixels among surroundings, and all that is made of it, against a slow model."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import reference
from among import Among, Surroundings, open_rows
from finite_differences import ridders
from pbrfit import _core
from pbrfit.model.reflection import MODELS
from random_pixels import Array
from shared_system import Seen, System, accuracy, check_equations, close, dense

PIXELS = 150
"""More than are worked on side by side."""
SOME = np.random.default_rng(2).permutation(PIXELS)[:140].astype(np.uint64)

KINDS = (
    Surroundings(),
    Surroundings(model="principled"),
    Surroundings(bounce=False),
    Surroundings(model="principled", bounce=False, weights=3),
    Surroundings(weights=3),
    Surroundings(channels=1, weights=2),
    Surroundings(model="principled", channels=1),
    Surroundings(sh_order=2, metallic=0.3, weights=2),
    Surroundings(model="principled", sh_order=2, channels=1, metallic=0.0),
    Surroundings(model="principled", known_lights=True),
    Surroundings(known_lights=True, weights=3, channels=1),
)
every_kind = pytest.mark.parametrize("kind", KINDS, ids=str)
any_number = pytest.mark.parametrize("pictures", [3, 17])


@functools.cache
def example_of(kind: Surroundings, pictures: int = 6) -> Among:
    """Whose pictures its materials do not explain."""
    return Among(kind, PIXELS, pictures, noise=0.3)


def contiguous(example: Among) -> tuple[Array, Array, Array]:
    """Albedo in three channels, roughness and metallic."""
    albedo, roughness, metallic = map(np.ascontiguousarray, example.material(example.truth))
    return albedo, roughness, metallic


def split(example: Among, gradient: Array) -> dict[str, Array]:
    """Gradient of the loss by unknowns of pixels (P, D), and of the lights."""
    maps = example.kind.unknowns * example.pixels
    return {"materials": gradient[:maps].reshape(-1, example.pixels).T, "lights": gradient[maps:]}


def gradient_of_the_slow_model(example: Among) -> tuple[float, Array, Array]:
    """Loss, and gradient by unknowns of pixels (P, D) and by the lights, as of `value_and_grad`."""
    j, by_light = example.jacobian()
    value, slope = reference.squares(example.radiance(example.truth) - example.targets)
    total = example.omega.sum()
    scaled = example.omega * slope / total
    return (
        float((example.omega * value).sum() / total),
        np.einsum("pnci,pnc->pi", j, scaled),
        np.einsum("pnc,pck->nkc", scaled, by_light).ravel(),
    )


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("channels", [1, 3])
def test_the_slow_model_is_that_of_the_open_sky_where_nothing_is(model: str, channels: int) -> None:
    """Its factors times the rows of the open sky are the weights of the core's reference."""
    example = Among(Surroundings(model=model, channels=channels, bounce=False), PIXELS)
    example.rows = open_rows(example.given, example.views, model)
    weights = _core.shade(example.given, example.views, *contiguous(example), model=model)
    weights = weights[:, :channels]
    np.testing.assert_allclose(example.slopes()[1], weights, rtol=0, atol=1e-6)


@every_kind
@any_number
def test_loss_and_gradient_are_those_of_the_slow_model(kind: Surroundings, pictures: int) -> None:
    example = example_of(kind, pictures)
    expected, of_pixels, of_lights = gradient_of_the_slow_model(example)
    value, gradient = example.problem().value_and_grad(example.x())
    assert value == pytest.approx(expected, rel=1e-5)
    found = split(example, gradient)
    for i in range(kind.unknowns):
        close(found["materials"][:, i], of_pixels[:, i], 1e-5)
    if kind.known_lights:
        assert found["lights"].size == 0
    else:
        close(found["lights"], of_lights, 1e-5)


@every_kind
@any_number
def test_slopes_are_those_of_differences(kind: Surroundings, pictures: int) -> None:
    """By every unknown, in float64: Σ ω (I − T)² of each pixel against its gradient."""
    example = example_of(kind, pictures)
    problem, everything = example.problem(), example.everything
    _, half, _ = problem.normal_equations(example.x(), everything)
    values = example.unknowns(example.truth)

    def squares(x: Array) -> Array:
        found: Array = problem.normal_equations(x, everything)[2]
        return found

    for i in range(kind.unknowns):

        def moved(by: float, i: int = i) -> Array:
            changed = values.copy()
            changed[:, i] += by
            return squares(np.concatenate([changed.T.ravel(), example.x()[values.size :]]))

        slope, _ = ridders(moved, 0.02)
        close(2 * half[:, i], slope, 1e-7)
    if kind.known_lights:
        return
    gram, right = problem.light_equations(example.x()[: values.size])
    gradient = 2 * (np.einsum("cnkl,nlc->cnk", gram, example.lights) - right)
    for c, n, k in [(0, 0, 0), (kind.channels - 1, pictures - 1, kind.coefficients - 1), (0, 1, 5)]:

        def lit(by: float, c: int = c, n: int = n, k: int = k) -> float:
            lights = example.lights.copy()
            lights[n, k, c] += by
            x = np.concatenate([values.T.ravel(), lights.ravel()])
            return float(squares(x).sum())

        slope, _ = ridders(lit, 0.1)
        assert gradient[c, n, k] == pytest.approx(float(slope), abs=1e-7 * np.abs(gradient).max())


@every_kind
def test_normal_equations_are_products_of_derivatives(kind: Surroundings) -> None:
    check_equations(example_of(kind), SOME)


@every_kind
def test_planted_materials_are_found_from_nothing(kind: Surroundings) -> None:
    """As well as under the open sky."""
    example = Among(kind, 60, 16)
    nodes = np.linspace(0.05, 1, 12), np.linspace(0, 1, 6)
    x = example.x(np.full_like(example.truth, 0.5))
    truth = example.unknowns(example.truth)
    single: dict[str, Any] = {"images": example.targets.swapaxes(0, 1).astype(np.float32)}
    for exact, median, most in ((False, 1e-6, 2e-5), (True, 1e-13, 1e-11)):
        problem = example.problem(**({} if exact else single))
        found, squares = problem.fit_materials(
            x, example.everything, *nodes, starts=3, exact_steps=3
        )
        error = np.abs(found - truth).max(axis=1)
        assert np.median(error) < median
        assert error.max() < most
        if exact:
            np.testing.assert_allclose(squares, example.squares(found), rtol=0, atol=1e-20)


@dataclass(frozen=True)
class SystemAmong(System):
    """A `System` with surroundings."""

    model: str = "paper"
    bounce: bool = True


SYSTEMS = {
    "paper": SystemAmong(damping=1e-3),
    "principled, held at bounds": SystemAmong(model="principled", bounds=True, damping=1e-3),
    "no bounce, weighted": SystemAmong(bounce=False, weights=3, damping=1e-2),
    "principled, with prior, clusters": SystemAmong(model="principled", prior=True, clusters=4),
    "grey, weighted, known metallic": SystemAmong(
        channels=1, weights=2, metallic=0.3, damping=1e-2
    ),
    "principled, order 2, mono": SystemAmong(
        model="principled", sh_order=2, mono=True, damping=1e-3
    ),
    "known lights, clusters": SystemAmong(prior=True, clusters=3, known_lights=True),
}


class SeenAmong(Among, Seen):
    """`Seen` among surroundings."""


@pytest.mark.parametrize("system", SYSTEMS)
def test_the_lights_system_is_that_of_the_slow_model(system: str) -> None:
    example = SeenAmong(SYSTEMS[system])
    expected, moves = dense(example, example.chosen), example.moves()
    share = accuracy(example.kind)
    matrix, gradient = example.ask("schur_complement")
    close(matrix, expected.matrix, share)
    close(gradient, expected.gradient, share)
    kept = example.ask("kept_system")
    close(kept.gradient, expected.gradient, share)
    close(kept.product(moves), expected.matrix @ moves, max(1e-5, share))
    before = example.unknowns(example.truth)[example.chosen]
    after = np.clip(before + expected.steps(moves, example.kind.of_material), 0, 1)
    np.testing.assert_allclose(example.ask("back_substitute", moves), after, rtol=0, atol=1e-7)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("bounce", [False, True])
def test_pictures_are_those_of_the_slow_model(model: str, bounce: bool) -> None:
    example = Among(Surroundings(model=model, bounce=bounce), PIXELS, 4)
    found = _core.render(
        example.given,
        example.views,
        *contiguous(example),
        example.lights,
        1,
        model=model,
        transfer=example.rows,
        bounced=example.given_bounced(),
    )
    close(found.swapaxes(0, 1), example.radiance(example.truth), 1e-12)
