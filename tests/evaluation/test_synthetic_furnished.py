"""Furnished and detailed rooms: their promises, and all kinds against a second ray caster."""

from __future__ import annotations

import numpy as np
import pytest

import raycaster
from pbrfit.model.geometry import view_directions
from pbrfit.synthetic import draw, make_scene
from pbrfit.synthetic.geometry import trace
from pbrfit.synthetic.scenes import ADDED_KINDS
from pbrfit.synthetic.scenes import KINDS as ALWAYS
from pbrfit_evaluation.cycles.export import export
from pbrfit_evaluation.rooms.coverings import DARKEST, LIGHTEST, LIGHTEST_METAL
from scene_files import held_out_of, lights_of, truth_of

KINDS: tuple[str, ...] = (*ALWAYS, *ADDED_KINDS)
ROOMS: tuple[str, ...] = ("furnished", "detailed")


@pytest.mark.parametrize(("kind", "fov"), [*((kind, 60.0) for kind in KINDS), ("furnished", 90.0)])
def test_pictures_agree_with_a_second_ray_caster(kind: str, fov: float) -> None:
    size, seed = 24, 3
    scene = make_scene(kind, size=size, lights=3, held_out=2, seed=seed, fov=fov)
    stream = np.random.SeedSequence(seed).spawn(4)[0]
    world = draw(kind, np.random.default_rng(stream))
    view = raycaster.look(world, size, fov)

    assert scene.segments is not None
    np.testing.assert_array_equal(scene.segments.ravel(), view.index + 1)
    rays = np.einsum("ij,pj->pi", world.turn, -view_directions(size, size, fov).reshape(-1, 3))
    hits = trace(world.primitives, world.eye, rays)
    np.testing.assert_allclose(hits.distance, view.distance, atol=1e-9)
    placed = [
        world.primitives[i].rotation @ point + world.primitives[i].centre
        for i, point in zip(hits.index, hits.local, strict=True)
    ]
    np.testing.assert_allclose(placed, view.points, atol=1e-9)
    known, flat = truth_of(scene).materials, (size * size, -1)
    maps = [known.albedo, known.roughness, known.metallic]
    found = np.concatenate([of.reshape(flat) for of in maps], axis=-1)
    np.testing.assert_allclose(scene.normals.reshape(flat), view.normals, atol=1e-6)
    np.testing.assert_allclose(found, view.materials, atol=1e-6)
    for images, lighting in ((scene.images, lights_of(scene)), held_out_of(scene)):
        radiance = view.radiance(lighting)
        np.testing.assert_allclose(images.reshape(radiance.shape), radiance, atol=1e-6)


@pytest.mark.parametrize("kind", ROOMS)
def test_rooms_keep_their_promises(kind: str) -> None:
    views = view_directions(32, 32, 60.0)
    for seed in range(3):
        world = draw(kind, np.random.default_rng(seed))
        view = world.cast(32)
        m = view.materials
        np.testing.assert_allclose(np.linalg.norm(view.normals, axis=-1), 1.0, rtol=1e-14)
        assert (np.sum(views * view.normals, axis=-1) > 0.0).all()
        assert world.walls == 6
        assert 20 <= len(world.primitives) - world.walls <= 38
        assert len(world.surfaces) == len(world.primitives)
        ids, pixels = np.unique(view.segments, return_counts=True)
        assert np.sum(pixels[ids > 6] >= 2) >= 18, f"seed {seed}: pieces to be seen"
        assert 0.1 <= np.mean(m.metallic >= 0.5) <= 0.5, f"seed {seed}"
        dielectric = m.metallic == 0.0
        assert m.albedo[dielectric].min() >= DARKEST - 1e-12
        assert m.albedo[dielectric].max() <= LIGHTEST + 1e-12
        assert m.albedo.max() <= LIGHTEST_METAL
        assert (m.metallic.min(), m.metallic.max()) == (0.0, 1.0)
        assert 0.12 <= m.roughness.min() <= m.roughness.max() <= 0.95


@pytest.mark.slow
def test_every_piece_is_in_the_room() -> None:
    for seed in range(5):
        meshes = export(draw("furnished", np.random.default_rng(seed)), 8, 60.0).meshes
        for wall in meshes[:6]:
            for i, piece in enumerate(meshes[6:]):
                height = (piece.vertices - wall.vertices[0]) @ wall.normals[0]
                assert height.min() > -1e-9, f"seed {seed}: piece {i}"


def test_fine_detail_fades_with_distance() -> None:
    world = draw("detailed", np.random.default_rng(2))

    def roughness_steps(size: int) -> float:
        """Mean step between pixels of one piece, per step in the scene."""
        view = world.cast(size)
        same = np.diff(view.segments.astype(int), axis=1) == 0
        return float(np.abs(np.diff(view.materials.roughness, axis=1))[same].mean()) * size

    # More pixels show more detail: steps shrink more slowly than pixels do.
    assert roughness_steps(192) > 1.3 * roughness_steps(32)
