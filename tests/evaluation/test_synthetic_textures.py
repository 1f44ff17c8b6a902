"""Texture maps: found by name, laid on primitives; on small files made here."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pbrfit.io import images
from pbrfit.io.color import decode_srgb
from pbrfit.synthetic import make_scene
from pbrfit.synthetic.geometry import Plane, rotation
from pbrfit.synthetic.surfaces import Spots
from pbrfit.values.arrays import Array
from pbrfit_evaluation.rooms import MaterialSet, load_textures
from pbrfit_evaluation.rooms.detailed import LEAST_ROUGHNESS, Textured
from scene_files import known, truth_of


def save(path: Path, values: Any) -> None:
    """Write numbers in [0, 1] as an 8-bit PNG of the same numbers: (H, W) or (H, W, 3)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image = np.asarray(values, dtype=float)
    if image.ndim == 2:
        image = np.repeat(image[..., None], 3, axis=-1)
    images.write_png(path, np.round(255 * image).astype(np.uint8), tag=None)


def save_set(folder: Path, color: Any, rough: Any, metal: Any = None, prefix: str = "") -> None:
    """Write the maps of a set."""
    for name, values in (("albedo", color), ("roughness", rough), ("metallic", metal)):
        if values is not None:
            save(folder / f"{prefix}{name}.png", values)


def noise(seed: int, side: int = 16, channels: int = 3) -> Array:
    return np.asarray(np.random.default_rng(seed).random((side, side, channels)))


def eight_bit(values: Array) -> Array:
    return np.asarray(np.round(255 * values) / 255)


def test_maps_of_a_set_by_folder_name(tmp_path: Path) -> None:
    color, rough, metal = noise(0), noise(1)[..., 0], noise(2)[..., 0]
    save_set(tmp_path / "tin", color, rough, metal)
    (one,) = load_textures(tmp_path)
    assert one.name == "tin"
    assert not one.relief
    assert [len(level) for level in one.levels] == [16, 8, 4, 2, 1]
    finest = one.levels[0]
    np.testing.assert_allclose(finest[..., :3], decode_srgb(eight_bit(color)), atol=1e-6)
    np.testing.assert_allclose(finest[..., 3], eight_bit(rough), atol=1e-6)
    np.testing.assert_allclose(finest[..., 4], eight_bit(metal), atol=1e-6)
    np.testing.assert_array_equal(finest[..., 5:], np.broadcast_to([0, 0, 1], (16, 16, 3)))
    np.testing.assert_allclose(one.mean[:3], decode_srgb(eight_bit(color)).mean((0, 1)), atol=1e-6)
    np.testing.assert_allclose(one.metallic, eight_bit(metal).mean(), atol=1e-6)


@pytest.mark.parametrize(
    ("color", "rough"),
    [
        ("Oak_basecolor.png", "Oak_Roughness.png"),
        ("Oak_base_color.png", "Oak_rough.png"),
        ("Oak_1K-PNG_Color.png", "Oak_1K-PNG_Roughness.png"),
        ("oak_diff_1k.png", "oak_arm_1k.png"),
        ("Oak_BaseColor.png", "Oak_OcclusionRoughMetal.png"),
        ("Oak_baseColor.png", "Oak_roughnessMetallic.png"),
    ],
)
def test_names_in_use(tmp_path: Path, color: str, rough: str) -> None:
    packed = noise(1)
    save(tmp_path / color, noise(0))
    save(tmp_path / rough, packed)
    save(tmp_path / "holiday.png", noise(2))
    (one,) = load_textures(tmp_path)
    assert one.name.lower().startswith("oak")
    combined = any(word in rough for word in ("arm", "Metal"))
    channel = 1 if combined else 0
    np.testing.assert_allclose(one.levels[0][..., 3], eight_bit(packed[..., channel]), atol=1e-6)
    metallic = eight_bit(packed[..., 2]) if combined else np.zeros((16, 16))
    np.testing.assert_allclose(one.levels[0][..., 4], metallic, atol=1e-6)


