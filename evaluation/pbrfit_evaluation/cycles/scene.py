"""A world rendered by Cycles as a `Scene` with ground truth."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.model.geometry import view_directions
from pbrfit.model.lamps import Lamps
from pbrfit.model.materials import Materials
from pbrfit.scene.arrays import Truth
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import MEAN_RADIANCE, gains
from pbrfit.synthetic.lights import random_colors, random_lights
from pbrfit.synthetic.world import World
from pbrfit.values.checks import one_of
from pbrfit_evaluation.arrays import Array, Floats, Mask
from pbrfit_evaluation.cycles.export import Stage, export
from pbrfit_evaluation.cycles.job import Job, Transport, rendered

Light = Literal["panorama", "points"]

MAX_TURN = 30.0
"""Neighbouring pixels of one object whose normals differ by more degrees lie at an edge."""

_CLEARANCE = 0.5  # metres from a point light to the nearest surface
_TRIES = 2000  # a point light

SAMPLES: dict[tuple[Light, Transport], int] = {
    ("panorama", "brdf"): 1024,
    ("panorama", "shadows"): 1024,
    ("panorama", "full"): 1024,
    ("points", "brdf"): 1,  # without noise: one light without size, no bounces
    ("points", "shadows"): 1,
    ("points", "full"): 256,
}
"""Light paths a pixel unless told otherwise; docs/cycles.md has the noise they leave."""


def render_scene(
    world: World,
    size: int = 128,
    fov: float = 60.0,
    *,
    light: Light = "panorama",
    transport: Transport = "full",
    lights: int = 16,
    held_out: int = 16,
    seed: int = 0,
    samples: int | None = None,
    cache: Path | None = None,
    threads: int = 2,
) -> Scene:
    """Render pictures of a world with Blender's path tracer.

    Parameters
    ----------
    world
        What to render; see `pbrfit.synthetic.draw`.
    size
        Width and height of the pictures in pixels.
    fov
        Horizontal field of view in degrees, 0 < fov < 180.
    light
        "panorama": SH lights of order 3 from infinitely far away, the ones `make_scene` draws with
        the same seed. "points": one coloured point light a picture, inside the room.
    transport
        "brdf": Principled instead of the closed form, nothing else. "shadows": surfaces block
        light too. "full": and reflect it on each other.
    lights, held_out
        Number of pictures N, and of held-out pictures M, each at least 1. Point lights have no
        held-out pictures, because no known SH light belongs to them.
    seed
        Of the lights, as in `make_scene`, and of the renderer.
    samples
        Light paths a pixel; None = by `light` and `transport` (`SAMPLES`).
    cache
        Folder that keeps renders; None = the user's cache. Panoramas of one seed share a render
        whatever their number is.
    threads
        Of the renderer; the pixels do not depend on it.

    Returns
    -------
    Scene
        float64 radiance in linear Rec.709, exposed as by `make_scene`. The truth, and the depth in
        metres, are what Cycles saw at the pixels' centres. The mask leaves out pixels
        at edges: those with a neighbour of another object or with a normal turned by more than
        `MAX_TURN`. Depth is known there too. `truth.lighting` and the relight pictures are there
        for panoramas alone.

    Raises
    ------
    InputError
        If an argument is out of its range.
    CyclesNotFoundError
        If there is no Python with bpy.
    CyclesError
        If the renderer fails.
    """
    one_of("light", light, Light)
    one_of("transport", transport, Transport)
    if lights < 1 or held_out < 1:
        raise InputError(f"lights, held_out: expected 1 or more, found {lights} and {held_out}")
    if seed < 0:
        raise InputError(f"seed: expected a non-negative integer, found {seed}")
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(4)]
    stage = export(world, size, fov)
    positions = colors = None
    if light == "points":
        positions, colors = random_point_lights(stage, world.walls, lights, streams[1])
    job = Job(
        stage,
        positions,
        transport,
        samples=SAMPLES[light, transport] if samples is None else samples,
        seed=seed % 2**31,
    )
    found = rendered(job, cache=cache, threads=threads)
    mask = inner_pixels(found.segments, found.normals, fov)
    if not mask.any():
        raise InputError(f"size: expected pixels away from edges, found none at {size}")

    def exposed(lighting: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        images = np.einsum("khwc,nkc->nhwc", found.radiance.astype(np.float64), lighting)
        gain = gains(images[:, mask], rng)
        return gain[:, None, None] * lighting, gain[:, None, None, None] * images

    known: dict[str, Array] = {}
    if colors is not None:  # each picture has its own light: coefficients N × N × 3
        _, images = exposed(np.eye(lights)[..., None] * colors[:, None, :], streams[1])
    else:
        known["lighting"], images = exposed(random_lights(lights, streams[1]), streams[1])
        known["relight_lighting"], known["relight_images"] = exposed(
            random_lights(held_out, streams[2]), streams[2]
        )
    level = MEAN_RADIANCE / images[:, mask].mean()
    return Scene(
        images=level * images,
        normals=np.where(mask[..., None], found.normals, np.nan).astype(np.float64),
        fov=fov,
        mask=mask,
        segments=found.segments,
        depth=np.where(found.segments > 0, -found.positions[..., 2], np.nan),
        names=tuple(f"light_{i:02d}" for i in range(lights)),
        truth=Truth(
            materials=Materials(found.albedo, found.roughness, found.metallic).within(mask),
            **{name: level * values for name, values in known.items()},
        ),
    )


def true_lamps(world: World, size: int, fov: float, *, lights: int, seed: int) -> Lamps:
    """The lamps that `render_scene` with `light="points"` and the same arguments puts into a room.

    One a picture, near, in camera space and metres; colours are left unknown, for each picture has
    an exposure of its own.
    """
    stream = np.random.SeedSequence(seed).spawn(4)[1]
    stage = export(world, size, fov)
    places, _ = random_point_lights(stage, world.walls, lights, np.random.default_rng(stream))
    return Lamps(np.arange(lights, dtype=np.intp), places, np.ones(lights, bool))


def inner_pixels(segments: NDArray[np.integer[Any]], normals: Floats, fov: float) -> Mask:
    """(H, W) bool: pixels that face the camera, whose four neighbours continue their surface.

    By object ids (H, W), 0 = nothing there, unit normals (H, W, 3) in camera space, and the
    horizontal field of view in degrees.
    """
    views = view_directions(segments.shape[0], segments.shape[1], fov)
    inner = (segments > 0) & (np.einsum("hwi,hwi->hw", normals, views) > 0)
    least = np.cos(np.radians(MAX_TURN))
    for a, b in ((np.s_[1:, :], np.s_[:-1, :]), (np.s_[:, 1:], np.s_[:, :-1])):
        alike = np.einsum("hwi,hwi->hw", normals[a], normals[b]) >= least
        edge = (segments[a] != segments[b]) | ~alike
        inner[a] &= ~edge
        inner[b] &= ~edge
    return np.asarray(inner)


def random_point_lights(
    stage: Stage, walls: int, count: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Draw lights like lamps: half of them anywhere in the upper half of the room, half at hand.

    The first `walls` meshes are the shell; 0 = the camera's surroundings are the room. Returns
    positions (N, 3) in camera space, at least 0.5 m from every surface, and colours (N, 3) in
    linear Rec.709, the largest channel 1. An InputError says that the room leaves no place.
    """
    around = stage.meshes[:walls] or stage.meshes
    corners = np.concatenate([mesh.vertices for mesh in around] + [np.zeros((1, 3))])
    low, high = corners.min(axis=0), corners.max(axis=0)
    positions: list[Array] = []
    for attempt in range(_TRIES * count):
        if len(positions) == count:
            break
        if attempt % 2:
            place = rng.normal(scale=(0.8, 0.5, 0.4), size=3) + np.array([0.0, 0.3, 0.0])
        else:
            place = low + (high - low) * rng.uniform([0, 0.5, 0], 1)
        if _is_free(place, stage, walls):
            positions.append(place)
    if len(positions) < count:
        raise InputError(f"world: expected room for {count} point lights, found {len(positions)}")
    return np.array(positions), random_colors((count,), rng)


def _is_free(place: Array, stage: Stage, walls: int) -> bool:
    """Whether a place is inside the shell, outside of all pieces and far enough from both.

    Every piece is convex: a point is inside if it is behind the surface at all of its vertices.
    So is the shell, and its normals point inwards.
    """
    for i, mesh in enumerate(stage.meshes):
        towards = place - mesh.vertices
        height = np.einsum("vi,vi->v", towards, mesh.normals)
        if i < walls:
            if height.min() < _CLEARANCE:
                return False
        elif height.max() < 0 or np.linalg.norm(towards, axis=-1).min() < _CLEARANCE:
            return False
    return True
