"""One room by Cycles, explained in one way."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.model.geometry import angles_between, positions
from pbrfit.model.lamps import Lamps
from pbrfit.model.materials import Materials
from pbrfit.result import metrics
from pbrfit.result.relighting import relight
from pbrfit.result.result import Result
from pbrfit.result.sheet import displayed
from pbrfit.scene.integration import depth_from_normals
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.depth_errors import ROUGH, estimated, normals_off, off
from pbrfit_evaluation.explained import Case
from pbrfit_evaluation.explained.variants import BY_KEY, Variant
from pbrfit_evaluation.found_segments import found_segments, purity
from pbrfit_evaluation.normal_errors import unit
from pbrfit_evaluation.panels import of_maps, packed
from pbrfit_evaluation.recipes import explain, fit
from pbrfit_evaluation.scores import score
from pbrfit_evaluation.table1 import measure as table1

SHOWN = 3
"""Held-out pictures that are shown."""


def run(case: Case, threads: int) -> dict[str, Any]:
    """Errors, facts about what was told, the lamps, what was chosen, and perhaps panels.

    Panels are maps of rooms under lamps, and relit pictures of the others.
    """
    exact, lamps = room(case, threads)
    variant = BY_KEY[case.variant]
    scene, facts = told(exact, variant, case.seed)
    if variant.lamps:
        scene = replace(scene, lamps=lamps)
    if variant.guess:
        result = explain(scene, "constant", model=variant.model, threads=threads)
    else:
        result = fit(scene, threads=threads, model=variant.model, **variant.options)
    found: dict[str, Any] = {
        "scores": score(result, scene, threads).as_json(),
        "facts": facts,
        "lamps": {} if lamps is None else lamps_off(result.lamps, lamps, exact),
        "choice": result.transport.kind,
    }
    if case.picture and lamps is not None:
        found["panels"] = maps(result.materials, exact)
    elif case.picture:
        found["panels"] = relit(result, scene, threads)
    return found


def room(case: Case, threads: int) -> tuple[Scene, Lamps | None]:
    """Render the room, which has its true depth in metres; and its lamps, where it has some."""
    task, row = case.of_table1
    lamps = table1.cycles_lamps(task, row) if row.light == "points" else None
    return table1.cycles_scene(task, row, threads), lamps


def lamps_off(found: Lamps | None, true: Lamps, scene: Scene) -> dict[str, float]:
    """How far lamps are off, one a picture, in a scene whose depth is in metres.

    Medians over them of `cm`, the distance between found and true, for near ones, and of `degrees`,
    the angle between these as seen from the middle of the scene; the share that is `near`. Without
    any, nothing.
    """
    if found is None:
        return {}
    assert scene.depth is not None
    middle = positions(scene.depth, scene.fov)[scene.valid].mean(axis=0)
    places = true.places[found.pictures]
    towards = np.where(found.near[:, None], unit(found.places - middle), unit(found.places))
    off = {
        "degrees": float(np.median(angles_between(towards, unit(places - middle)))),
        "near": float(found.near.mean()),
    }
    if found.near.any():
        distances = np.linalg.norm(found.places - places, axis=-1)[found.near]
        off["cm"] = float(100 * np.median(distances))
    return off


def told(exact: Scene, variant: Variant, seed: int) -> tuple[Scene, dict[str, float]]:
    """What a fit is told of a room, and how far that is from the truth.

    Facts are the mean relative error of the depth, the median angle of its normals in degrees, the
    number of segments and the share of pixels that are of the object that has most of their
    segment.
    """
    true, valid = exact.depth, exact.valid
    assert true is not None
    assert exact.segments is not None
    segments: NDArray[Any] | None = exact.segments
    if variant.segments == "found":
        segments = found_segments(exact)
    elif variant.segments == "none":
        segments = None
    depth: NDArray[Any] | None = None
    match variant.depth:
        case "true":
            depth = true
        case "network":
            depth = estimated(true, seed)
        case "rough":
            depth = estimated(true, seed, noise=ROUGH)
        case "integrated":
            depth = depth_from_normals(exact.normals, exact.fov, segments=segments)
    facts = {}
    if depth is not None:
        facts["depth_off"] = off(depth, true, valid)
        facts["normals_off"] = normals_off(depth, exact.normals, exact.fov, valid)
    if segments is not None:
        facts["segments"] = float(len(np.unique(segments[valid])))
        facts["purity"] = purity(segments[valid], exact.segments[valid])
    return replace(exact, segments=segments, depth=depth), facts


def maps(found: Materials, scene: Scene) -> dict[str, Any]:
    """Panels for a record: the true maps, a picture, and the maps that were found."""
    assert scene.truth is not None
    shown = np.where(scene.valid[..., None], scene.images[0], np.nan)
    panels = of_maps(scene.truth.materials, "true ")
    panels["picture"] = displayed(shown, metrics.white_of(shown))
    return packed(panels | of_maps(found))


def relit(result: Result, scene: Scene, threads: int) -> dict[str, Any]:
    """Panels for a record: some held-out pictures, "Cycles 0" and so on, and the same "relit"."""
    truth = scene.truth
    assert truth is not None
    assert truth.relight_lighting is not None
    assert truth.relight_images is not None
    held_out = np.where(scene.valid[..., None], truth.relight_images[:SHOWN], np.nan)
    found = relight(result, truth.relight_lighting[:SHOWN], threads)
    whites = [metrics.white_of(picture) for picture in held_out]
    return packed(
        {
            f"{name} {i}": displayed(picture, white)
            for name, of in (("Cycles", held_out), ("relit", found))
            for i, (picture, white) in enumerate(zip(of, whites, strict=True))
        }
    )
