"""Ways to explain held-out photographs by the others: ours, and what can be had without us."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pbrfit_evaluation.photographs import lambertian, ours
from pbrfit_evaluation.photographs.pictures import Known, Photographs
from pbrfit_evaluation.real.held_out import Split, part
from pbrfit_evaluation.real.lights import best_combination, nearest
from pbrfit_evaluation.real.matt import best_light, unknown_lamps

Array = NDArray[np.float64]

Way = Literal[
    "ours",
    "ours-known",
    "lambert",
    "lambert-known",
    "combination",
    "nearest",
    "constant",
]
WAYS: tuple[Way, ...] = get_args(Way)

IN_WORDS: dict[Way, str] = {
    "ours": "ours",
    "ours-known": "ours, known lamps",
    "lambert": "matt, rank 3",
    "lambert-known": "matt, known lamps",
    "combination": "sum of other photographs",
    "nearest": "nearest photograph",
    "constant": "flat colour",
}

KNOWING: tuple[Way, ...] = ("ours-known", "lambert-known")
"""Those that are told the lamps' directions, also of held-out pictures."""

OURS: tuple[Way, ...] = ("ours", "ours-known")


@dataclass(frozen=True, eq=False)
class Explained:
    """Held-out pictures as explained, and what was found on the way.

    Attributes
    ----------
    held_out, kept
        (M, H, W, 3): the pictures as explained, NaN outside the mask; `kept` None where they would
        be explained by themselves.
    normals, albedo, roughness, metallic
        (H, W, ...) that were found, or None.
    """

    held_out: Array
    kept: Array | None = None
    normals: Array | None = None
    albedo: Array | None = None
    roughness: Array | None = None
    metallic: Array | None = None


def explain(
    way: Way, photographs: Photographs, which: Split, *, iterations: int, threads: int
) -> Explained:
    """Explain the held-out photographs by the kept ones.

    Raises
    ------
    ValueError
        If a way that is told the lamps is asked for where nobody knows them.
    InputError
        If our fit refuses the pictures.
    """
    known = photographs.known
    if way in KNOWING and known is None:
        raise ValueError(f"{way}: expected known lamps, found none")
    told = known if way in KNOWING else None
    if way in OURS:
        return _ours(photographs, which, told, iterations, threads)
    scene = photographs.scene
    if way == "lambert-known":
        assert told is not None
        return _known(photographs, which, told)
    if way == "lambert":
        kept = scene.images[list(which.kept)][:, scene.valid].astype(np.float64)
        basis = unknown_lamps(kept)

        def under_three(chosen: tuple[int, ...]) -> Array:
            return np.stack(
                [
                    best_light(basis, scene.images[i], scene.channel_weights(i), scene.valid)
                    for i in chosen
                ]
            )

        return Explained(under_three(which.held_out), under_three(which.kept))
    others = scene.images[list(which.kept)]
    ones = np.ones((1, *others.shape[1:]))
    found = []
    for i in which.held_out:
        image, weights = scene.images[i], scene.channel_weights(i)
        if way == "nearest":
            found.append(nearest(others, image, weights, scene.valid))
        else:
            planes = others if way == "combination" else ones
            found.append(best_combination(planes, image, weights, scene.valid))
    return Explained(np.stack(found))


def _known(photographs: Photographs, which: Split, known: Known) -> Explained:
    scene, valid = photographs.scene, photographs.scene.valid
    of = list(which.kept)
    weights = np.ones((len(of), int(valid.sum()), 3))
    for row, i in zip(weights, of, strict=True):
        counted = scene.channel_weights(i)
        row[:] = 1.0 if counted is None else counted[valid]
    samples = scene.images[of][:, valid].astype(np.float64)
    samples = np.where(weights > 0, samples, 0.0)
    matt = lambertian.known_lamps(samples, weights, known.of_pictures(which.kept))

    def under(chosen: Sequence[int]) -> Array:
        return np.stack(
            [
                best_light(
                    matt.under(known.directions[i])[None],
                    scene.images[i],
                    scene.channel_weights(i),
                    valid,
                )
                for i in chosen
            ]
        )

    def whole(values: Array) -> Array:
        found = np.full((*valid.shape, 3), np.nan)
        found[valid] = values
        return found

    return Explained(
        under(which.held_out),
        under(which.kept),
        normals=whole(matt.normals),
        albedo=whole(matt.albedo),
    )


def _ours(
    photographs: Photographs, which: Split, told: Known | None, iterations: int, threads: int
) -> Explained:
    scene = photographs.scene
    kept = part(scene, which.kept)
    if told is not None:
        kept = replace(kept, lamps=told.of_pictures(which.kept).lamps)
    result = ours.fit(kept, iterations=iterations, threads=threads)

    def under(chosen: Sequence[int]) -> Array:
        return np.stack(
            [
                ours.relit(
                    result,
                    scene.images[i],
                    scene.channel_weights(i),
                    None if told is None else told.directions[i],
                    threads,
                )
                for i in chosen
            ]
        )

    return Explained(
        under(which.held_out),
        under(which.kept),
        normals=np.asarray(result.normals, np.float64),
        albedo=np.asarray(result.albedo, np.float64),
        roughness=np.asarray(result.roughness, np.float64),
        metallic=np.asarray(result.metallic, np.float64),
    )
