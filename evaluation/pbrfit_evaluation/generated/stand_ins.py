"""Stand-ins for generated pictures: a room under many lights, damaged as a generator would.

Levels build upon each other: what one adds is done on top of what those before it do, with the
same random numbers. The photograph, picture 0, is a file of 8 bits and otherwise as it is. Lengths
are in pixels at a width of 96 and grow with the picture.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from pbrfit.io.color import decode_srgb, encode_srgb
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import draw, make_scene
from pbrfit_evaluation import cycles
from pbrfit_evaluation.review.damage import REPAINTS, bent, damaged, moved
from pbrfit_evaluation.review.pictures import camera, exposed

Array = NDArray[np.float64]

Level = Literal["exact", "toned", "drifted", "repainted"]
LEVELS: tuple[Level, ...] = get_args(Level)

KIND = "detailed"
HELD_OUT = 4

SAMPLES = 256
"""Light paths a pixel: twice the noise of `cycles.SAMPLES`, 1.4 to 2 % of a picture's mean."""

DRIFTED, REPAINTED = 0.25, 0.2
"""Shares of the generated pictures that are moved, and painted over; one more shows another room.
No picture has two of these, so that each costs what it costs."""

SHIFT = (0.3, 2.0)
"""Pixels by which a picture is moved as a whole."""

WARP = 0.5
"""Pixels by which it is bent besides, where it is most."""

STOPS = 0.4
"""Standard deviation of the exposure of a generated picture, in powers of two."""

GAMMA, CONTRAST, FILMIC = (0.8, 1.25), (-0.5, 0.7), (2.0, 4.0)
"""Ranges of the three tone curves: exponent of sRGB values; share of the way to a smoothstep of
them; radiance, over white, that the shoulder of Reinhard's curve (2002, eq. 4) shows as white."""

OTHER_SEED = 100_000
"""Added to the seed of a room: that of another, for the picture of something else."""


@dataclass(frozen=True, eq=False)
class Room:
    """A room with its truth, and its pictures, exposed: white = 1, brighter values there."""

    scene: Scene
    pictures: Array


def room(seed: int, size: int, lights: int, *, by_cycles: bool) -> Room:
    """A textured room under soft lights, by Cycles with all light transport, or by our renderer."""
    if by_cycles:
        scene = cycles.render_scene(
            draw(KIND, np.random.default_rng(seed)),
            size,
            lights=lights,
            held_out=HELD_OUT,
            seed=seed,
            samples=SAMPLES,
            threads=1,
        )
    else:
        scene = make_scene(KIND, size=size, lights=lights, held_out=HELD_OUT, seed=seed)
    rng = np.random.default_rng([seed, 4])
    pictures = np.stack([exposed(of.astype(np.float64), rng) for of in scene.images])
    assert scene.truth is not None
    truth = replace(scene.truth, lighting=None)  # of other exposures
    return Room(replace(scene, images=pictures, truth=truth), pictures)


def stand_ins(of: Room, level: Level, seed: int) -> tuple[Array, list[str]]:
    """Pictures (N, H, W, 3), linear, and in a word what was done to each beside its tones.

    Those of "exact" are floats; all others went through sRGB files of 8 bits.
    """
    pictures = of.pictures.copy()
    if level == "exact":
        return pictures, ["honest"] * len(pictures)
    rank, count = LEVELS.index(level), len(pictures) - 1
    order = 1 + np.random.default_rng([seed, 5]).permutation(count)
    drifts, repaints = round(DRIFTED * count), round(REPAINTED * count)
    kinds = ["honest"] * len(pictures)
    width = pictures.shape[2]
    for i in range(1, len(pictures)):
        place = int(np.flatnonzero(order == i)[0])
        rng = np.random.default_rng([seed, 6, i])
        if place < drifts:
            if rank >= LEVELS.index("drifted"):
                pictures[i], kinds[i] = drifted(pictures[i], rng), "drift"
        elif rank < LEVELS.index("repainted"):
            pass
        elif place < drifts + repaints:
            assert of.scene.segments is not None
            kind = REPAINTS[(seed + place) % len(REPAINTS)]
            pictures[i], kinds[i] = damaged(pictures[i], kind, of.scene.segments, rng)[0], "repaint"
        elif place == drifts + repaints:
            other = make_scene(KIND, size=width, lights=2, held_out=1, seed=seed + OTHER_SEED)
            pictures[i], kinds[i] = exposed(other.images[0].astype(np.float64), rng), "another"
        pictures[i] = toned(pictures[i], np.random.default_rng([seed, 7, i]))
    return camera(pictures), kinds


def drifted(picture: Array, rng: Generator) -> Array:
    """A picture (H, W, 3) moved by `SHIFT` and bent by `WARP`."""
    width = picture.shape[1]
    unit = width / 96
    angle, length = rng.uniform(0, 2 * np.pi), unit * rng.uniform(*SHIFT)
    down, right = bent(picture.shape[:2], 0.1 * width, unit * WARP, rng)
    return moved(picture, down + length * np.sin(angle), right + length * np.cos(angle))


def toned(picture: Array, rng: Generator) -> Array:
    """A picture after another exposure and one of three smooth monotone tone curves; white = 1."""
    linear = np.maximum(picture, 0) * 2 ** rng.normal(scale=STOPS)
    kind = rng.integers(3)
    shown = encode_srgb(np.clip(linear, 0, 1))
    if kind == 0:
        return decode_srgb(shown ** rng.uniform(*GAMMA))
    if kind == 1:
        smoothstep = shown * shown * (3 - 2 * shown)
        return decode_srgb(shown + rng.uniform(*CONTRAST) * (smoothstep - shown))
    white = rng.uniform(*FILMIC)
    return np.asarray(np.clip(linear * (1 + linear / white**2) / (1 + linear), 0, 1))


def segments_of(scene: Scene) -> NDArray[Any]:
    """Ids of objects, as a grey picture of 8 bits holds them."""
    assert scene.segments is not None
    found: NDArray[Any] = np.unique(scene.segments, return_inverse=True)[1]
    return (found.reshape(scene.segments.shape) + 1).astype(np.uint8)