def test_normal_maps_up_or_down(tmp_path: Path) -> None:
    tilted = np.broadcast_to([0.5 + 0.3, 0.5 + 0.2, 0.5 + np.sqrt(0.25 - 0.13)], (8, 8, 3))
    for name in ("gl/nor_gl.png", "dx/normal_dx.png"):
        save(tmp_path / name, tilted)
        save_set((tmp_path / name).parent, noise(0, 8), noise(1, 8)[..., 0])
    down, up = load_textures(tmp_path)
    assert (down.name, up.name) == ("dx", "gl")
    np.testing.assert_allclose(up.mean[5:], [0.6, 0.4, np.sqrt(0.48)], atol=0.005)
    np.testing.assert_allclose(down.mean[5:], up.mean[5:] * [1, -1, 1], atol=1e-6)
    assert up.relief


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"nowhere: expected a folder of texture maps"):
        load_textures(tmp_path / "nowhere")
    for added, message in (
        ((), r"expected texture maps such as .*, found none"),
        (("oak_albedo",), "expected a roughness map of oak, found none"),
        (("oak_roughness", "tin_roughness"), "expected an albedo or base colour map of tin"),
        (("tin_albedo", "tin_color"), "expected one albedo map of a set, found a second"),
    ):
        for name in added:
            save(tmp_path / f"{name}.png", noise(0))
        with pytest.raises(ValueError, match=message):
            load_textures(tmp_path)


def one_set(maps: Array) -> MaterialSet:
    levels = [maps.astype(np.float32)]
    while len(levels[-1]) > 1:
        half = len(levels[-1]) // 2
        levels.append(levels[-1].reshape(half, 2, half, 2, 8).mean(axis=(1, 3)))
    return MaterialSet(name="made", levels=tuple(levels), relief=True)


def test_relief_tilts_the_normal_to_the_right_of_the_map() -> None:
    maps = np.zeros((1, 1, 8))
    maps[..., :3], maps[..., 3] = 0.5, 0.01
    maps[..., 5:] = [0.6, 0.0, 0.8]
    wall = Plane(centre=np.zeros(3), rotation=rotation(0, 90))
    spots = Spots(np.array([[0.3, 0.0, 0.2]]), np.array([[0.0, 1.0, 0.0]]), np.array([0.01]))
    for quarter, expected in enumerate(([0.6, 0.8, 0], [0, 0.8, -0.6], [-0.6, 0.8, 0])):
        made = Textured(wall, one_set(maps), 1.0, np.zeros(2), quarter, np.array([1.0, 0.5, 4.0]))
        finish = made.at(spots)
        np.testing.assert_allclose(known(finish.normals)[0], expected, atol=1e-6)
        np.testing.assert_allclose(finish.albedo[0], [0.5, 0.25, 0.98], atol=1e-6)
        assert finish.roughness[0] == LEAST_ROUGHNESS


@pytest.fixture
def two_sets(tmp_path: Path) -> Path:
    for name, metallic in (("stone", 0.0), ("steel", 1.0)):
        color, rough = 0.3 + 0.5 * noise(5, 32), 0.2 + 0.6 * noise(6, 32)[..., 0]
        save_set(tmp_path / name, color, rough, np.full((32, 32), metallic))
        tilt = 0.5 + 0.1 * (noise(7, 32) - 0.5)
        tilt[..., 2] = 0.98
        save(tmp_path / name / "normal.png", tilt)
    return tmp_path


def test_scene_from_a_folder_of_maps(two_sets: Path) -> None:
    scene, again, plain = (
        make_scene("detailed", size=32, lights=2, held_out=1, seed=3, textures=textures)
        for textures in (two_sets, load_textures(two_sets), None)
    )
    assert scene.images.tobytes() == again.images.tobytes()
    np.testing.assert_array_equal(scene.segments, plain.segments)
    maps, before = truth_of(scene).materials, truth_of(plain).materials
    assert np.mean(maps.metallic >= 0.5) > 0.08
    changed = np.abs(maps.albedo - before.albedo).max(axis=-1)
    assert np.mean(changed > 0.01) > 0.5
