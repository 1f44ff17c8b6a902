"""What estimators make of a scene: its true normals, depth or maps, disturbed as networks err.

Errors of networks are not noise. They are alike over neighbouring pixels, over whole objects and
over the picture, they grow at outlines, and a few are large. Lengths are shares of the picture's
width unless they are said to be pixels, so the errors are the same at any size.

**Normals.** On indoor photographs with measured depth, DSINE (Bae and Davison 2024) has a mean
error of 16.4 degrees and a median of 8.4 (NYUv2), 16.2 and 8.3 (ScanNet), and other estimators of
these years are near. In this order:

1. outlines are washed out: a Gaussian blur of the normals, `BLUR` wide;
2. each object is seen turned as a whole, by a random rotation with the heavy tail of Student's t;
3. shape is misjudged locally: a random rotation that varies smoothly, over `PATCH`;
4. and over the picture: the same, over `WHOLE`.

A rotation is a vector ω (axis times angle) whose three components are drawn alike. After all, a
normal that would face away from the camera is bent back until it does not: estimators do not give
such ones.

**Depth.** In this order:

1. outlines are washed out: a Gaussian blur of inverse depth, which leaves planes as they are;
2. scale and shift: depth z becomes s z + t, where ln s and t, in units of the median depth, vary
   smoothly over `WHOLE`;
3. surfaces are rough: relative noise that is alike over `NOISE_LENGTH`.

`SCALE` and `SHIFT` are set for a relative error of about 5 % in the mean after the best common
factor; networks of metric depth publish 4 to 8 % on NYUv2. With a noise of 1 % the normals of such
depth are off by some 15 degrees in the median, as those of networks are. With 5 %, `ROUGH`, they
say next to nothing (over 40 degrees): worse than networks are.

**Maps of materials**, from one picture. In this order:

1. each object has another hue and tone, roughness and metallic, 3 % of them the other kind;
2. the share `BAKED` of the picture's shading, in logarithms, is in the albedo;
3. all maps err smoothly over the picture;
4. outlines are washed out by a Gaussian blur of one pixel at a width of 96.

Errors are then about .1 in albedo after the best factor a channel, .13 in roughness and .2 in
metallic; networks publish .10 to .13 and .2 on interiors.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from pbrfit.model.geometry import angles_between, unit
from pbrfit.model.materials import Materials
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.arrays import Array, Floats, filled, known

WAVES = 256

WHOLE = 0.4
"""Length over which errors are alike over the picture."""


def smooth(shape: tuple[int, int], scale: float, rng: Generator) -> Array:
    """Gaussian random field of variance 1 and correlation exp(-d²/(2 scale²)) over distances d.

    A sum of plane waves whose wave vectors have the field's spectrum, a Gaussian of standard
    deviation 1/scale in each component. Distances are shares of the picture's width, so the field
    is the same at any size.
    """
    height, width = shape
    y, x = np.mgrid[:height, :width] / width
    kx, ky = rng.normal(scale=1 / scale, size=(2, WAVES))
    phase = rng.uniform(0, 2 * np.pi, size=WAVES)
    total = np.zeros_like(x)
    for wave in zip(kx, ky, phase, strict=True):
        total += np.cos(wave[0] * x + wave[1] * y + wave[2])
    return np.asarray(np.sqrt(2 / WAVES) * total)


# ------------------------------------------------------------------------------------- normals

LOWEST_COSINE = 0.05
"""Of normal and view direction: normals that are given face the camera."""

BLUR = 0.025
OBJECT_DEGREES, OBJECT_FREEDOM, LARGEST_TURN = 2.0, 2.0, 60.0
PATCH, PATCH_DEGREES = 0.06, 2.5
WHOLE_DEGREES = 2.0
"""Angles in degrees: the standard deviation of a component of ω, for objects the factor of
Student's t, which is cut off at `LARGEST_TURN`."""


def turned(normals: Floats, omega: Floats) -> Array:
    """Normals (H, W, 3), each turned by a vector ω (H, W, 3): axis times angle, in degrees."""
    from scipy.spatial.transform import Rotation

    rotation = Rotation.from_rotvec(omega.reshape(-1, 3), degrees=True)
    return np.asarray(rotation.apply(normals.reshape(-1, 3)).reshape(normals.shape))


def angle_errors(found: Floats, true: Floats) -> dict[str, float]:
    """`mean` and `median` angle between normals (..., 3) in degrees, of those that are known."""
    off = angles_between(found, true)
    off = off[np.isfinite(off)]
    return {"mean": float(off.mean()), "median": float(np.median(off))}


def facing(normals: Floats, views: Floats) -> Array:
    """Normals (H, W, 3) bent until none faces away from the camera: estimators give no such ones.

    With a cosine below c = `LOWEST_COSINE`, n becomes n + (c - n·v) v, normalised: its cosine is c
    before it is normalised, and more than 0 after.
    """
    missing = np.maximum(LOWEST_COSINE - np.einsum("...i,...i->...", normals, views), 0.0)
    return unit(normals + missing[..., None] * views)


