"""Pictures that somebody already made, and choosing a generator."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from pbrfit._core import InputError
from pbrfit.acquire.generators import create, requests_from
from pbrfit.acquire.generators.folder import Folder
from pbrfit.acquire.photo import Photo, read_photo
from pbrfit.acquire.prompts import Catalogue, Prompt
from pbrfit.io import images

CATALOGUE = Catalogue("Relight.", (Prompt("left", "From the left."), Prompt("dusk", "Dusk.")), "no")


def noise(*shape: int, seed: int = 0) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


@pytest.fixture
def photo(tmp_path: Path) -> Photo:
    Image.fromarray(noise(97, 131, 3)).save(tmp_path / "photo.png")
    return read_photo(tmp_path / "photo.png")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "made").mkdir()
    return tmp_path / "made"


def test_pictures_come_in_the_order_of_their_names(photo: Photo, folder: Path) -> None:
    for seed, name in enumerate(("b.png", "a.tif", "c.png")):
        Image.fromarray(noise(97, 131, 3, seed=seed)).save(folder / name)
    (folder / "notes.txt").write_text("not a picture")
    generator = create(f"folder:{folder}")
    assert not generator.retries
    requests = generator.plan(CATALOGUE, 16, 7)
    assert [request.name for request in requests] == ["a", "b", "c"]
    assert [request.seed for request in requests] == [7, 8, 9]
    assert [request.name for request in generator.plan(CATALOGUE, 2, 7)] == ["a", "b"]
    for request, seed in zip(requests, (1, 0, 2), strict=True):
        made = generator.generate(photo, request)
        np.testing.assert_array_equal(made.pixels, noise(97, 131, 3, seed=seed))
    assert made.record["file"] == "c.png"
    json.dumps([made.record, generator.settings()])


def test_a_larger_picture_of_the_same_shape_is_scaled_to_the_photo(
    photo: Photo, folder: Path
) -> None:
    Image.fromarray(noise(97, 131, 3).repeat(3, axis=0).repeat(3, axis=1)).save(folder / "x.png")
    generator = Folder(folder)
    made = generator.generate(photo, generator.plan(CATALOGUE, 1, 0)[0])
    np.testing.assert_array_equal(made.pixels, photo.srgb8())


def test_shapes_may_differ_by_one_percent(photo: Photo, folder: Path) -> None:
    for name, size in (("fits", (96, 130)), ("other", (96, 131))):
        Image.fromarray(noise(*size, 3)).save(folder / f"{name}.png")
    generator = Folder(folder)
    fits, other = generator.plan(CATALOGUE, 2, 0)
    assert generator.generate(photo, fits).pixels.shape == (97, 131, 3)
    expected = "other.png: expected the shape of photo.png, 131 × 97 pixels, found 131 × 96"
    with pytest.raises(InputError, match=expected):
        generator.generate(photo, other)


def test_float_pictures_are_taken_at_an_exposure_of_their_own(photo: Photo, folder: Path) -> None:
    light = np.random.default_rng(0).uniform(0.01, 1, (97, 131)).astype(np.float32)
    for name, scale in (("dim", 1e-3), ("bright", 300.0)):
        images.write_exr(folder / f"{name}.exr", dict.fromkeys("RGB", scale * light))
    generator = Folder(folder)
    made = [generator.generate(photo, request) for request in generator.plan(CATALOGUE, 2, 0)]
    assert np.abs(made[0].pixels.astype(int) - made[1].pixels).max() <= 1
    assert 0.005 <= np.mean(made[0].pixels == 255) <= 0.015


def test_a_folder_that_cannot_serve_is_refused(folder: Path) -> None:
    with pytest.raises(InputError, match=r"made: expected pictures .*, found none"):
        Folder(folder)
    with pytest.raises(InputError, match="nowhere: expected a folder of pictures, found none"):
        Folder(folder / "nowhere")
    Image.fromarray(noise(97, 131, 3)).save(folder / "x.png")
    Image.fromarray(noise(97, 131, 3)).save(folder / "x.tif")
    with pytest.raises(InputError, match=r"x.tif: expected one picture of that name, found x.png"):
        Folder(folder)


def test_a_generator_or_count_that_there_is_none_of_is_refused() -> None:
    for choice in ("flux", "folder", "folder:", "flux2-klein:x", "gpt-image-2:x", ""):
        with pytest.raises(InputError, match="generator: expected one of flux2-klein, gpt-image-2"):
            create(choice)
    for count in (0, 1001):
        with pytest.raises(InputError, match=f"count: expected 1 to 1000, found {count}"):
            requests_from(CATALOGUE, count, 0)


def test_requests_go_around_the_catalogue_with_seeds_of_their_own() -> None:
    requests = requests_from(CATALOGUE, 5, 40)
    assert [request.name for request in requests] == ["left", "dusk", "left_2", "dusk_2", "left_3"]
    assert [request.seed for request in requests] == [40, 41, 42, 43, 44]
    assert requests[2].prompt == requests[0].prompt == "Relight. From the left."
    assert requests[0].negative == "no"
    lighting = (Prompt("left", "a"), Prompt("left_2", "b"))
    names = [request.name for request in requests_from(Catalogue("", lighting, ""), 4, 0)]
    assert len(set(names)) == 4
