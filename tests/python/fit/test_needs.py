"""Which parts of a fit apply, and why others do not."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import pbrfit
from pbrfit import decompose
from pbrfit.fit.causes import left_out_words
from pbrfit.fit.objective import Objective
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.fit.priors.penalties import chosen_priors, color_deviation
from pbrfit.fit.settings import GREY_WEIGHT, NEAR_GREY
from pbrfit.result.options import SOLVERS, Priors, Solver
from pbrfit.synthetic import make_scene
from scene_files import known, truth_of

SIZE, N = 8, 3
ALL = Priors(material=1.0, cohesion=1.0, smoothness=1.0, sparsity=1.0, monochrome=1.0)


@functools.cache
def room(sh_order: int = 3) -> pbrfit.Scene:
    return make_scene("room", size=SIZE, lights=N, held_out=1, sh_order=sh_order)


def scene(**changes: Any) -> pbrfit.Scene:
    return dataclasses.replace(room(), **changes)


def known_lights(sh_order: int = 3) -> pbrfit.Scene:
    made = room(sh_order)
    return dataclasses.replace(made, lighting=truth_of(made).lighting)


def grey() -> pbrfit.Scene:
    made = scene(truth=None)
    return dataclasses.replace(made, images=np.repeat(made.images[..., :1], 3, axis=-1))


def needs(of: pbrfit.Scene, priors: Priors = ALL, **options: Any) -> tuple[str, ...]:
    """What is left out of a fit with `options` of a layout."""
    layout = ParameterLayout.of(of, **options)
    return tuple(left_out_words(of, layout, priors, None))


def off_grey(deviation: float) -> NDArray[np.float64]:
    """Lights (N, 16, 3) with this `color_deviation`: 1 + s, 1, 1 - s has 2s² / (3 + 2s²)."""
    s = np.sqrt(1.5 * deviation**2 / (1 - deviation**2))
    colors = np.array([1 + s, 1.0, 1 - s])
    return np.asarray(np.random.default_rng(0).normal(size=(N, 16, 1)) * colors)


def test_a_scene_that_has_all_leaves_out_nothing() -> None:
    assert needs(scene()) == ()
    assert chosen_priors(ParameterLayout.of(scene()), ALL) == ALL


HALF = np.arange(SIZE**2).reshape(SIZE, SIZE) % 2 == 0
BELOW = np.repeat([[False], [True]], [1, SIZE - 1], axis=0).repeat(SIZE, axis=1)
WEIGHTS = np.ones((N, SIZE, SIZE))
WEIGHTS[:, :2] = WEIGHTS[0, 5, :3] = 0
KNOWN = "lights and their gradient: known, so only materials were fitted"


@pytest.mark.parametrize(
    ("of", "options", "expected"),
    [
        (scene(mask=HALF), {}, ("32 pixels outside the mask",)),
        (scene(weights=HALF), {}, ("32 pixels without a usable sample",)),
        (
            scene(mask=BELOW, weights=WEIGHTS),
            {},
            (
                f"{SIZE} pixels outside the mask",
                f"{SIZE} pixels without a usable sample",
                "9 values of weight 0 at other pixels",
            ),
        ),
        (
            grey(),
            {},
            (
                "second and third colour channel: equal to the first",
                "prior monochrome: lights have one channel",
            ),
        ),
        (
            scene(),
            {"mono_light": True},
            ("prior monochrome: lights have one channel",),
        ),
        (scene(), {"sh_order": 2}, ()),
        (scene(), {"metallic_known": True}, ("prior sparsity: metallic is given",)),
        (known_lights(), {}, (KNOWN, "prior monochrome: lights are known")),
        (
            known_lights(sh_order=2),
            {},
            (
                "band 3 of the lights: the known lights have none",
                KNOWN,
                "prior monochrome: lights are known",
            ),
        ),
        (scene(segments=None), {}, ("prior cohesion: no pixel has a segment",)),
        (
            scene(segments=np.zeros((SIZE, SIZE), int)),
            {},
            ("prior cohesion: no pixel has a segment",),
        ),
        (
            scene(segments=np.arange(SIZE**2).reshape(SIZE, SIZE) + 1),
            {},
            ("prior smoothness: no two neighbours that could be alike",),
        ),
        (scene(), {"priors": Priors.none()}, ()),
    ],
)
def test_what_is_left_out_is_said(
    of: pbrfit.Scene, options: dict[str, Any], expected: tuple[str, ...]
) -> None:
    assert needs(of, **options) == expected


def test_deviation_from_grey_by_hand() -> None:
    assert color_deviation(np.full((2, 4, 3), 7.0)) == 0
    assert color_deviation(np.zeros((2, 4, 3))) == 0
    assert color_deviation(np.array([[[1.0, 0, 0]]])) == pytest.approx(np.sqrt(2 / 3), rel=1e-15)
    assert color_deviation(np.array([[[3.0, 2, 1], [0, 0, 0]]])) == pytest.approx(np.sqrt(2 / 14))
    lights = np.random.default_rng(1).normal(size=(N, 16, 3))
    for scale in (1e3, 1e300, 1e-300):
        assert color_deviation(scale * lights) == pytest.approx(color_deviation(lights), rel=1e-14)


@pytest.mark.parametrize(
    ("deviation", "weight"),
    [(0.0, GREY_WEIGHT), (0.999 * NEAR_GREY, GREY_WEIGHT), (1.001 * NEAR_GREY, 0.0), (0.4, 0.0)],
)
def test_monochrome_is_for_lights_near_grey(deviation: float, weight: float) -> None:
    lighting = off_grey(deviation)
    assert color_deviation(lighting) == pytest.approx(deviation, abs=1e-12)
    of, layout = scene(), ParameterLayout.of(scene())
    assert chosen_priors(layout, Priors(), lighting).monochrome == weight
    found = left_out_words(of, layout, Priors(), lighting=lighting)
    said = [entry for entry in found if "monochrome" in entry]
    assert len(said) == (weight == 0)
    assert all("from grey, above 0.05" in entry for entry in said)


@pytest.mark.parametrize("solver", SOLVERS)
def test_monochrome_is_obeyed_without_the_material_prior(solver: Solver) -> None:
    coloured = make_scene("room", size=12, lights=3, seed=3, held_out=1, noise=0.01)

    def off(weight: float) -> float:
        priors = Priors(material=0, monochrome=weight)
        result = decompose(coloured, solver=solver, priors=priors, refine_normals="off")
        return color_deviation(result.lighting)

    free, grey = off(0.0), off(1.0)
    assert free > 0.08
    assert grey < 0.5 * free


def test_known_lights_without_band_three_need_none() -> None:
    """Adding zeros gives the same sums; one coefficient of band 3 brings it back."""
    of = known_lights(sh_order=2)
    two = Objective(of)
    assert two.coefficients == 9
    lighting = known(of.lighting).copy()
    lighting[0, 15, 0] = 1e-30
    three = Objective(dataclasses.replace(of, lighting=lighting))
    assert three.coefficients == 16
    x = two.start()
    (a, of_two), (b, of_three) = (objective.value_and_grad(x) for objective in (two, three))
    assert a == pytest.approx(b, rel=1e-6)
    np.testing.assert_allclose(of_two, of_three, rtol=1e-4, atol=1e-6 * np.abs(of_two).max())
    np.testing.assert_array_equal(two.unpack(x)[1], known(of.lighting))
