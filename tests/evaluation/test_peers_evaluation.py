"""The suite of peers that see one picture, where none of them can run."""

from __future__ import annotations

import dataclasses

import numpy as np

from pbrfit_evaluation.peers import measure
from scene_files import room


def test_peers_are_shown_the_most_evenly_lit_picture() -> None:
    images = np.array(room().images, dtype=np.float64)
    images[0, : len(images[0]) // 2] *= 0.01  # half in the dark
    images[2] = 0.3 + 0.1 * images[2]
    assert measure.evenly_lit(dataclasses.replace(room(), images=images)) == 2


def task(seed: int) -> measure.Task:
    return measure.Task("own", "pbrfit", seed, 24, lights=8)


def test_every_method_is_given_the_same_noisy_scene() -> None:
    one, two, other = (measure.given(task(seed)) for seed in (6000, 6000, 6001))
    np.testing.assert_array_equal(one.images, two.images)
    np.testing.assert_array_equal(one.normals, two.normals)
    assert np.abs(one.normals - other.normals).max() > 0.1
