"""What reads users' files, and what a valid answer is.

A reader is called with a folder and the damaged file in it. What comes back it checks by `assert`.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuzz import crafted, damage, declared, seeds
from fuzz.seeds import Seed
from fuzz.task import TASK, work
from pbrfit.acquire import journal
from pbrfit.acquire import normals as normals_of
from pbrfit.acquire.generators import Request
from pbrfit.acquire.photo import Photo, read_photo
from pbrfit.acquire.prompts import read_prompts
from pbrfit.io import images, lamp_files
from pbrfit.io.normal_files import Convention, read_normals
from pbrfit.io.weight_files import read_weights
from pbrfit.model import panorama
from pbrfit.model.lighting import Lighting
from pbrfit.model.materials import read_materials
from pbrfit.result.history import History
from pbrfit.result.result import Result
from pbrfit.scene import folder as scene_folder
from pbrfit.scene.scene import Scene
from pbrfit_evaluation import jobs


@dataclass(frozen=True)
class Reader:
    """One way to read a file: `read` is called with a folder and the damaged file in it.

    `share` is that of all cases, in relation to the others. Crafted files, made to deceive, take
    the place of the first target with `crafted_suffix`, or else of the first one.
    """

    name: str
    share: int
    seeds: Callable[[], Iterator[Seed]]
    read: Callable[[Path, Path], None]
    crafted: Callable[[], Iterator[tuple[str, bytes]]] = lambda: iter(())
    crafted_suffix: str = ""
    per_pixel: int = declared.PER_PIXEL


def damage_of(seed: Seed) -> damage.Damage:
    """How the target of a seed is damaged, by its suffix."""
    return _DAMAGE[Path(seed.target).suffix]


_DAMAGE: dict[str, damage.Damage] = {
    ".png": damage.png,
    ".jpg": damage.jpeg,
    ".tif": damage.tiff,
    ".hdr": damage.hdr,
    ".exr": damage.exr,
    ".npy": damage.npy,
    ".json": damage.json_text,
    ".toml": damage.text,
    ".csv": damage.text,
    ".lp": damage.text,
    ".txt": damage.text,
}


def _picture(_folder: Path, file: Path) -> None:
    content = file.read_bytes()
    _as_picture(file)
    # Which one is decided by the file, so that a case is the same again when it is replayed.
    others = (_as_data, _as_ids, _as_channels, _as_panorama, _as_photo)
    others[sum(content[-64:]) % len(others)](file)


def _as_picture(file: Path) -> None:
    picture = images.read_picture(file)
    _check_pixels(picture.pixels)
    shape = picture.pixels.shape[:2]
    assert picture.negative.shape == shape
    if picture.limits is not None:
        assert picture.limits.shape == picture.pixels.shape
        assert picture.limits.max() <= 2
    if picture.alpha is not None:
        assert picture.alpha.shape == shape
    if picture.stored is not None:
        assert np.isfinite(picture.pixels).all(), "integers gave what is not finite"
    if picture.taken.focal_length_35mm is not None:
        assert 0 < picture.taken.focal_length_35mm < math.inf
    _check_text(picture.color)


def _check_pixels(pixels: NDArray[Any]) -> None:
    assert pixels.ndim == 3
    assert pixels.shape[2] == 3
    assert pixels.size > 0
    assert pixels.dtype == np.float32


def _as_data(file: Path) -> None:
    data = images.read_data(file)
    assert data.ndim == 3
    assert 1 <= data.shape[2] <= 4
    assert data.dtype == np.float64


def _as_ids(file: Path) -> None:
    ids = images.read_ids(file)
    assert ids.ndim == 2
    assert ids.dtype == np.uint16


def _as_channels(file: Path) -> None:
    channels = images.read_channels(file)
    assert len({channel.shape for channel in channels.values()}) == 1
    assert all(channel.dtype == np.float32 for channel in channels.values())


def _as_panorama(file: Path) -> None:
    pixels = panorama.read(file)
    _check_pixels(pixels)
    assert pixels.shape[1] == 2 * pixels.shape[0]
    assert np.isfinite(pixels).all()
    if pixels.size < 1 << 20:
        assert np.isfinite(panorama.project(pixels)).all()


def _as_photo(file: Path) -> None:
    photo = read_photo(file)
    assert np.isfinite(photo.pixels).all()
    assert math.isfinite(photo.exposure)
    assert photo.fov is None or 0 < photo.fov < 180


def _map(_folder: Path, file: Path) -> None:
    """Normals, depth and weights as files."""
    if file.stem == "depth":
        normals, _ = normals_of.of_depth(file, (16, 16), fov=50.0)
        assert normals.shape == (16, 16, 3)
        assert np.isfinite(normals).all()
        return
    found, known, _ = normals_of.from_normals(file, (16, 16), Convention())
    assert found.shape == (16, 16, 3)
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1), 1, atol=1e-6)
    assert known.dtype == bool
    if file.suffix != ".npy":
        assert read_normals(file).vectors.shape == (16, 16, 3)
    if file.suffix == ".exr":
        read_weights(file, ("a", "b"))


def _scene(folder: Path, file: Path) -> None:
    if file.name == "scene.toml":
        settings = scene_folder.read_settings(file)
        assert settings.fov is None or 0 <= settings.fov < 180
    scene = Scene.load(folder)
    assert scene.images.shape == (len(scene.names), 16, 16, 3)
    assert 0 <= scene.fov < 180
    for i in range(len(scene.names)):
        assert np.isfinite(scene.samples(i)).all()
    assert np.isfinite(scene.normals[scene.valid]).all()
    assert scene.lighting is None or np.isfinite(scene.lighting).all()
    assert scene.weights is None or np.isfinite(scene.weights).all()
    for words in scene.assumed.values():
        _check_text(words)


def _lamps(_folder: Path, file: Path) -> None:
    rows, said = lamp_files.read_lamps(file)
    _check_text(said)
    assert rows
    for row in rows:
        assert np.isfinite(row.place).all()
        assert row.near or math.isclose(math.hypot(*row.place), 1, abs_tol=1e-6)


def _result(folder: Path, file: Path) -> None:
    if file.name == "history.csv":
        _check_history(History.load(file))
    if file.name == "lighting.json":
        _check_lighting(Lighting.load(file))
    if file.name == "materials.exr":
        read_materials(file)
    result = Result.load(folder)
    _check_history(result.history)
    inside = result.mask
    assert inside.any()
    for plane in (result.albedo, result.roughness, result.metallic, result.normals):
        assert plane.shape[:2] == inside.shape
        assert np.isfinite(plane[inside]).all(), "a map that is not finite"
    assert result.lighting.shape == (len(result.pictures), 16, 3)
    assert 0 <= result.fov < 180
    assert math.isfinite(result.seconds)
    for name, value in result.metrics.items():
        _check_text(name)
        assert isinstance(value, (int, float))
        assert math.isfinite(value)
    for words in (result.stop_reason, *result.left_out, *result.assumed.values()):
        _check_text(words)
    for stage in result.stages:
        _check_text(stage.name)
        assert math.isfinite(stage.seconds)
    assert isinstance(result.options.iterations, int)
    assert all(isinstance(digest, str) for digest in result.inputs.values())
    if result.uncertainty is not None:
        for values in (result.uncertainty.deviation, result.uncertainty.low):
            assert np.isfinite(values.roughness[inside]).all()
        assert all(verdict.in_words() for verdict in result.uncertainty.verdicts.values())
        assert all(math.isfinite(scale) for scale in result.uncertainty.albedo_scale)
        json.dumps(result.uncertainty.summary(), allow_nan=False)
    assert isinstance(result.refinement.in_words(), str)


def _check_history(history: History) -> None:
    assert len(history) > 0
    for column in history.columns[:5]:
        assert np.isfinite(history[column]).all(), column


def _check_lighting(lighting: Lighting) -> None:
    assert lighting.coefficients.shape == (len(lighting.pictures), 16, 3)
    assert np.isfinite(lighting.coefficients).all()
    assert len(set(lighting.pictures)) == len(lighting.pictures)
    for name in lighting.pictures:
        _check_text(name)


def _check_text(value: object) -> None:
    """A text that any file and any terminal can take."""
    assert isinstance(value, str)
    value.encode("utf-8")


def _prompts(_folder: Path, file: Path) -> None:
    catalogue = read_prompts(file)
    assert catalogue.lighting
    for prompt in catalogue.lighting:
        assert "\n" not in catalogue.full(prompt)
        _check_text(catalogue.full(prompt))


def _journal(folder: Path, file: Path) -> None:
    photo = Photo(
        path=Path("photo.png"), pixels=np.zeros((12, 24, 3), np.float32), mask=None,
        sha256="0" * 64, fov=None, exposure=0.0, full_size=(12, 24), assumed={},
    )  # fmt: skip
    if file.name == "run.json":
        for difference in journal.differences(folder, photo, {"model": "some", "steps": 4}):
            _check_text(difference)
        return
    for name in journal.names(folder):
        os.fsencode(name)  # a file's, so it need not be UTF-8
    entries = journal.Journal(folder, photo, {"model": "some", "steps": 4})
    entries.find(Request("dusk", "At dusk.", "", 1))
    assert len(entries) >= 0


def _record(folder: Path, file: Path) -> None:
    [record] = jobs.run([TASK], work, folder)
    assert isinstance(record.values, dict)
    assert record.error is None
    assert isinstance(record.seconds, float)
    assert math.isfinite(record.seconds)
    jobs.is_record(file)


READERS = (
    Reader("png", 22, seeds.png, _picture, crafted.png),
    Reader("jpeg", 12, seeds.jpeg, _picture, crafted.jpeg),
    Reader("tiff", 16, seeds.tiff, _picture, crafted.tiff),
    Reader("hdr", 6, seeds.hdr, _picture, crafted.hdr),
    Reader("exr", 22, seeds.exr, _picture, crafted.exr),
    Reader("maps", 6, seeds.normals, _map, crafted.npy, ".npy", declared.PER_MAP_PIXEL),
    Reader("scene", 12, seeds.scene_folder, _scene),
    Reader("lamps", 6, seeds.lamps, _lamps),
    Reader("result", 12, seeds.result_folder, _result),
    Reader("prompts", 4, seeds.prompts, _prompts),
    Reader("journal", 6, seeds.journal, _journal, crafted.journal, ".png"),
    Reader("record", 2, seeds.records, _record),
)
