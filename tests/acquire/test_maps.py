"""Normals by Marigold and segments by SAM2, end to end with tiny networks."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from acquire.tiny_maps import picture, save_tiny_marigold_normals, save_tiny_sam2
from pbrfit.acquire.marigold import seen_size
from pbrfit.acquire.normals import HALF_WEIGHT, estimate
from pbrfit.acquire.padding import resized
from pbrfit.acquire.segments import segment
from pbrfit.cli import main
from pbrfit.io import images
from pbrfit.io.normal_files import UNCERTAINTY
from pbrfit.scene.scene import Scene

SIZES = [(97, 131), (131, 97), (64, 64)]


@pytest.fixture(scope="module")
def marigold(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(save_tiny_marigold_normals(tmp_path_factory.mktemp("marigold")))


@pytest.fixture(scope="module")
def sam2(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(save_tiny_sam2(tmp_path_factory.mktemp("sam2")))


def folder_of_photographs(folder: Path, height: int = 97, width: int = 131) -> Path:
    (folder / "images").mkdir(parents=True)
    for i in range(3):
        images.write_png(folder / "images" / f"{i}.png", picture(height, width, i), tag="srgb")
    return folder


@pytest.mark.parametrize("size", SIZES)
def test_normals_of_any_size_with_their_uncertainty(marigold: str, size: tuple[int, int]) -> None:
    found = estimate("marigold", picture(*size), fov=60, model=marigold, ensemble=3, device="cpu")
    assert found.normals.shape == (*size, 3)
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=-1), 1, atol=1e-6)
    assert found.uncertainty is not None
    assert found.uncertainty.shape == size
    assert 0 < found.uncertainty.mean() < 180
    assert found.weights is not None
    np.testing.assert_allclose(
        found.weights, 1 / (1 + (found.uncertainty / HALF_WEIGHT) ** 2), rtol=1e-5
    )
    assert (found.record["source"], found.record["model"]) == ("marigold", marigold)
    assert found.record["ensemble"] == 3
    assert (found.record["steps"], found.record["resolution"]) == (2, 64)


def test_a_seed_gives_the_same_normals_and_another_gives_others(marigold: str) -> None:
    def found(seed: int, ensemble: int = 1) -> NDArray[np.float64]:
        options: dict[str, Any] = {"model": marigold, "device": "cpu", "ensemble": ensemble}
        return estimate("marigold", picture(64, 64), fov=60, seed=seed, **options).normals

    np.testing.assert_array_equal(found(3), found(3))
    assert np.abs(found(3) - found(4)).mean() > 0.01
    # The members of an ensemble are those of the seeds from its own on.
    total = found(3) + found(4) + found(5)
    total /= np.linalg.norm(total, axis=-1, keepdims=True)
    np.testing.assert_allclose(found(3, ensemble=3), total, atol=1e-6)


@pytest.mark.parametrize("size", [(97, 131), (131, 97), (300, 75)])
@pytest.mark.parametrize("resolution", [0, 64, 768])
def test_pixels_stay_where_they_are(size: tuple[int, int], resolution: int) -> None:
    # The way to the network and back with a network between that answers what it sees: ramps must
    # come back where they were, to a hundredth of a pixel of the picture or of what it sees.
    import torch
    from diffusers.pipelines.marigold.marigold_image_processing import MarigoldImageProcessor

    height, width = size
    y, x = np.mgrid[:height, :width]
    ramps = np.stack([(x + 0.5) / width, (y + 0.5) / height, 0 * x + 0.5], axis=-1)
    seen = resized(ramps, seen_size(size, resolution))
    processor = MarigoldImageProcessor(vae_scale_factor=8)
    padded, padding, _ = processor.preprocess(
        seen.transpose(2, 0, 1)[None].transpose(0, 2, 3, 1), 0, "bilinear", torch.device("cpu")
    )
    assert padded.shape[-1] % 8 == padded.shape[-2] % 8 == 0
    answer = (processor.pt_to_numpy(processor.unpad_image(padded, padding))[0] + 1) / 2
    back = resized(answer, size)
    pixel = max(1.0, max(size) / (resolution or max(size)))
    border = round(2 * pixel) + 1
    inner = slice(border, -border)
    for channel, side in ((0, width), (1, height)):
        off = (back - ramps)[inner, inner, channel] * side
        assert np.abs(off).max() < 0.02 * pixel


def test_the_command_completes_a_folder_of_photographs(
    marigold: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = folder_of_photographs(tmp_path / "scene")
    shared = ("--model", marigold, "--device", "cpu", "--ensemble", "3")
    assert main(["normals", str(folder), *shared]) == 0
    said = capsys.readouterr().out
    assert "shown the mean of 3 pictures" in said
    assert re.search(r"uncertain by \d+\.\d degrees \(median\)", said)
    scene = Scene.load(folder, fov=60)
    channels = images.read_channels(folder / "normals.exr")
    stored = np.stack([channels[name] for name in "XYZ"], axis=-1)[scene.valid]
    np.testing.assert_allclose(scene.normals[scene.valid], stored, atol=1e-6)
    assert scene.weights is not None
    expected = 1 / (1 + (channels[UNCERTAINTY] / HALF_WEIGHT) ** 2)
    np.testing.assert_allclose(scene.weights[0, ..., 0], expected, rtol=1e-4)
    assert main(["normals", str(folder), *shared]) == 2
    assert "normals.exr: expected no normals yet" in capsys.readouterr().err
    assert main(["normals", str(folder), *shared, "--overwrite", "--picture", "1"]) == 0
    assert "shown picture 1" in capsys.readouterr().out
    assert main(["normals", str(folder), *shared, "--overwrite", "--picture", "7"]) == 2
    assert "picture: expected one of 0, 1, 2, found '7'" in capsys.readouterr().err


def test_no_mask_is_a_legal_answer(sam2: str) -> None:
    ids, record = segment(
        "sam2", picture(97, 131), model=sam2, points=4, device="cpu", pred_iou_thresh=2.0
    )
    assert not ids.any()
    assert (record["masks"], record["segments"]) == (0, 0)


def test_checkpoints_made_for_video_are_read_as_those_for_pictures(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    # So are all that Meta gives out: facebook/sam2.1-hiera-large says sam2_video.
    folder = save_tiny_sam2(tmp_path)
    for name, changes in {
        "config.json": {"model_type": "sam2_video", "architectures": ["Sam2VideoModel"]},
        "preprocessor_config.json": {"image_processor_type": "Sam2ImageProcessorFast"},
    }.items():
        content = json.loads((folder / name).read_text())
        (folder / name).write_text(json.dumps(content | changes))
    capfd.readouterr()
    ids, _ = segment("sam2", picture(97, 131), model=str(folder), points=4, device="cpu")
    assert ids.shape == (97, 131)
    assert "sam2_video" not in capfd.readouterr().err


def test_the_command_gives_segments_to_photographs(
    sam2: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = folder_of_photographs(tmp_path / "scene")
    arguments = ["segments", str(folder), "--model", sam2, "--points", "4", "--device", "cpu"]
    assert main(arguments) == 0
    assert re.search(r"segments.png: \d+ segments?, \d+ % of", capsys.readouterr().out)
    assert images.read_ids(folder / "segments.png").shape == (97, 131)
