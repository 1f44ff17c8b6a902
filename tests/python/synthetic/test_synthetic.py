"""Synthetic scenes: the ray caster against known geometry, the lights, the scenes' promises."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import reference
from pbrfit.model.geometry import view_directions
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import RayCast, draw, make_scene, random_lights
from pbrfit.synthetic.geometry import Box, Cylinder, Plane, Sphere, trace
from pbrfit.synthetic.scenes import ADDED_KINDS
from pbrfit.values.arrays import Array
from pbrfit_evaluation.rooms.parts import Frustum
from scene_files import held_out_of, known, lights_of, truth_of

KINDS: tuple[str, ...] = ("room", "spheres", "textured")
ALL_KINDS = (*KINDS, *ADDED_KINDS)
ORIGIN = np.zeros(3)


def build(kind: str, size: int, rng: np.random.Generator, fov: float = 60.0) -> RayCast:
    return draw(kind, rng).cast(size, fov)


def camera_rays(height: int, width: int, fov: float) -> Array:
    return -view_directions(height, width, fov)


@pytest.mark.parametrize("fov", [0.0, 180.0, -1.0, np.nan])
def test_field_of_view_out_of_range(fov: float) -> None:
    with pytest.raises(ValueError, match="fov"):
        build("room", 4, np.random.default_rng(0), fov)


def test_what_is_behind_or_around_the_camera_is_not_seen() -> None:
    behind = Sphere(centre=np.array([0.0, 0.0, 3.0]), radius=1.0)
    around = [
        Sphere(centre=ORIGIN, radius=1.0),
        Box(centre=ORIGIN, half=np.ones(3)),
        Cylinder(centre=ORIGIN, radius=1.0, half=1.0),
        Frustum(centre=ORIGIN, bottom=1.0, top=0.5, half=1.0),
    ]
    seen_from_below = Plane(centre=np.array([0.0, 1.0, 0.0]))
    hits = trace([behind, *around, seen_from_below], ORIGIN, camera_rays(9, 9, 60.0).reshape(-1, 3))
    np.testing.assert_array_equal(hits.index, -1)
    np.testing.assert_array_equal(hits.distance, np.inf)
    np.testing.assert_array_equal(hits.normals, 0.0)


@pytest.mark.parametrize("sh_order", [2, 3])
@pytest.mark.parametrize("seed", range(5))
def test_lights_are_positive_everywhere(sh_order: int, seed: int) -> None:
    lights = random_lights(16, np.random.default_rng(seed), sh_order)
    assert lights.shape == (16, 16, 3)
    assert lights.dtype == np.float64
    directions = reference.unit(np.random.default_rng(0).normal(size=(20_000, 3)))
    radiance = np.einsum("pk,nkc->npc", reference.sh_basis(directions), lights)
    assert radiance.min() > 0.0


@pytest.mark.parametrize("sh_order", [2, 3])
def test_lights_fill_exactly_the_bands_of_their_order(sh_order: int) -> None:
    lights = random_lights(16, np.random.default_rng(1), sh_order)
    if sh_order == 2:
        np.testing.assert_array_equal(lights[:, 9:], 0.0)
    used = (sh_order + 1) ** 2
    assert (np.linalg.norm(lights[:, :used], axis=(0, 2)) > 0.05).all()


@pytest.mark.parametrize(("count", "sh_order"), [(0, 3), (4, 1), (4, 4)])
def test_bad_light_arguments(count: int, sh_order: int) -> None:
    with pytest.raises(ValueError, match="count" if count == 0 else "sh_order"):
        random_lights(count, np.random.default_rng(0), sh_order)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(3))
def test_every_pixel_is_valid_and_faces_the_camera(kind: str, seed: int) -> None:
    view = build(kind, 64, np.random.default_rng(seed))
    np.testing.assert_allclose(np.linalg.norm(view.normals, axis=-1), 1.0, rtol=1e-14)
    assert (np.sum(-camera_rays(64, 64, view.fov) * view.normals, axis=-1) > 0.0).all()
    assert view.segments.dtype == np.uint16
    assert view.segments.min() >= 1
    m = view.materials
    assert 0.05 - 1e-15 <= m.albedo.min() <= m.albedo.max() < 1.0
    assert 0.15 <= m.roughness.min() <= m.roughness.max() <= 0.9
    assert (m.metallic.min(), m.metallic.max()) == (0.0, 1.0)


@pytest.mark.parametrize("kind", ["room", "spheres"])
def test_segments_have_one_material_each(kind: str) -> None:
    for seed in range(5):
        view = build(kind, 64, np.random.default_rng(seed))
        m = view.materials
        packed = np.concatenate([m.albedo, m.roughness[..., None], m.metallic[..., None]], axis=-1)
        for segment in np.unique(view.segments):
            values = packed[view.segments == segment]
            np.testing.assert_array_equal(values, np.broadcast_to(values[0], values.shape))


def test_textures_vary_all_three_maps_within_pieces() -> None:
    varied = np.zeros(3, dtype=int)
    for seed in range(10):
        view = build("textured", 64, np.random.default_rng(seed))
        for segment in np.unique(view.segments):
            here = view.segments == segment
            maps = (view.materials.albedo, view.materials.roughness, view.materials.metallic)
            varied += [np.ptp(values[here], axis=0).max() > 0.1 for values in maps]
    assert (varied >= 10).all(), varied


def test_scene_does_not_depend_on_the_resolution() -> None:
    # The centres of every third pixel of 96 are the pixel centres of 32.
    for kind in KINDS:
        small = build(kind, 32, np.random.default_rng(5))
        large = build(kind, 96, np.random.default_rng(5))
        assert (small.segments == large.segments[1::3, 1::3]).all()
        np.testing.assert_allclose(
            small.materials.albedo, large.materials.albedo[1::3, 1::3], atol=1e-9
        )


@pytest.mark.parametrize("fov", [20.0, 90.0, 150.0])
@pytest.mark.parametrize("kind", ALL_KINDS)
def test_the_shell_is_closed(kind: str, fov: float) -> None:
    view = build(kind, 24, np.random.default_rng(0), fov)
    assert view.segments.min() >= 1
    assert np.sum(view_directions(24, 24, fov) * view.normals, axis=-1).min() > 0
    assert view.fov == fov


def test_bad_scene_arguments() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="kind: expected one of room, spheres, textured"):
        build("garden", 8, rng)
    with pytest.raises(ValueError, match="size"):
        build("room", 0, rng)
    wrong: tuple[dict[str, Any], ...] = ({"noise": -0.1}, {"noise": np.nan}, {"seed": -1})
    for options in wrong:
        with pytest.raises(ValueError, match=next(iter(options))):
            make_scene("room", size=8, **options)
    with pytest.raises(ValueError, match="count"):
        make_scene("room", size=8, held_out=0)


def arrays(scene: Scene) -> dict[str, NDArray[Any]]:
    maps = truth_of(scene).materials
    return {
        **{name: known(getattr(scene, name)) for name in ("images", "normals", "segments")},
        **{name: getattr(maps, name) for name in ("albedo", "roughness", "metallic")},
        "lighting": lights_of(scene),
        "relight_lighting": held_out_of(scene)[1],
        "relight_images": held_out_of(scene)[0],
    }


@pytest.mark.parametrize("kind", ALL_KINDS)
def test_same_seed_same_bytes(kind: str) -> None:
    first, again, other = (
        arrays(make_scene(kind, size=6, lights=2, held_out=2, noise=0.01, seed=seed))
        for seed in (7, 7, 8)
    )
    for name in first:
        assert first[name].tobytes() == again[name].tobytes(), name
        assert first[name].tobytes() != other[name].tobytes(), name


@pytest.mark.parametrize("kind", KINDS)
def test_exposure(kind: str) -> None:
    for seed in range(4):
        scene = make_scene(kind, size=32, seed=seed)
        assert scene.images.mean() == pytest.approx(0.4, rel=1e-12)
        assert scene.images.min() > 0.0
        for pictures in (scene.images, held_out_of(scene)[0]):
            means = pictures.mean(axis=(1, 2, 3)) / 0.4
            assert means.min() >= 0.5
            assert means.max() <= 2.0
            assert means.max() > 1.2 * means.min()


def test_noise_has_its_size_and_leaves_the_rest_alone() -> None:
    clean = make_scene("room", size=48, seed=3)
    noisy = make_scene("room", size=48, seed=3, noise=0.2)
    added = noisy.images - clean.images
    count = added.size
    assert abs(added.mean()) < 5 * 0.2 / np.sqrt(count)
    assert abs(added.std() / 0.2 - 1) < 5 / np.sqrt(2 * count)
    assert noisy.images.min() < 0.0
    np.testing.assert_array_equal(held_out_of(noisy)[0], held_out_of(clean)[0])
    np.testing.assert_array_equal(truth_of(noisy).lighting, truth_of(clean).lighting)
