"""What a scene holds, what was assumed, and what a fit will need: facts for people."""

from __future__ import annotations

import numpy as np

from pbrfit import geometry
from pbrfit.scene import Scene

SCIPY_BYTES_PER_UNKNOWN = 501
"""Measured for scipy 1.17's L-BFGS-B with 10 corrections."""

FRAME_BYTES_PER_PIXEL = 108
"""Basis functions and n·v of a pixel in the Rust core."""


def fit_memory(scene: Scene) -> int:
    """Bytes that `decompose` needs at its peak, beside the interpreter and its libraries."""
    pixels = int(np.count_nonzero(scene.valid))
    pictures = len(scene.images)
    samples = 3 * pictures * pixels
    unknowns = 5 * pixels + (0 if scene.lighting is not None else 48 * pictures)
    # Pictures as loaded, their scaled copy and the core's; normals and view directions.
    arrays = scene.images.nbytes + 2 * 4 * samples + 4 * scene.normals.nbytes
    return arrays + FRAME_BYTES_PER_PIXEL * pixels + SCIPY_BYTES_PER_UNKNOWN * unknowns


def facts(scene: Scene) -> list[tuple[str, str]]:
    """(topic, fact) pairs, most wanted first."""
    pixels = int(np.count_nonzero(scene.valid))
    radiance = scene.images[:, scene.valid]
    away = geometry.facing_away(scene.normals[scene.valid], scene.views[scene.valid])
    found = [
        ("pictures", f"{len(scene.images)} of {scene.width} × {scene.height} pixels"),
        ("", f"{scene.names[0]} ... {scene.names[-1]}"),
        (
            "radiance",
            f"mean {radiance.mean(dtype=np.float64):.4g}, from {radiance.min():.4g} "
            f"to {radiance.max():.4g}",
        ),
        ("mask", f"{pixels} pixels used, {100 * pixels / scene.valid.size:.1f} %"),
        ("facing away", f"{100 * away.mean():.1f} % of the normals"),
        (
            "segments",
            "none"
            if scene.segments is None
            else f"{len(np.setdiff1d(scene.segments[scene.valid], 0))} ids",
        ),
        ("lights", "unknown, will be fitted" if scene.lighting is None else "known"),
        ("truth", "none" if scene.truth is None else "yes, errors will be reported"),
    ]
    found += [(f"assumed {topic}", fact) for topic, fact in scene.assumed.items()]
    unknowns = 5 * pixels + (0 if scene.lighting is not None else 48 * len(scene.images))
    found += [
        ("unknowns", f"{unknowns}"),
        ("memory needed", f"about {fit_memory(scene) / 2**20:.0f} MiB for solver lbfgsb"),
    ]
    return found
