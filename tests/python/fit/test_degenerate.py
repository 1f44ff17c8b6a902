"""What pictures cannot tell is not called usable: few lights, black channels, nothing lit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from pbrfit import Materials, Scene, decompose
from pbrfit.fit.independent_lights import Shown
from pbrfit.result.verdict import PARAMETERS, USABLE_ERROR, levels
from pbrfit.synthetic import make_scene
from pbrfit.values.arrays import Array
from scene_files import known, truth_of

Draw = Callable[[Array, np.random.Generator], Array]


def mixed(rank: int) -> Draw:
    """Pictures under sums of so many lights, each with its own tint."""

    def draw(images: Array, rng: np.random.Generator) -> Array:
        shares = rng.uniform(0.1, 1.0, (int(rng.integers(2, 13)), rank, 3))
        return np.asarray(np.einsum("nrc,rhwc->nhwc", shares, images[:rank]))

    return draw


def one_lit(images: Array, rng: np.random.Generator) -> Array:
    row, column = rng.integers(0, images.shape[1], 2)
    found = np.zeros_like(images)
    found[:, row, column] = images[:, row, column]
    return found


KINDS: dict[str, Draw] = {
    "one light": mixed(1),
    "two lights": mixed(2),
    "three lights": mixed(3),
    "exposures": lambda images, _: images[:1] * 0.5 ** np.arange(4.0)[:, None, None, None],
    "five copies and another": lambda images, _: images[[0, 0, 0, 0, 0, 1]],
    "black channel": lambda images, rng: images * np.eye(3)[int(rng.integers(3))],
    "facing away": lambda images, _: images,
    "one pixel lit": one_lit,
    "constant": lambda images, rng: np.ones_like(images) * rng.uniform(0.2, 1, (8, 1, 1, 3)),
}


def degenerate(kind: str, seed: int, size: int) -> tuple[Scene, Materials]:
    """A scene with up to 1 % noise, and what is true of it."""
    rng = np.random.default_rng([seed, len(kind)])
    scene = make_scene("room", size=size, lights=8, held_out=1, seed=int(rng.integers(1000)))
    images = KINDS[kind](np.asarray(scene.images, np.float64), rng)
    images = images + rng.normal(0, seed % 2 * 0.01 * images.mean(), images.shape)
    normals = scene.normals * (1, 1, -1) if kind == "facing away" else scene.normals
    changed = replace(scene, images=images, normals=normals, names=(), truth=None, lighting=None)
    return changed, truth_of(scene).materials


def wrong(kind: str, seed: int, size: int = 24) -> list[str]:
    """Maps that are called usable and are not."""
    scene, true = degenerate(kind, seed, size)
    found = decompose(scene, light="sh", refine_normals="off", threads=1)
    verdicts = known(found.uncertainty).verdicts
    if kind in ("one light", "exposures", "constant"):
        assert {one.level for one in verdicts.values()} == {"not determined"}
        for name, level in levels(known(found.uncertainty).deviation).items():
            assert (level[found.mask] > 0).all(), name
    if kind == "black channel":
        assert verdicts["albedo"].level == "not determined"
    off = {
        name: float(np.sqrt(np.mean((getattr(found, name) - getattr(true, name))[found.mask] ** 2)))
        for name in PARAMETERS
    }
    return [
        f"{kind} {seed}: {name} ± {verdicts[name].expected_error:.3f} is off by {error:.3f}"
        for name, error in off.items()
        if verdicts[name].level == "usable" and error > USABLE_ERROR[name]
    ]


@pytest.mark.parametrize(
    "kind",
    [
        *("one light", "black channel"),
        pytest.param("five copies and another", marks=pytest.mark.slow),
        pytest.param("facing away", marks=pytest.mark.slow),
    ],
)
def test_no_wrong_map_is_usable(kind: str) -> None:
    assert not wrong(kind, 1, 16)


@pytest.mark.slow
def test_hardly_a_wrong_map_is_usable() -> None:
    seeds = range(2, 10)
    found = [wrong(kind, seed) for kind in KINDS for seed in seeds]
    assert sum(map(bool, found)) <= 0.05 * len(found), found


@pytest.mark.parametrize("noise", [0.0, 0.03])
def test_lights_count_that_are_seen_beside_the_noise(noise: float) -> None:
    rng = np.random.default_rng(1)
    basis = np.concatenate([rng.normal(0, 1, (2, 500, 3)), np.zeros((1, 500, 3))])
    for third, seen in ((0.8, 2), (2.5, 3)):  # of the noise of a sample
        basis[2] = third * max(noise, 1e-6) * rng.normal(0, 1, (500, 3))
        images = basis[[0, 1, 2, 0, 1, 0]] * np.array([1, 1, 1, 0.5, 2, 1])[:, None, None]
        images = images + rng.normal(0, noise, images.shape)
        shown = Shown.by(images * np.array([1, 1, 0]), noise**2, None, 5.0)
        assert shown.lights == (seen, seen, 0)
        assert shown.unknowns == 4
