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


def test_the_picture_is_exposed_for_a_screen() -> None:
    dark = dataclasses.replace(room(), images=np.float32(1e-3) * room().images)
    for picture in range(3):
        shown = measure.shown_picture(dark, picture)
        np.testing.assert_array_equal(shown, measure.shown_picture(room(), picture))
        image = room().images[picture]
        white = np.percentile(image, 98)
        assert (shown[image >= white] == 255).all()
        assert (shown[image < 0.98 * white] < 255).all()


def task(seed: int) -> measure.Task:
    return measure.Task("own", "pbrfit", seed, 24, lights=8)


def test_every_method_is_given_the_same_noisy_scene() -> None:
    one, two, other = (measure.given(task(seed)) for seed in (6000, 6000, 6001))
    np.testing.assert_array_equal(one.images, two.images)
    np.testing.assert_array_equal(one.normals, two.normals)
    assert np.abs(one.normals - other.normals).max() > 0.1
