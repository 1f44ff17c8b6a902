"""What light meets, found from depth: against the true worlds, and with what depth suffers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pbrfit._core import InputError
from pbrfit.synthetic.geometry import Box
from pbrfit.transport.scenery import BACK, FRONT, SIDE, WALL, Scenery
from pbrfit.transport.walls import RUG, SAME_PLANE, Plane, Wall, without_rugs
from small_worlds import (
    INNER,
    INWARDS,
    Seen,
    ball_alone,
    ball_on_floor,
    box_room,
    cosine_rays,
    meets,
)


def built(seen: Seen, segments: bool = True, most: int = 66_000, **changes: Any) -> Scenery:
    ids = seen.segments if segments else None
    found = Scenery(seen.depth, seen.normals, seen.mask, ids, seen.fov, most=most)
    return found.with_extents(replace(found.extents, **changes))


def shown_by(seen: Seen, wall: Wall) -> int:
    """Which primitive a wall is of."""
    return int(np.bincount(seen.segments[wall.pixels]).argmax()) - 1


def closed_room(seen: Seen) -> dict[str, Any]:
    """True extents of the box room."""
    unit = built(seen).unit
    return {"height": 2.6 / unit, "behind": 1.4 / unit, "ceiling": True}


def lifted(seen: Seen, found: Scenery) -> float:
    """How far above their points 99 % of the pixels' rays start at most."""
    above = np.einsum("hwi,hwi->hw", found.starts - seen.points, seen.normals)
    return float(np.nanquantile(above, 0.99))


def disagreement(
    seen: Seen, found: Scenery, solid: list[int], rays: int = 700
) -> tuple[float, float]:
    """Share of rays that are blocked in one only, and of those that things block falsely."""
    rng = np.random.default_rng(5)
    pixels = rng.choice(np.flatnonzero(seen.mask), size=rays)
    normals = seen.normals.reshape(-1, 3)[pixels]
    true = seen.points.reshape(-1, 3)[pixels] + 1e-3 * normals
    directions = cosine_rays(normals, rng)
    truth = seen.blocked(true, directions, solid)
    starts = found.starts.reshape(-1, 3)[pixels].astype(float)
    first = meets(found.triangles, starts, directions)
    false_front = (first >= 0) & np.isin(found.kind[first], (FRONT, BACK, SIDE)) & ~truth
    return float(np.mean(truth != (first >= 0))), float(false_front.mean())


def test_the_walls_of_a_room_are_found() -> None:
    seen = box_room()
    floor, back, left = 0, 4, 2
    shown = {shown_by(seen, wall): wall for wall in built(seen).walls}
    assert {floor, back, left} <= set(shown) <= set(range(6))
    for index, wall in shown.items():
        np.testing.assert_allclose(wall.normal, INWARDS[index] @ seen.turn, atol=1e-2)
        assert wall.offset == pytest.approx(INNER[index] - INWARDS[index] @ seen.eye, abs=0.02)
        assert wall.level == {0: 1, 1: -1}.get(index, 0)


@pytest.mark.parametrize("segments", [True, False])
def test_rays_end_where_they_end_in_the_room(segments: bool) -> None:
    """With true extents and without ceiling, front and the wall that is not seen."""
    seen = box_room()
    unit = built(seen).unit
    found = built(seen, segments, height=2.6 / unit, behind=None, reach=1.4 / unit)
    solid = [shown_by(seen, wall) for wall in found.walls]
    different, false_front = disagreement(seen, found, [*solid, 6, 7])
    assert different < 0.05
    assert false_front < 0.02


def test_a_closed_room_lets_no_light_in() -> None:
    seen = box_room()
    found = built(seen, **closed_room(seen))
    rng = np.random.default_rng(1)
    pixels = rng.choice(np.flatnonzero(seen.mask), size=300)
    rays = cosine_rays(seen.normals.reshape(-1, 3)[pixels], rng)
    first = meets(found.triangles, found.starts.reshape(-1, 3)[pixels].astype(float), rays)
    # All but the wall at the right, if that is not seen.
    right = any(shown_by(seen, wall) == 3 for wall in found.walls)
    assert np.mean(first >= 0) > (0.99 if right else 0.75)


def test_a_ball_shades_the_floor_and_is_its_own_shadow_nowhere() -> None:
    seen = ball_on_floor()
    found = built(seen)
    assert [wall.level for wall in found.walls] == [1]
    assert found.extents.height is None
    assert found.extents.behind is None
    different, false_front = disagreement(seen, found, [0, 1])
    assert different < 0.05
    assert false_front < 0.03
    assert lifted(seen, found) < 0.01


def test_without_segments_the_ball_is_found_too() -> None:
    different, _ = disagreement(ball_on_floor(), built(ball_on_floor(), segments=False), [0, 1])
    assert different < 0.05


