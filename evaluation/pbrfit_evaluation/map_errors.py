"""Maps of materials as a network would estimate them from one picture: the true ones, disturbed.

Networks see outlines a little blurred, take a part of shading and shadow for paint, and misjudge
whole objects: their hue and tone, how rough they are, and whether they are of metal. In this order:

1. each object has another hue and tone, roughness and metallic, 3 % of them the other kind;
2. the share `BAKED` of the picture's shading, in logarithms, is in the albedo;
3. all maps err smoothly over the picture;
4. outlines are washed out by a Gaussian blur of one pixel at a width of 96.

Errors are then about .1 in albedo after the best factor a channel, .13 in roughness and .2 in
metallic; networks publish .10 to .13 and .2 on interiors.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

from pbrfit.model.materials import Materials
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.arrays import Array, filled, known
from pbrfit_evaluation.normal_errors import smooth
from pbrfit_evaluation.recipes import within

HUE, TONE, ROUGHNESS, METALLIC = 0.12, 0.2, 0.12, 0.15
"""Standard deviations of an object: of logarithms of a channel and of all, and of both values."""

WRONG_KIND = 0.03
"""Share of objects that are taken for metals, or metals that are not."""

BAKED = 0.2
"""Share of the logarithm of shading that is taken for albedo."""

SMOOTH = ((0.3, 0.1), (0.1, 0.08), (0.1, 0.05))
"""Of ln albedo, roughness and metallic: length in widths of the picture, standard deviation."""


def estimated(scene: Scene, picture: Array, seed: int) -> Materials:
    """Maps of a synthetic scene, by its seed, from a picture (H, W, 3) of it; NaN outside."""
    assert scene.segments is not None
    rng, true, valid = np.random.default_rng([seed, 11]), known(scene.truth).materials, scene.valid
    objects, shape = scene.segments, valid.shape
    count = int(objects.max()) + 1
    planes = np.concatenate([true.albedo, true.roughness[..., None], true.metallic[..., None]], -1)
    planes = filled(planes, valid & np.isfinite(planes).all(axis=-1))
    albedo, roughness, metallic = planes[..., :3], planes[..., 3], planes[..., 4]
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
    return within(Materials(*blurred), valid)
