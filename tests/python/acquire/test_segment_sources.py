"""Segments from masks that overlap, and from files."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from command_runs import done, refused
from pbrfit._core import InputError
from pbrfit.acquire.segments import ids_of, segment
from pbrfit.io import images
from pbrfit.scene.scene import Scene
from scene_files import SIZE

ALL = (20, 30)


def box(top: int, left: int, height: int, width: int) -> NDArray[np.bool_]:
    mask = np.zeros(ALL, dtype=bool)
    mask[top : top + height, left : left + width] = True
    return mask


def test_smaller_masks_lie_on_top_whatever_their_order() -> None:
    table, plate, cup = box(2, 2, 16, 26), box(5, 5, 10, 10), box(8, 8, 3, 3)
    expected = np.zeros(ALL, np.uint16)
    for i, mask in enumerate((table, plate, cup)):
        expected[mask] = i + 1
    for order in itertools.permutations((table, plate, cup)):
        np.testing.assert_array_equal(ids_of(order, ALL), expected)


def test_small_masks_and_those_that_are_covered_are_dropped() -> None:
    large, small = box(0, 0, 10, 10), box(15, 20, 2, 2)
    assert ids_of([large, small], ALL, smallest=5 / 600).max() == 1
    assert ids_of([large, small], ALL, smallest=4 / 600).max() == 2
    # Two boxes of 90 pixels hide one of 100 together: it goes, and no id is left out.
    hidden = box(0, 0, 10, 10)
    ids = ids_of([hidden, box(0, 0, 9, 10), box(1, 0, 9, 10)], ALL, smallest=10 / 600)
    assert sorted(np.unique(ids)) == [0, 1, 2]


def test_no_mask_leaves_everything_unclassified() -> None:
    assert not ids_of([], ALL).any()
    assert ids_of([], ALL).dtype == np.uint16
    assert not ids_of([np.zeros(ALL, bool)], ALL, smallest=0).any()
    with pytest.raises(InputError, match="smallest: expected a share"):
        ids_of([], ALL, smallest=2)


def test_ids_of_a_file_are_taken_at_centres(tmp_path: Path) -> None:
    ids = np.arange(SIZE * SIZE, dtype=np.uint16).reshape(SIZE, SIZE)
    path = tmp_path / "ids.png"
    images.write_png(path, np.repeat(np.repeat(ids, 3, 0), 3, 1), tag=None)
    found, record = segment(str(path), np.zeros((SIZE, SIZE, 3), np.uint8))
    np.testing.assert_array_equal(found, ids)
    assert record == {"source": "file", "file": "ids.png", "segments": SIZE * SIZE - 1}
    with pytest.raises(InputError, match=r"ids\.png: expected the pictures' size, 10 × 5 pixels"):
        segment(str(path), np.zeros((5, 10, 3), np.uint8))


def test_the_command_puts_them_beside_the_pictures(folder: Path, tmp_path: Path) -> None:
    ids = np.zeros((SIZE, SIZE), np.uint16)
    ids[:4] = 500
    images.write_png(tmp_path / "ids.png", ids, tag=None)
    command = ("segments", folder, "--from", tmp_path / "ids.png")
    assert "segments.png: 1 segment, 25 % of the picture" in done(*command)
    np.testing.assert_array_equal(Scene.load(folder).segments, ids)
    assert "segments.png: expected no segments yet" in refused(*command)
    done(*command, "--overwrite")
    said = refused(*command, "--overwrite", "--points", 3)
    assert "--points: has no meaning with --from" in said
