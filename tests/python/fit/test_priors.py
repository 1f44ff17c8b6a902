"""Penalties against slow references and differences, at every kind of layout."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Any

import numpy as np
import pytest

import pbrfit
import scene_kinds
from pbrfit import InputError
from pbrfit.fit.objective import Objective
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.fit.priors.penalties import penalties, tied_neighbours
from pbrfit.result.options import Priors, prior_names
from pbrfit.scene.arrays import consecutive_labels
from pbrfit.synthetic import make_scene
from pbrfit.values.arrays import Array
from scene_files import known, lights_of, truth_of

ALL = Priors(material=1.0, cohesion=0.7, smoothness=0.3, sparsity=0.2, monochrome=0.5)


def layout(valid: Any, segments: Any = None, **changes: Any) -> ParameterLayout:
    """Of `valid` (H, W) and ids (H, W), with two pictures and four coefficients."""
    valid = np.asarray(valid, bool)
    labels, count = None, 0
    if segments is not None:
        labels, count = consecutive_labels(np.asarray(segments)[valid])
    made = ParameterLayout(
        valid=valid,
        segments=labels,
        segment_count=count,
        pictures=2,
        channels=3,
        coefficients=4,
        light_channels=3,
        metallic_known=False,
        lighting_known=False,
    )
    return dataclasses.replace(made, **changes)


RNG = np.random.default_rng(0)
MASK = RNG.random((5, 7)) < 0.7
IDS = RNG.integers(0, 4, (5, 7))  # 0 is unclassified
APART = 1 + np.arange(35).reshape(5, 7)  # each pixel a segment of its own

LAYOUTS = {
    "all": layout(np.ones((5, 7)), IDS),
    "masked": layout(MASK, IDS),
    "no segments": layout(MASK),
    "no unclassified": layout(MASK, IDS + 1),
    "single-pixel segments": layout(MASK, APART),
    "all unclassified": layout(MASK, 0 * IDS),
    "a segment of masked pixels": layout(MASK, np.where(MASK, IDS, 9)),
    "any ids": layout(MASK, np.array([0, -5, 2**40, 70_000])[IDS]),
    "1 × 1": layout([[1]], [[3]]),
    "1 × N": layout(np.ones((1, 6)), [[1, 1, 0, 2, 2, 1]]),
    "N × 1": layout([[1], [1], [0], [1]], [[1], [1], [1], [2]]),
    "nothing adjoins": layout([[1, 0, 1], [0, 1, 0]], [[1, 1, 1], [1, 1, 1]]),
    "grey": layout(MASK, IDS, channels=1, light_channels=1),
    "one light for all channels": layout(MASK, IDS, light_channels=1),
    "known metallic": layout(MASK, IDS, metallic_known=True),
    "known lights": layout(MASK, IDS, lighting_known=True),
}
every_layout = pytest.mark.parametrize("name", LAYOUTS)


def random_x(of: ParameterLayout, seed: int = 0) -> Array:
    return np.random.default_rng(seed).random(of.size)


def slow_values(of: ParameterLayout, x: Array) -> dict[str, float]:
    """Each prior at weight 1, pixel by pixel from its definition."""
    pixels = [(int(i), int(j)) for i, j in np.argwhere(of.valid)]
    labels = [0] * len(pixels) if of.segments is None else [int(label) for label in of.segments]
    maps = [x[block].tolist() for block in (of.roughness, of.metallic) if block is not None]

    def mean(label: int, values: list[float]) -> float:
        members = [v for v, found in zip(values, labels, strict=True) if found == label]
        return math.fsum(members) / len(members)

    found = dict.fromkeys(("cohesion", "smoothness", "sparsity", "monochrome"), 0.0)
    for values in maps:
        for a, (pixel, label) in enumerate(zip(pixels, labels, strict=True)):
            if label:
                found["cohesion"] += (values[a] - mean(label, values)) ** 2 / len(pixels)
            for b in range(a):
                distance = abs(pixel[0] - pixels[b][0]) + abs(pixel[1] - pixels[b][1])
                tied = labels[b] == label or 0 in (labels[b], label)
                if distance == 1 and tied:
                    found["smoothness"] += (values[a] - values[b]) ** 2 * 1e-4
    if of.metallic is not None:
        found["sparsity"] = sum(abs(m) for m in x[of.metallic]) / len(pixels)
    if of.lighting is not None:
        lights = x[of.lighting].reshape(of.pictures, of.coefficients, of.light_channels)
        for light in itertools.chain.from_iterable(lights.tolist()):
            grey = sum(light) / len(light)
            found["monochrome"] += sum((value - grey) ** 2 for value in light) / lights.size
    return found


@every_layout
def test_values_are_those_of_the_definition(name: str) -> None:
    of = LAYOUTS[name]
    x = random_x(of)
    found = {p.name: p.value_and_grad(x, np.zeros(of.size)) for p in penalties(of, ALL)}
    for prior, value in slow_values(of, x).items():
        expected = getattr(ALL, prior) * value
        assert found.get(prior, 0.0) == pytest.approx(expected, rel=1e-13, abs=1e-15), prior


@every_layout
def test_gradients_agree_with_differences(name: str) -> None:
    """All are polynomials of degree 2 or less: a central difference has no truncation error.

    A gradient is added to what is there, and x is left alone.
    """
    of = LAYOUTS[name]
    x, there = random_x(of), random_x(of, 1)
    before = x.copy()
    for penalty in penalties(of, ALL):
        gradient = there.copy()
        penalty.value_and_grad(x, gradient)
        gradient -= there
        for index in range(of.size):
            step = np.zeros(of.size)
            step[index] = 0.5
            above, below = (
                penalty.value_and_grad(x + sign * step, np.zeros(of.size)) for sign in (1, -1)
            )
            assert gradient[index] == pytest.approx(above - below, rel=1e-10, abs=1e-13), index
    np.testing.assert_array_equal(x, before)


def test_long_runs_are_cut_and_overlap() -> None:
    """Runs of pairs are handled by 512: one row of 1500 has three, and each overlaps itself."""
    for shape in ((1, 1500), (1500, 1), (40, 40)):
        of = layout(np.ones(shape))
        x = random_x(of)
        gradient, expected = np.zeros(of.size), np.zeros(of.size)
        (penalty,) = penalties(of, dataclasses.replace(Priors.none(), smoothness=1.0))
        value = penalty.value_and_grad(x, gradient)
        total = 0.0
        for block in (of.roughness, of.metallic):
            assert block is not None
            first, second = tied_neighbours(of)
            changes = x[block][second] - x[block][first]
            total += 1e-4 * float(np.square(changes).sum())
            np.add.at(expected[block], second, 2e-4 * changes)
            np.add.at(expected[block], first, -2e-4 * changes)
        assert value == pytest.approx(total, rel=1e-12)
        np.testing.assert_allclose(gradient, expected, rtol=1e-12, atol=1e-17)


# --- Weights mean the same for every scene ---


def smooth_maps(size: int) -> tuple[ParameterLayout, Array]:
    """The same two waves in two segments, at any resolution; a third of the picture is masked."""
    y, x = (np.mgrid[:size, :size] + 0.5) / size
    of = layout(x > 1 / 3, np.where(y > 0.5, 1, 2))
    values = np.zeros(of.size)
    wave = 0.5 + 0.3 * np.sin(3 * x + 2 * y)
    values[of.roughness] = wave[of.valid]
    values[known(of.metallic)] = wave[of.valid] ** 2
    return of, values


@pytest.mark.parametrize("prior", ["cohesion", "smoothness", "sparsity"])
def test_resolution_does_not_change_a_prior(prior: str) -> None:
    found = []
    for size in (48, 192):
        of, x = smooth_maps(size)
        (penalty,) = penalties(of, dataclasses.replace(Priors.none(), **{prior: 1.0}))
        found.append(penalty.value_and_grad(x, np.zeros(of.size)))
    assert found[0] > 0
    assert found[0] == pytest.approx(found[1], rel=0.03)


def test_smoothness_is_the_change_over_a_hundredth_of_the_side() -> None:
    """A ramp of one over a square: over a hundredth of the side it changes by 0.01."""
    size = 200
    of = layout(np.ones((size, size)))
    x = np.zeros(of.size)
    x[of.roughness] = np.tile(np.arange(size) / size, size)
    (penalty,) = penalties(of, dataclasses.replace(Priors.none(), smoothness=1.0))
    assert penalty.value_and_grad(x, np.zeros(of.size)) == pytest.approx(1e-4, rel=0.01)


def test_exposure_and_number_of_pictures_do_not_change_monochrome() -> None:
    made = scene_of()
    maps, lights = truth_of(made).materials, lights_of(made)
    scene = dataclasses.replace(made, truth=None)
    brighter = dataclasses.replace(scene, images=7 * scene.images)
    twice = dataclasses.replace(scene, images=np.concatenate([scene.images] * 2), names=())
    cases = [(scene, lights), (brighter, 7 * lights), (twice, np.concatenate([lights] * 2))]
    found = []
    for case, lighting in cases:
        objective = Objective(case, priors=dataclasses.replace(Priors.none(), monochrome=1.0))
        x = objective.pack(maps.albedo, maps.roughness, maps.metallic, lighting)
        found.append(objective.add_penalties(x, np.zeros(objective.size)))
    assert found[0] > 0
    assert found[1:] == pytest.approx(found[:1] * 2, rel=1e-6)


@pytest.mark.parametrize(
    "ids",
    [
        [0, -3, 7, 7, -3],
        np.array([0, 2**63, 2**64 - 1, 2**64 - 1, 2**63], np.uint64),
        np.array([0, 200, 255, 255, 200], np.uint8),
        [0, 65_536, 10**12, 10**12, 65_536],
    ],
)
def test_any_whole_numbers_are_ids(ids: Any) -> None:
    labels, count = consecutive_labels(np.asarray(ids))
    assert (labels.tolist(), count) == ([0, 1, 2, 2, 1], 2)


def test_more_segments_than_16_bits_hold() -> None:
    size = 300
    ids = np.arange(size * size).reshape(size, size) // 2
    of = layout(np.ones((size, size)), ids)
    assert of.segment_count == 44_999
    of = layout(np.ones((size, size)), ids * 2 + 1)
    x = random_x(of)
    found = {p.name: p.value_and_grad(x, np.zeros(of.size)) for p in penalties(of, ALL)}
    r, m = (x[block].reshape(-1, 2) for block in (of.roughness, of.metallic) if block)
    pairs = sum(float(np.square(v[:, 0] - v[:, 1]).sum()) for v in (r, m))
    assert found["cohesion"] == pytest.approx(0.7 * pairs / 2 / size**2)
    assert found["smoothness"] == pytest.approx(0.3 * pairs * 1e-4)


@pytest.mark.parametrize("name", prior_names())
@pytest.mark.parametrize("weight", [-1e-9, np.nan, np.inf, "1", "auto", True, [1.0], 1j])
def test_unusable_weights_are_named(name: str, weight: Any) -> None:
    with pytest.raises(InputError, match=f"^prior {name}: expected a finite weight"):
        Priors(**{name: weight})


def test_weights_are_plain_numbers() -> None:
    priors = Priors(cohesion=np.float32(0.5), material=2, monochrome=0)  # type: ignore[arg-type]
    assert dataclasses.astuple(priors) == (2.0, 0.5, 0.0, 0.0, 0.0)
    assert all(type(weight) is float for weight in dataclasses.astuple(priors))
    with pytest.raises(InputError, match=r"^prior cohesion: expected .* found None"):
        Priors(cohesion=None)  # type: ignore[arg-type]
    assert set(dataclasses.astuple(Priors.none())) == {0.0}
    assert Priors().monochrome is None
    assert Priors().material is None


def scene_of(**options: Any) -> pbrfit.Scene:
    return make_scene("room", size=12, lights=3, held_out=1, **options)


def test_the_loss_is_data_and_penalties() -> None:
    objective = Objective(scene_of(), priors=ALL)
    without = Objective(scene_of())
    x = objective.start()
    np.testing.assert_array_equal(x, without.start())
    data, by_data = without.value_and_grad(x)
    gradient = np.zeros(objective.size)
    values = [penalty.value_and_grad(x, gradient) for penalty in objective.penalties]
    assert len(values) == 4
    loss, by_loss = objective.value_and_grad(x)
    assert loss == pytest.approx(data + sum(values), rel=1e-14)
    np.testing.assert_allclose(by_loss, by_data + gradient, rtol=1e-14, atol=1e-18)
    assert objective.data_value_and_grad(x)[0] == data


def test_known_lights_in_colour_are_refused_by_mono_light() -> None:
    known = scene_kinds.known_lights(scene_of())
    with pytest.raises(InputError, match=r"^lighting: expected known lights with equal channels"):
        Objective(known, mono_light=True)
    assert known.lighting is not None
    grey = np.repeat(known.lighting[..., :1], 3, axis=-1)
    known = dataclasses.replace(known, lighting=grey)
    objective, plain = Objective(known, mono_light=True), Objective(known)
    x = objective.start()
    assert objective.value_and_grad(x)[0] == plain.value_and_grad(x)[0]
    np.testing.assert_array_equal(objective.value_and_grad(x)[1], plain.value_and_grad(x)[1])
