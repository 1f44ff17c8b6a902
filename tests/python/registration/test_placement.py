"""Pictures that are out of line are found, put back or left out; others stay as they are."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

import pbrfit
from command_runs import done
from pbrfit.io.limits import AT_MOST
from pbrfit.registration import displacement, placement
from pbrfit.registration.placement import Placement, Registration, aligned, put_back, register
from pbrfit.result.metrics import rmse
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import make_scene
from planted_lamps import far, planted
from scene_files import known, write_integers

MOVED = 2
"""The picture that is moved."""


@cache
def scene(kind: str = "furnished", size: int = 64, lights: int = 8, seed: int = 11) -> Scene:
    return make_scene(kind, size=size, lights=lights, held_out=1, noise=0.01, seed=seed)


def affine(right: float, down: float, degrees: float = 0, scale: float = 0) -> NDArray[Any]:
    """A displacement, for pictures of 64²."""
    turn = np.deg2rad(degrees)
    slope = 32 * np.array([[scale, turn], [-turn, scale]])
    return np.column_stack([[down, right], slope])


def moved(image: NDArray[Any], by: NDArray[Any]) -> NDArray[Any]:
    """A picture whose content at x lies at x + u(x)."""
    grid = np.stack(np.meshgrid(*map(np.arange, image.shape[:2]), indexing="ij")).astype(float)
    places = grid
    for _ in range(8):  # x of x + u(x)
        places = grid - displacement.displacement_at(by, places, image.shape)
    planes = [map_coordinates(image[..., c], places, order=3, mode="nearest") for c in range(3)]
    return np.stack(planes, axis=-1).astype(np.float32)


def with_picture(original: Scene, picture: NDArray[Any], i: int = MOVED) -> Scene:
    images = original.images.copy()
    images[i] = picture
    return replace(original, images=images)


def shaken(by: NDArray[Any], kind: str = "furnished", size: int = 64, lights: int = 8) -> Scene:
    one = scene(kind, size, lights)
    return with_picture(one, moved(one.images[MOVED], by))


def root_mean_square(by: NDArray[Any]) -> float:
    y, x = np.meshgrid(*[np.linspace(-1, 1, 64)] * 2, indexing="ij")
    u = by @ np.stack([np.ones(64 * 64), y.ravel(), x.ravel()])
    return float(np.sqrt((u**2).sum(axis=0).mean()))


@pytest.mark.parametrize("kind", ["furnished", "room"])
@pytest.mark.parametrize(
    "by",
    [
        affine(0.35, 0.0),
        affine(-0.3, 0.4),
        affine(2, -1.5),
        affine(4, 5),
        affine(0, 0, degrees=1),
        affine(1, 0, degrees=-2),
        affine(0, 0, scale=0.02),
    ],
    ids=str,
)
def test_a_displacement_is_found_to_a_tenth_of_a_pixel_under_other_lights(
    kind: str, by: NDArray[Any]
) -> None:
    lights = 16 if kind == "room" else 8  # mirrors, which eight pictures do not explain
    seed = scene(kind, 64, lights, seed=13)
    found = register(with_picture(seed, moved(seed.images[MOVED], by))).placements
    assert [not one.in_line for one in found] == [i == MOVED for i in range(lights)]
    assert root_mean_square(found[MOVED].affine - by) < 0.1


@pytest.mark.parametrize("kind", ["furnished", "detailed", "room", "textured", "spheres"])
@pytest.mark.parametrize("lights", [2, 8])
def test_light_alone_displaces_nothing(kind: str, lights: int) -> None:
    found = register(scene(kind, lights=lights, seed=31))
    assert found.in_line, found.in_words()


def test_slopes_that_lead_nowhere_are_no_displacement() -> None:
    """Shading asks for displacements of all pictures of a ball under lamps: one is looked into."""
    ball, moved_by_little = planted(far(12), size=128).scene, shaken(affine(0.35, 0.0))
    searches = [placement._Register(one, lambda: False, 0) for one in (ball, moved_by_little)]
    suspects = [search._suspects(search._peaks()) for search in searches]
    assert len(suspects[0]) <= 1
    assert suspects[1] == [MOVED]


def test_a_limit_ends_registration_and_is_named() -> None:
    late = aligned(shaken(affine(2, 0)), stop=lambda: True)
    assert late.assumed["alignment"] == "not checked: the time limit was reached before"
    fit = pbrfit.decompose(shaken(affine(2, 0)), time_limit=0, uncertainty=False)
    assert fit.assumed["alignment"] == late.assumed["alignment"]


def test_a_displacement_counts_from_its_least_length_on() -> None:
    least = displacement.LEAST_DISPLACEMENT
    assert register(shaken(affine(0.7 * least, 0))).in_line
    assert not register(shaken(affine(1.5 * least, 0))).in_line


def test_nothing_is_changed_where_pictures_line_up() -> None:
    one = scene()
    same = aligned(one)
    assert same.images is one.images
    assert same.weights is None
    assert same.assumed["alignment"] == "pictures line up"
    assert aligned(same) is same


def test_a_whole_shift_is_put_back_to_the_bit() -> None:
    one = scene()
    back = aligned(with_picture(one, np.roll(one.images[MOVED], (-3, 2), axis=(0, 1))))
    assert back.weights is not None
    kept = back.weights[MOVED] == 1
    assert (back.weights[MOVED] == 0)[:3].all()
    assert (back.weights[MOVED] == 0)[:, -2:].all()
    assert kept[3:, :-2].all()
    assert np.array_equal(back.images[MOVED][kept], one.images[MOVED][kept])
    others = [i for i in range(8) if i != MOVED]
    assert np.array_equal(back.images[others], one.images[others])
    assert (back.weights[others] == 1).all()
    assert "light_02 was shifted by (2.0, -3.0) pixels, and put back" in back.assumed["alignment"]


def test_resampling_gives_back_a_band_limited_picture() -> None:
    rows, columns = np.mgrid[:40, :50]
    by = np.array([[0.4, 0.3, -0.2], [-1.3, 0.1, 0.3]])

    def picture(row: Any, column: Any) -> Any:
        return (2 + np.sin(row / 3) * np.cos(column / 4))[..., None] * np.ones(3)

    there = displacement.displacement_at(by, np.stack([rows, columns]).astype(float), (40, 50))
    image = picture(rows, columns).astype(np.float32)
    one = Scene(images=np.stack([image, image]), normals=np.tile([0.0, 0, 1], (40, 50, 1)))
    back = put_back(one, Registration((Placement("picture_00", by), Placement("picture_01"))))
    inside = known(back.weights)[0] > 0
    assert 0.85 < inside.mean() < 0.97
    inside[:4] = inside[-4:] = inside[:, :4] = inside[:, -4:] = False  # splines end there
    expected = picture(rows + there[0], columns + there[1])
    np.testing.assert_allclose(back.images[0][inside], expected[inside], atol=2e-3)


def test_what_touches_an_unused_sample_has_no_weight() -> None:
    one = scene()
    weights = np.ones(one.images.shape[:3], np.float32)
    weights[MOVED, 20, 30] = 0
    images = one.images.copy()
    images[MOVED, 20, 30] = np.nan
    half = [Placement(name) for name in one.names]
    half[MOVED] = Placement(one.names[MOVED], affine(0.5, 0))
    back = put_back(replace(one, images=images, weights=weights), Registration(tuple(half)))
    row = known(back.weights)[MOVED, 20]
    assert (row[[29, 30]] == 0).all()
    assert (row[[28, 31]] > 0).all()
    assert (known(back.weights)[MOVED, :, -1] == 0).all()
    assert np.isfinite(back.images).all()


def test_a_camera_in_the_hand_is_put_to_the_middle() -> None:
    one, rng = scene("detailed"), np.random.default_rng(4)
    shifts = rng.normal(0, 0.8, (8, 2))
    images = [
        moved(image, affine(right, down))
        for image, (down, right) in zip(one.images, shifts, strict=True)
    ]
    found = register(replace(one, images=np.stack(images))).placements
    left = np.array([one.affine[:, 0] for one in found]) - shifts
    left -= np.median(left, axis=0)
    before = np.hypot(*(shifts - np.median(shifts, axis=0)).T)
    assert np.median(np.hypot(*left.T)) < 0.15
    assert np.median(before) > 0.5


def test_another_scene_is_left_out_and_named() -> None:
    one = scene("room")
    other = make_scene("furnished", size=64, lights=2, held_out=1, seed=5).images[0]
    lit = replace(one, lighting=one.truth.lighting)  # type: ignore[union-attr]
    left = aligned(with_picture(lit, other))
    assert left.names == tuple(name for name in one.names if name != "light_02")
    assert len(left.images) == len(left.lighting) == 7  # type: ignore[arg-type]
    assert left.assumed["alignment"].startswith("light_02 is left out: its edges agree")


def test_what_files_did_goes_with_the_pictures_that_are_left(tmp_path: Path) -> None:
    one = scene("room")
    images = (one.images / one.images.max()).clip(0)
    other = make_scene("furnished", size=64, lights=2, held_out=1, seed=5).images[0]
    images[MOVED] = other / other.max()
    replace(one, images=images, truth=None).save(tmp_path / "scene")
    for name, picture in zip(one.names, images, strict=True):
        path = tmp_path / "scene" / "images" / f"{name}.exr"
        path.unlink()
        kind = np.uint16 if name == "light_03" else np.uint8
        write_integers(path.with_suffix(".png"), picture, kind)
    read = Scene.load(tmp_path / "scene")
    left = aligned(read)
    assert "light_02 is left out" in left.assumed["alignment"]
    assert left.file_noise == known(read.file_noise)[:MOVED] + known(read.file_noise)[MOVED + 1 :]
    sigma = known(left.noise_floor(2))
    assert np.nanmedian(sigma) < 1e-4 < np.nanmedian(left.noise_floor(3))  # type: ignore[arg-type]


def test_a_black_picture_stays() -> None:
    noise = 0.01 * np.random.default_rng(1).standard_normal((64, 64, 3))
    for black in (np.zeros((64, 64, 3)), noise):
        assert register(with_picture(scene(), black)).in_line


def test_a_black_picture_of_integers_hides_no_displacement() -> None:
    """Half of its noise is clipped: no pixel of many would be left if it were one of the others."""
    one = shaken(affine(2, 0))
    noise = 0.01 * np.random.default_rng(0).standard_normal(one.images[5].shape)
    one = with_picture(one, noise.clip(0).astype(np.float32), 5)
    limits = np.zeros(one.images.shape, np.uint8)
    limits[5][one.images[5] == 0] = AT_MOST
    found = register(replace(one, limits=limits)).placements
    np.testing.assert_allclose(found[MOVED].affine[:, 0], [0, 2], atol=0.1)
    assert all(placed.in_line for i, placed in enumerate(found) if i != MOVED)


def test_bodies_whose_edges_are_of_light_are_not_registered() -> None:
    y, x = np.mgrid[-1:1:64j, -1:1:64j]
    normals = np.stack([x, y, np.sqrt((1 - x**2 - y**2).clip(0.01))], axis=-1)
    lamps = np.array([[1, 0, 0.3], [-1, 0, 0.3], [0, 1, 0.3], [0, -1, 0.3], [0.7, 0.7, 0.2]])
    shaded = np.einsum("hwc,nc->nhw", normals, lamps).clip(0)
    images = np.repeat(shaded[..., None], 3, axis=-1) ** 8 + 1e-3
    found = register(Scene(images=images, normals=normals, mask=x**2 + y**2 < 0.9))
    assert found.in_line
    assert found.in_words() == "not checked: most edges are shadows or highlights"


def test_inspect_says_whether_pictures_line_up(tmp_path: Path) -> None:
    small = make_scene("furnished", size=16, lights=3, held_out=1, seed=1)
    for name, one, said in (
        ("shaken", shaken(affine(4, -3)), "aligned           NO: light_02 was shifted by (4.0, -3"),
        ("sound", scene(), "aligned           pictures line up"),
        ("small", small, "aligned           not checked: pictures below 24"),
    ):
        one.save(tmp_path / name)
        assert said in done("inspect", tmp_path / name)


@pytest.mark.slow
def test_decompose_puts_back_what_was_shifted_unless_told_not_to() -> None:
    one = scene(lights=8)
    rolled = with_picture(one, np.roll(one.images[MOVED], 2, axis=1))
    options = {"uncertainty": False, "refine_normals": "off", "robust": "none"}
    straight, back, as_is = (
        pbrfit.decompose(s, align=align, **options)  # type: ignore[arg-type]
        for s, align in ((one, "auto"), (rolled, "auto"), (rolled, "off"))
    )
    truth = one.truth.materials.albedo  # type: ignore[union-attr]
    errors = [rmse(found.albedo, truth) for found in (straight, back, as_is)]
    assert errors[1] < 1.2 * errors[0]
    assert errors[2] > 2 * errors[0]
    assert back.assumed["alignment"].startswith("light_02 was shifted by (2.0, ")
    assert "alignment" not in as_is.assumed


def test_light_along_folds_leaves_no_picture_out() -> None:
    """Of folded paper one picture shows other edges than the rest: their agreement is low there."""
    rng, lights = np.random.default_rng(3), [(1, 0.17), (-1, 0.17), (0.8, -0.17), (0.17, 1)]

    def folded() -> NDArray[Any]:
        by_column, by_row = np.repeat(rng.normal(size=(2, 8)), 8, axis=1)
        lit = [1 + 0.1 * (x * by_column + y * by_row[:, None]) for x, y in lights]
        paper = 0.5 + 0.002 * rng.normal(size=(64, 64))
        return np.repeat((np.array(lit) * paper)[..., None], 3, axis=-1)

    sheets = Scene(images=folded(), normals=np.broadcast_to([0, 0, 1.0], (64, 64, 3)))
    assert register(sheets).in_line
    found = register(with_picture(sheets, folded()[3], 3))
    assert [bool(one.left_out) for one in found.placements] == [False, False, False, True]