def test_a_ball_alone_has_no_walls_and_blocks_none_of_its_own_light() -> None:
    seen = ball_alone()
    found = built(seen)
    assert found.walls == ()
    assert set(found.kind) == {FRONT, BACK, SIDE}
    different, _ = disagreement(seen, found, [0])
    assert different < 0.01


def test_fronts_pass_through_the_points_and_reach_as_far_as_pixels_do() -> None:
    seen = ball_alone()
    found = built(seen)
    front = found.triangles[found.kind == FRONT].reshape(-1, 3)
    for point in seen.points[seen.mask][::23]:
        assert np.linalg.norm(front - point, axis=1).min() < 2e-3
    # The area of the picture that is covered: that of the pixels.
    flat = (
        found.triangles[found.kind == FRONT][..., :2]
        / -found.triangles[found.kind == FRONT][..., 2:]
    )
    (a, b), (c, d) = (flat[:, 1] - flat[:, 0]).T, (flat[:, 2] - flat[:, 0]).T
    area = float(np.abs(a * d - b * c).sum() / 2)
    pixel = (2 * np.tan(np.radians(15)) / seen.mask.shape[1]) ** 2
    assert area == pytest.approx(seen.mask.sum() * pixel, rel=0.02)


@pytest.mark.parametrize("away", [0.1, 0.2, 0.6])
def test_what_hangs_or_stands_before_a_wall_is_none(away: float) -> None:
    panel = Box(centre=np.array([-0.2, 1.3, -3.6 + away / 2]), half=np.array([0.6, 0.6, away / 2]))
    seen = box_room(extra=(panel,))
    shown = {shown_by(seen, wall) for wall in built(seen).walls}
    assert shown >= {0, 2, 4}
    assert 8 not in shown


@pytest.mark.parametrize(
    ("away", "larger", "kept"),
    [
        (0.99 * RUG, False, ["wall"]),
        (0.99 * RUG, True, ["wall"]),  # it hides most of the wall
        (1.01 * RUG, False, ["wall", "other"]),
        (0.99 * SAME_PLANE, True, ["other"]),  # one plane: the larger part tells it best
        (-0.99 * SAME_PLANE, False, ["wall"]),
    ],
)
def test_planes_before_a_parallel_one_are_rugs(away: float, larger: bool, kept: list[str]) -> None:
    scale, normal = 3.0, np.array([0.0, 0.0, 1.0])
    planes = [
        Plane(normal, -4.0, 0.3, 0.0),
        Plane(normal, -4.0 + away * scale, 0.4 if larger else 0.2, 0.0),
    ]
    expected = [planes[["wall", "other"].index(name)] for name in kept]
    assert sorted(without_rugs(planes, scale), key=planes.index) == expected


def test_holes_are_no_surface_and_no_error() -> None:
    seen = ball_on_floor()
    points = seen.points.copy()
    points[::5, ::3] = np.nan
    points[10:16, 20:30] = np.nan
    broken = replace(seen, points=points, mask=seen.mask & np.isfinite(points[..., 0]))
    found = built(broken)
    assert np.isfinite(found.triangles).all()
    assert np.isnan(found.starts[12, 25]).all()
    assert np.isfinite(found.starts[broken.mask]).all()
    different, _ = disagreement(broken, found, [0, 1])
    assert different < 0.1


def test_noise_of_depth_makes_no_shadows() -> None:
    seen = box_room()
    rng = np.random.default_rng(2)
    noisy = seen.points * np.exp(0.05 * rng.normal(size=(*seen.mask.shape, 1)))
    found = built(replace(seen, points=noisy))
    assert {wall.level for wall in found.walls} >= {0, 1}
    solid = sorted({shown_by(seen, wall) for wall in found.walls})
    _, false_front = disagreement(seen, found, [*solid, 6, 7])
    assert false_front < 0.05


def test_a_wall_that_does_not_block_is_left_out() -> None:
    seen = box_room()
    found = built(seen)
    blocks = (False, *found.extents.blocks[1:])
    fewer = found.with_extents(replace(found.extents, blocks=blocks))
    assert (found.kind == WALL).sum() == 2 * len(found.walls)
    assert (fewer.kind == WALL).sum() == 2 * len(found.walls) - 2
    with pytest.raises(InputError, match="blocks"):
        found.with_extents(replace(found.extents, blocks=()))


def test_a_ball_is_as_thick_as_it_is_wide_and_things_are_no_thicker_than_told() -> None:
    seen = ball_alone()
    thin = built(seen, thickness=0.05)
    thick = built(seen, thickness=10.0)
    unit = thin.unit
    # A disc spreads as much as a square whose side is √3 radii.
    for found, deep, tolerance in ((thin, 0.05 * unit, 0.01), (thick, 0.6 * np.sqrt(3), 0.15)):
        front = found.triangles[found.kind == FRONT].astype(float)
        back = found.triangles[found.kind == BACK].astype(float)
        apart = np.linalg.norm(back - front, axis=-1)
        np.testing.assert_allclose(apart, deep, rtol=tolerance)
