"""FLUX.2 Klein end to end, with random weights: what goes in, what comes out, what is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from pbrfit._core import InputError
from pbrfit.acquire.generators import Generated, Request
from pbrfit.acquire.generators.flux2_klein import MODEL, Flux2Klein
from pbrfit.acquire.photo import Photo, read_photo
from pbrfit.acquire.prompts import Catalogue, Prompt

LEFT = Request("left", "Blue light from the left.", "moved objects", 3)


def smooth_noise(height: int, width: int) -> NDArray[np.uint8]:
    small = np.random.default_rng(0).integers(0, 256, (-(-height // 8), -(-width // 8), 3))
    codes = Image.fromarray(small.astype(np.uint8))
    return np.asarray(codes.resize((width, height), Image.Resampling.BICUBIC))


@pytest.fixture
def photo(tmp_path: Path) -> Photo:
    return photo_of(97, 131, tmp_path)


def photo_of(height: int, width: int, folder: Path, max_size: int | None = None) -> Photo:
    Image.fromarray(smooth_noise(height, width)).save(folder / "photo.png")
    return read_photo(folder / "photo.png", max_size=max_size)


@pytest.fixture(scope="module")
def klein(tiny_flux2_klein: Path) -> Flux2Klein:
    return Flux2Klein(model=str(tiny_flux2_klein), steps=2, device="cpu")


@pytest.fixture
def echo(tiny_flux2_klein: Path, monkeypatch: pytest.MonkeyPatch) -> Flux2Klein:
    """A network that paints what it was shown: the decoder gives back what the encoder got."""
    generator = Flux2Klein(model=str(tiny_flux2_klein), steps=1, guidance=1, device="cpu")
    autoencoder = generator._loaded.network.vae
    encode = autoencoder.encode
    shown: list[Any] = []

    def keep(image: Any) -> Any:
        shown[:] = [image]
        return encode(image)

    monkeypatch.setattr(autoencoder, "encode", keep)
    monkeypatch.setattr(autoencoder, "decode", lambda *_, **__: (shown[0],))
    return generator


@pytest.mark.parametrize("size", [(97, 131), (131, 97), (64, 64), (65, 200)])
def test_what_the_network_is_shown_comes_back_bit_for_bit(
    size: tuple[int, int], echo: Flux2Klein, tmp_path: Path
) -> None:
    photo = photo_of(*size, tmp_path)
    made = echo.generate(photo, Request("same", "The same.", "", 0))
    np.testing.assert_array_equal(made.pixels, photo.srgb8())


def test_seed_prompt_negative_and_photo_decide_about_the_picture(
    klein: Flux2Klein, photo: Photo, tmp_path: Path
) -> None:
    first, again = klein.generate(photo, LEFT), klein.generate(photo, LEFT)
    np.testing.assert_array_equal(first.pixels, again.pixels)
    assert first.pixels.std() > 5  # random weights paint noise, not nothing
    others: dict[str, Generated] = {
        "seed": klein.generate(photo, Request("left", LEFT.prompt, LEFT.negative, 4)),
        "prompt": klein.generate(photo, Request("left", "Red light.", LEFT.negative, 3)),
        "negative": klein.generate(photo, Request("left", LEFT.prompt, "", 3)),
    }
    Image.new("RGB", (131, 97)).save(tmp_path / "black.png")
    others["photo"] = klein.generate(read_photo(tmp_path / "black.png"), LEFT)
    for what, other in others.items():
        assert (first.pixels != other.pixels).mean() > 0.05, what


def test_the_record_says_how_a_picture_was_made(
    klein: Flux2Klein, photo: Photo, tiny_flux2_klein: Path
) -> None:
    record = klein.generate(photo, LEFT).record
    assert json.loads(json.dumps(record)) == record
    expected = {
        "generator": "flux2-klein",
        "model": str(tiny_flux2_klein),
        "source": "folder",
        "revision": None,
        "device": "cpu",
        "dtype": "float32",
        "guidance": 5.0,
        "steps": 2,
        "seed": 3,
        "prompt": LEFT.prompt,
        "negative": LEFT.negative,
        "network_size": [112, 144],
    }
    assert {key: record[key] for key in expected} == expected
    assert set(record["versions"]) == {"torch", "diffusers", "transformers"}
    assert record["seconds"] > 0
    json.dumps(klein.settings())


def test_a_prompt_that_would_be_cut_off_is_refused(klein: Flux2Klein, photo: Photo) -> None:
    request = Request("long", "light " * 600, "", 0)
    with pytest.raises(InputError, match="prompt long: expected at most 512 tokens"):
        klein.generate(photo, request)


@pytest.mark.parametrize("guidance", [5.0, 1.01])
def test_a_distilled_checkpoint_with_guidance_is_refused(
    guidance: float, tiny_distilled_flux2_klein: Path, photo: Photo
) -> None:
    generator = Flux2Klein(model=str(tiny_distilled_flux2_klein), guidance=guidance, device="cpu")
    expected = f"expected a base checkpoint for guidance {guidance:g}, found a distilled one"
    with pytest.raises(InputError, match=expected) as caught:
        generator.generate(photo, Request("left", "Light.", "", 0))
    assert MODEL in str(caught.value)


def test_negatives_without_guidance_are_refused(photo: Photo) -> None:
    generator = Flux2Klein(model="nowhere/nothing", guidance=1)
    catalogue = Catalogue("", (Prompt("left", "Light."),), "fog")
    expected = "negative prompts: expected guidance above 1"
    with pytest.raises(InputError, match=expected):
        generator.plan(catalogue, 1, 0)
    with pytest.raises(InputError, match=expected):
        generator.generate(photo, Request("left", "Light.", "fog", 0))


def test_another_pipeline_is_refused_before_its_weights_are_read(
    tiny_flux2_klein: Path, photo: Photo, tmp_path: Path
) -> None:
    other = tmp_path / "other"
    other.mkdir()
    index = json.loads((tiny_flux2_klein / "model_index.json").read_text())
    index["_class_name"] = "StableDiffusionPipeline"
    (other / "model_index.json").write_text(json.dumps(index))
    with pytest.raises(InputError, match="expected a Flux2KleinPipeline, found a StableDiffusion"):
        Flux2Klein(model=str(other), device="cpu").generate(photo, LEFT)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"steps": 0}, "steps: expected at least 1, found 0"),
        ({"guidance": float("nan")}, "guidance: expected a number of 0 or more, found nan"),
        ({"guidance": -1.0}, "guidance: expected a number of 0 or more, found -1"),
    ],
)
def test_options_out_of_range_are_refused(options: dict[str, Any], expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        Flux2Klein(**options)