def as_estimated(
    normals: Floats,
    views: Floats,
    segments: NDArray[np.integer[Any]],
    rng: Generator,
    *,
    strength: float = 1.0,
) -> Array:
    """True normals (H, W, 3) with the errors of an estimator: unit vectors that face the camera.

    `views` (H, W, 3) are unit vectors from the surface to the camera, `segments` (H, W) ids of
    objects. The same state of `rng` gives the same errors at any picture size, but for what a
    coarser picture does not show. `strength` is a factor of all angles and of the blur, but not of
    the lengths over which errors are alike.
    """
    width = segments.shape[1]
    blurred = gaussian_filter(normals, strength * BLUR * width, axes=(0, 1), mode="nearest")
    turns = rng.standard_t(OBJECT_FREEDOM, size=(int(segments.max()) + 1, 3))
    turns = np.clip(strength * OBJECT_DEGREES * turns, -LARGEST_TURN, LARGEST_TURN)
    omega = turns[segments]
    for scale, degrees in ((PATCH, PATCH_DEGREES), (WHOLE, WHOLE_DEGREES)):
        fields = [smooth(segments.shape, scale, rng) for _ in range(3)]
        omega += strength * degrees * np.stack(fields, axis=-1)
    return facing(turned(unit(blurred), omega), views)


def estimated_normals(scene: Scene, seed: int) -> Array:
    """Normals of a synthetic scene as an estimator would give them, by the scene's seed.

    NaN outside the mask.
    """
    # A stream of its own, apart from those of the scene.
    rng = np.random.default_rng([seed, 1])
    valid = scene.valid
    normals, views = (filled(vectors, valid) for vectors in (scene.normals, scene.views))
    found = as_estimated(normals, views, known(scene.segments), rng)
    return np.where(valid[..., None], found, np.nan)


# --------------------------------------------------------------------------------------- depth

DEPTH_BLUR = 0.75
"""Standard deviation in pixels: a step takes 2 pixels from a tenth to nine tenths."""

SCALE, SHIFT = 0.06, 0.04
"""Standard deviations of ln s and of t."""

NOISE, ROUGH = 0.01, 0.05
"""Standard deviations of the relative noise: of a network, and of something worse."""

NOISE_LENGTH = 3.0
"""Pixels over which noise is alike."""

LEAST = 0.05
"""Share of the true depth that is left at least."""


def estimated_depth(depth: Floats, seed: int, *, noise: float = NOISE) -> Array:
    """True depth (H, W) along the camera's axis with the errors of a network, in its unit.

    By the scene's seed; `noise` is the standard deviation of the relative noise. NaN, unknown,
    stays NaN.
    """
    # A stream of its own, apart from those of the scene and of its normals.
    rng = np.random.default_rng([seed, 3])
    there = np.isfinite(depth)
    true = np.where(there, depth, 1.0).astype(np.float64)
    scale, shift = (smooth(depth.shape, WHOLE, rng) for _ in range(2))
    rough = smooth(depth.shape, NOISE_LENGTH / depth.shape[1], rng)
    # Gaussian means of inverse depth over known pixels.
    total, weight = (
        gaussian_filter(of, DEPTH_BLUR, mode="constant")
        for of in (there / true, there.astype(float))
    )
    blurred = 1.0 / (np.where(there, total, 1.0) / np.where(there, weight, 1.0))
    moved = np.exp(SCALE * scale) * blurred
    moved += SHIFT * np.median(true[there]) * shift
    found = np.exp(noise * rough) * moved
    return np.where(there, np.maximum(found, LEAST * true), np.nan)


# ---------------------------------------------------------------------------------------- maps

HUE, TONE, ROUGHNESS, METALLIC = 0.12, 0.2, 0.12, 0.15
"""Standard deviations of an object: of logarithms of a channel and of all, and of both values."""

WRONG_KIND = 0.03
"""Share of objects that are taken for metals, or metals that are not."""

BAKED = 0.2
"""Share of the logarithm of shading that is taken for albedo."""

SMOOTH = ((0.3, 0.1), (0.1, 0.08), (0.1, 0.05))
"""Of ln albedo, roughness and metallic: length, standard deviation."""


def estimated_maps(scene: Scene, picture: Array, seed: int) -> Materials:
    """Maps of a synthetic scene, by its seed, from a picture (H, W, 3) of it; NaN outside."""
    rng, true, valid = np.random.default_rng([seed, 11]), known(scene.truth).materials, scene.valid
    objects, shape = known(scene.segments), valid.shape
    count = int(objects.max()) + 1
    planes = filled(true.planes, valid & np.isfinite(true.planes).all(axis=-1))
    albedo, roughness, metallic = vars(Materials.of_planes(planes)).values()
    grey = albedo.mean(axis=-1)
    tones = rng.normal(scale=HUE, size=(count, 3)) + rng.normal(scale=TONE, size=(count, 1))
    roughness = roughness + rng.normal(scale=ROUGHNESS, size=count)[objects]
    off = np.abs(rng.normal(scale=METALLIC, size=count))[objects]
    kind = np.where((rng.random(count) < WRONG_KIND)[objects], 1 - metallic, metallic)
    metallic = kind + np.where(kind > 0.5, -off, off)
    shading = np.log(filled(picture, valid).mean(axis=-1) + 1e-3) - np.log(np.maximum(grey, 0.02))
    shading = np.clip(shading - np.median(shading), -2, 1.5)
    fields = [deviation * smooth(shape, length, rng) for length, deviation in SMOOTH]
    albedo = albedo * np.exp(tones[objects] + (BAKED * shading + fields[0])[..., None])
    maps = (albedo, roughness + fields[1], metallic + fields[2])
    blurred = [gaussian_filter(of, shape[1] / 96, axes=(0, 1)) for of in maps]
    return Materials(*blurred).within(valid)
