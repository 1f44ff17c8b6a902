"""One room by Cycles, explained in one way."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.result import metrics
from pbrfit.result.relighting import relight
from pbrfit.result.result import Result
from pbrfit.result.sheet import displayed
from pbrfit.scene.integration import depth_from_normals
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.depth_errors import ROUGH, estimated, normals_off, off
from pbrfit_evaluation.explained import Case
from pbrfit_evaluation.found_segments import found_segments, purity
from pbrfit_evaluation.recipes import explain, fit
from pbrfit_evaluation.scores import score
from pbrfit_evaluation.table1 import measure as table1
from pbrfit_evaluation.transport.variants import BY_KEY, TRUE, WITHOUT, Variant

ROWS: Mapping[str, str] = {
    "brdf": "cycles-brdf",
    "shadows": "cycles-shadows",
    "bounces": "cycles-panorama",
    "detailed": "cycles-detailed",
}
"""Rows of Table 1 that the rooms are rendered as."""

NAMES: Mapping[str, str] = {
    "brdf": "BRDF alone",
    "shadows": "and shadows",
    "bounces": "all bounces",
    "detailed": "all bounces, detailed",
}

FIRST_SEED = 8100
"""Nothing was tuned on seeds from there on."""

PICTURED = (WITHOUT, TRUE)
"""Variants whose relit pictures are shown."""

SHOWN = 3
"""Held-out pictures that are shown."""


def run(case: Case, threads: int) -> dict[str, Any]:
    """Errors, facts about what was told, what was chosen, and perhaps relit pictures."""
    exact = room(case, threads)
    variant = BY_KEY[case.variant]
    scene, facts = told(exact, variant, case.seed)
    if variant.guess:
        result = explain(scene, "constant", model=variant.model, threads=threads)
    elif variant.transport is None:
        result = fit(scene, threads=threads, model=variant.model)
    else:
        result = fit(scene, threads=threads, model=variant.model, transport=variant.transport)
    found = {
        "scores": score(result, scene, threads).as_json(),
        "facts": facts,
        "choice": result.transport.kind,
    }
    if case.picture:
        found["pictures"] = pictures(result, scene, threads)
    return found


def room(case: Case, threads: int) -> Scene:
    """Render the room; it has its true depth."""
    return table1.cycles_scene(*case.of_table1(ROWS), threads)


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


def pictures(result: Result, scene: Scene, threads: int) -> dict[str, Any]:
    """Some held-out pictures, and relit ones, for the screen: (n, H, W, 3) bytes in base 64."""
    truth = scene.truth
    assert truth is not None
    assert truth.relight_lighting is not None
    assert truth.relight_images is not None
    held_out = np.where(scene.valid[..., None], truth.relight_images[:SHOWN], np.nan)
    relit = relight(result, truth.relight_lighting[:SHOWN], threads)
    whites = [metrics.white_of(picture) for picture in held_out]

    def shown(of: NDArray[np.floating[Any]]) -> str:
        seen = [displayed(picture, white) for picture, white in zip(of, whites, strict=True)]
        levels = (255 * np.clip(np.stack(seen), 0, 1) + 0.5).astype(np.uint8)
        return base64.b64encode(levels.tobytes()).decode("ascii")

    return {"shape": list(held_out.shape), "cycles": shown(held_out), "relit": shown(relit)}
