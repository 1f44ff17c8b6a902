"""Light among surroundings: physical facts, how exact tables are, and planted scenes recovered."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pbrfit import InputError, Scene, _core, decompose
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import MODELS, Model, render
from pbrfit.synthetic.geometry import Box, Plane, rotation
from pbrfit.transport.decision import Transport
from pbrfit.transport.scenery import RAYS, Scenery
from pbrfit.values.arrays import Array
from scene_files import known
from small_worlds import Seen, box_room, look

both_models = pytest.mark.parametrize("model", MODELS)
UNIFORM = np.zeros((1, 16, 3))
UNIFORM[:, 0] = 2 * math.sqrt(math.pi)
"""Light of radiance 1 from everywhere."""
FOV = {"room": 65.0, "boxes": 55.0}


def two_boxes(size: int = 32) -> Seen:
    """On a floor."""
    things = [
        Plane(centre=np.zeros(3)),
        Box(centre=np.array([-0.5, 0.4, -2.2]), half=np.array([0.3, 0.4, 0.3])),
        Box(centre=np.array([0.5, 0.25, -1.7]), half=np.array([0.4, 0.25, 0.2])),
    ]
    return look(things, np.array([0.1, 1.3, 0.5]), rotation(0, -28.0), size, FOV["boxes"])


def scenery_of(seen: Seen, fov: float) -> Scenery:
    depth = -seen.points[..., 2].astype(np.float32)
    return Scenery(depth, seen.normals, seen.mask, seen.segments, fov)


def random_materials(shape: tuple[int, ...], seed: int = 0) -> Materials:
    rng = np.random.default_rng(seed)
    return Materials(
        rng.uniform(0.1, 0.9, (*shape, 3)),
        rng.uniform(0.2, 0.9, shape),
        (rng.random(shape) < 0.3) * rng.uniform(0.6, 1.0, shape),
    )


def arrays(materials: Materials) -> tuple[Array, Array, Array]:
    """Of pixels, as the core takes them."""
    maps = materials.albedo, materials.roughness, materials.metallic
    albedo, roughness, metallic = (np.asarray(of, float) for of in maps)
    return albedo, roughness, metallic


def seen_pixels(seen: Seen, scenery: Scenery, places: NDArray[np.intp]) -> tuple[Array, Array]:
    """Normals and views of some pixels."""
    points = scenery.points.reshape(-1, 3)[places]
    views = -points / np.linalg.norm(points, axis=1, keepdims=True)
    return seen.normals.reshape(-1, 3)[places], views


def lamps(count: int, seed: int = 3) -> Array:
    rng = np.random.default_rng(seed)
    lights = np.zeros((count, 16, 3))
    lights[:, 0] = 3.0
    lights[:, 1:4] = rng.normal(0, 1.0, (count, 3, 1))
    lights[:, 4:] = rng.normal(0, 0.3, (count, 12, 1))
    return np.asarray(lights * rng.uniform(0.8, 1.2, (count, 1, 3)), float)


@both_models
def test_pictures_are_linear_in_the_light(model: Model) -> None:
    seen = two_boxes(20)
    scenery, materials = scenery_of(seen, FOV["boxes"]), random_materials(seen.mask.shape)
    one, other = lamps(2)
    lights = np.stack([one, other, one + other, -2 * one])
    for kind, share in (("occlusion", 1e-12), ("bounce", 1e-4)):
        transport = Transport(kind)  # type: ignore[arg-type]
        shown = scenery.render(materials, seen.normals, lights, transport, model=model)
        a, b, both, twice = shown[:, seen.mask]
        np.testing.assert_allclose(both, a + b, rtol=0, atol=share * np.abs(both).max())
        np.testing.assert_allclose(twice, -2 * a, rtol=0, atol=share * np.abs(twice).max())


def turned_light(lights: Array, turn: Array) -> Array:
    """L(turn⁻¹ ω), of (N, 16, 3)."""
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(400, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    shown = np.einsum("dk,nkc->ndc", _core.sh_basis(directions @ turn), lights)
    found = [np.linalg.lstsq(_core.sh_basis(directions), one, rcond=None)[0] for one in shown]
    return np.stack(found)


@both_models
def test_a_scene_that_turns_with_its_light_looks_the_same(model: Model) -> None:
    seen = two_boxes()
    scenery = scenery_of(seen, FOV["boxes"])
    turn = rotation(1, 70.0) @ rotation(0, 35.0) @ rotation(2, -50.0)
    places = np.flatnonzero(seen.mask)[::7]
    points = scenery.starts.reshape(-1, 3)[places].astype(float)
    normals = seen.normals.reshape(-1, 3)[places]
    views = -points / np.linalg.norm(points, axis=1, keepdims=True)
    triangles = scenery.triangles.astype(float)
    materials = random_materials((len(places),))
    lights = lamps(3)

    def shown(by: Array, lights: Array) -> Array:
        surfaces = np.zeros(len(triangles), np.uint8)
        core = _core.Surroundings((triangles @ by.T).astype(np.float32), surfaces)
        directions = normals @ by.T, views @ by.T
        rows, _ = core.transfer(
            points @ by.T, *directions, places.astype(np.uint64), rays=20_000, model=model
        )
        return _core.render(*directions, *arrays(materials), lights, 1, model=model, transfer=rows)

    given, turned = shown(np.eye(3), lights), shown(turn, turned_light(lights, turn))
    size = math.sqrt(np.mean(given**2))
    assert math.sqrt(np.mean((turned - given) ** 2)) < 0.005 * size


@both_models
def test_tables_are_within_one_per_cent_of_those_of_ten_times_the_rays(model: Model) -> None:
    """Radiance of all materials, beside that under the open sky; rows stand for each other."""
    seen = two_boxes()
    scenery = scenery_of(seen, FOV["boxes"])
    places = np.flatnonzero(seen.mask)[::6]
    directions = seen_pixels(seen, scenery, places)
    few, many = (scenery.transfer(places, model, rays=rays).rows for rays in (RAYS, 10 * RAYS))
    lights, errors, sizes = lamps(6), [], []
    for roughness in (0.2, 0.4, 0.6, 0.9):
        for metallic in (0.0, 1.0):
            of_pixels = (
                np.full((len(places), 3), 0.7),
                np.full(len(places), roughness),
                np.full(len(places), metallic),
            )

            def shown(rows: Any, of_pixels: tuple[Array, Array, Array] = of_pixels) -> Array:
                return _core.render(*directions, *of_pixels, lights, 1, model=model, transfer=rows)

            errors.append(np.mean((shown(few) - shown(many)) ** 2))
            sizes.append(np.mean(shown(None) ** 2))
    share = math.sqrt(np.mean(errors) / np.mean(sizes))
    assert share < 0.01
    assert max(np.sqrt(np.divide(errors, sizes))) < 0.02


def box(half: float = 1.0) -> NDArray[np.float32]:
    """(12, 3, 3): the faces of a cube about the origin."""
    faces = []
    for axis, side in np.ndindex(3, 2):
        middle, u, v = half * np.roll(np.eye(3), -axis, axis=0) * (2 * side - 1)
        corners = middle - u - v, middle + u - v, middle + u + v, middle - u + v
        faces += [corners[:3], (corners[0], *corners[2:])]
    return np.array(faces, np.float32)


@both_models
def test_a_closed_box_is_dark(model: Model) -> None:
    """All light comes from outside, and nothing lets it in.

    The paper's lobe, seen aslant, takes light from below the horizon too, which nothing blocks: it
    is looked at from above.
    """
    rng = np.random.default_rng(1)
    count = 200
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    views = normals + (0.7 if model == "principled" else 0.0) * rng.normal(size=(count, 3)) / 2
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    core = _core.Surroundings(box(), np.zeros(12, np.uint8))
    points, seeds = rng.uniform(-0.7, 0.7, (count, 3)), np.arange(count, dtype=np.uint64)
    rows, _ = core.transfer(points, normals, views, seeds, rays=RAYS, model=model)
    given = (normals, views, *arrays(random_materials((count,))), UNIFORM, 1)
    dark, lit = (_core.render(*given, model=model, transfer=table) for table in (rows, None))
    assert np.sqrt(np.mean(dark**2)) < 0.01 * np.sqrt(np.mean(lit**2))
    assert np.abs(dark).max() < 0.1


@both_models
def test_a_white_room_as_bright_as_the_sky_is_not_seen(model: Model) -> None:
    """The furnace: where surroundings bring as much as they block, pictures are as in the open."""
    seen = box_room(24)
    scenery = scenery_of(seen, FOV["room"])
    places = np.flatnonzero(seen.mask)
    images = np.ones((*seen.mask.shape, 1, 3), np.float32)
    tables = scenery.transfer(places, model, images=images, rays=300)
    of_pixels = *seen_pixels(seen, scenery, places), *arrays(random_materials((len(places),)))
    lit = partial(_core.render, *of_pixels, UNIFORM, 1, model=model)
    among, alone = lit(transfer=tables.rows, bounced=tables.scaled(np.ones(1))), lit()
    np.testing.assert_allclose(among, alone, rtol=0, atol=2e-4)
    blocked = lit(transfer=tables.rows)
    assert np.median(blocked / alone) < 0.6


def planted(
    model: Model, kind: str, size: int = 32, pictures: int = 12
) -> tuple[Scene, Materials, Array]:
    """Boxes on a floor with random materials, rendered among their own surroundings."""
    seen = two_boxes(size)
    scenery = scenery_of(seen, FOV["boxes"])
    materials = random_materials(seen.mask.shape, seed=1)
    lights = lamps(pictures)
    transport = Transport(kind)  # type: ignore[arg-type]
    shown = scenery.render(materials, seen.normals, lights, transport, model=model)
    outside = ~seen.mask
    for of_map in (materials.albedo, materials.roughness, materials.metallic):
        of_map[outside] = np.nan
    scene = Scene(
        images=shown,
        normals=seen.normals,
        mask=seen.mask,
        depth=-seen.points[..., 2].astype(np.float32),
        fov=FOV["boxes"],
        segments=seen.segments,
        lighting=lights,
        model=model,
        limits=np.zeros(shown.shape, np.uint8),
    )
    return scene, materials, lights


def wrong(scene: Scene, materials: Materials, **options: Any) -> Array:
    """(P,) error of the worst of albedo, roughness and metallic."""
    result = decompose(
        scene, priors=None, uncertainty=False, equal_exposures=True, refine_normals="off", **options
    )
    found, valid = result.materials, scene.valid
    worst: Array = np.maximum.reduce(
        [
            np.abs(found.albedo - materials.albedo)[valid].max(axis=-1),
            np.abs(found.roughness - materials.roughness)[valid],
            np.abs(found.metallic - materials.metallic)[valid],
        ]
    )
    return worst


def in_the_open(scene: Scene, materials: Materials, lights: Array, model: Model) -> Scene:
    """The same without surroundings."""
    pictures = render(materials, scene.normals, lights, scene.fov, 1, model=model)
    return replace(scene, images=pictures, depth=None)


@pytest.mark.slow
@both_models
def test_known_lights_give_exact_materials_as_in_the_open(model: Model) -> None:
    """All but the few pixels that end in another minimum, with surroundings and without."""
    scene, materials, lights = planted(model, "occlusion")
    among = wrong(scene, materials, transport="occlusion")
    alone = wrong(in_the_open(scene, materials, lights, model), materials)
    for error in (among, alone):
        assert np.median(error) < 1e-12
        assert np.mean(error > 1e-6) < 0.01
    # What surroundings do is not to be had from materials.
    assert np.mean(wrong(scene, materials, transport="none") > 1e-3) > 0.5


@pytest.mark.slow
@both_models
def test_lights_and_materials_are_found_among_surroundings(model: Model) -> None:
    """As near as what no picture shows is found, by fewer rays, whose noise hides the floor."""
    scene, materials, _ = planted(model, "occlusion", 24)
    error = wrong(replace(scene, lighting=None), materials, transport="occlusion")
    assert np.median(error) < 0.01


def test_tables_are_the_same_at_any_number_of_threads_and_of_any_part() -> None:
    seen = two_boxes(24)
    scenery = scenery_of(seen, FOV["boxes"])
    places = np.flatnonzero(seen.mask)
    images = np.random.default_rng(0).uniform(0, 1, (24, 24, 2, 3)).astype(np.float32)
    for model in MODELS:
        whole = scenery.transfer(places, model, images=images, rays=100, threads=1)
        two = scenery.transfer(places, model, images=images, rays=100, threads=2)
        part = scenery.transfer(places[5::9], model, images=images, rays=100, threads=2)
        chosen = whole.of(np.arange(5, len(places), 9, dtype=np.uint64))
        for a, b in ((whole, two), (chosen, part)):
            np.testing.assert_array_equal(a.rows, b.rows)
            np.testing.assert_array_equal(known(a.bounced), known(b.bounced))


ONE = np.zeros((1, 3)), np.array([[0.0, 0, 1]]), np.array([[0.0, 0, 1]]), np.zeros(1, np.uint64)
SAMPLES = np.ones((2, 3, 1), np.float32)


@pytest.mark.parametrize(
    ("position", "changes", "message"),
    [
        (0, np.full((1, 3), np.nan), "points: expected"),
        (0, np.full((1, 3), 1e300), "points: expected"),
        (1, np.zeros((1, 3)), "normals: expected unit vectors"),
        (2, np.ones((2, 3)), "views: expected 1 numbers, found 2"),
        (3, np.zeros(2, np.uint64), "seeds: expected 1 numbers, found 2"),
        (3, np.zeros(1), "seeds: expected"),
        (None, {"rays": 0}, "rays: expected 1 to"),
        (None, {"rays": 2**40}, "rays: expected 1 to"),
        (None, {"model": "phong"}, "model: expected"),
        (None, {"radiance": SAMPLES}, "nearest: expected"),
        (None, {"radiance": SAMPLES[:0]}, "radiance: expected at least one pixel"),
        (None, {"radiance": SAMPLES * np.float32(np.nan)}, "radiance: expected"),
        (None, {"radiance": SAMPLES, "half_width": -1.0}, "half_width: expected"),
        (
            None,
            {"radiance": SAMPLES, "nearest": np.full(12, 6, np.uint32)},
            "nearest: expected pixels below 6, found 6",
        ),
    ],
)
def test_unusable_arguments_are_refused_in_one_line(
    position: int | None, changes: Any, message: str
) -> None:
    core = _core.Surroundings(box(), np.repeat([1, 2], 6).astype(np.uint8))
    given: list[Any] = list(ONE)
    options: dict[str, Any] = {"rays": 60, "model": "paper"}
    if position is None:
        options |= changes
    else:
        given[position] = changes
    with pytest.raises(InputError, match=f"^{message}") as caught:
        core.transfer(*given, **options)
    assert "\n" not in str(caught.value)
