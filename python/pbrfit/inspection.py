"""What a scene holds, what was assumed, and what a fit will need: facts for people."""

from __future__ import annotations

import numpy as np

from pbrfit import geometry
from pbrfit.layout import Layout
from pbrfit.needs import Needs
from pbrfit.priors import Priors
from pbrfit.scene import Scene

BYTES_PER_UNKNOWN = 480
"""Measured with scipy 1.17's L-BFGS-B and 10 corrections: its workspace, bounds, x and gradient."""

BLOCK = 128
"""Pixels are padded to whole blocks of so many in the Rust core."""

DIRECTION_BYTES = 32
"""Of a pixel in the Rust core: normal and mirror direction in float32, n·v in float64."""

VECTOR_BYTES = 5 * 24
"""Of a pixel while the core is made: view directions, and two copies of those and of normals."""


def fit_memory(scene: Scene, layout: Layout) -> int:
    """Bytes that `decompose` needs at its peak, beside the interpreter and its libraries."""
    pixels, channels = layout.pixels, layout.channels
    planes = len(scene.images) * (channels + (scene.weights is not None))
    arrays = scene.images.nbytes + scene.normals.nbytes + 8 * channels * pixels  # mean picture
    if scene.weights is not None:
        arrays += scene.weights.nbytes
    core = (4 * planes + DIRECTION_BYTES) * BLOCK * -(-pixels // BLOCK)
    # Pictures and weights are scaled into arrays that the core copies; these are gone when the
    # solver begins.
    making = (4 * planes + VECTOR_BYTES) * pixels
    return arrays + core + max(making, BYTES_PER_UNKNOWN * layout.size)


def facts(scene: Scene) -> list[tuple[str, str]]:
    """(topic, fact) pairs, most wanted first."""
    layout = Layout.of(scene)
    radiance = np.stack([scene.samples(i) for i in range(len(scene.images))])
    away = geometry.facing_away(scene.normals[scene.valid], scene.views[scene.valid])
    found = [
        ("pictures", f"{len(scene.images)} of {scene.width} × {scene.height} pixels"),
        ("", f"{scene.names[0]} ... {scene.names[-1]}"),
        (
            "radiance",
            f"mean {radiance.mean(dtype=np.float64):.4g}, from {radiance.min():.4g} "
            f"to {radiance.max():.4g}",
        ),
        ("mask", f"{layout.pixels} pixels used, {100 * layout.pixels / scene.valid.size:.1f} %"),
        ("facing away", f"{100 * away.mean():.1f} % of the normals"),
        (
            "segments",
            "none" if layout.segments is None else f"{layout.segment_count} ids",
        ),
        (
            "colour",
            "grey: one channel will be fitted" if layout.channels == 1 else "three channels",
        ),
        ("lights", "known" if layout.lighting_known else "unknown, will be fitted"),
        ("truth", "none" if scene.truth is None else "yes, errors will be reported"),
    ]
    found += [(f"assumed {topic}", fact) for topic, fact in scene.assumed.items()]
    needs = Needs.of(scene, layout, priors=Priors())
    found += [
        ("fit by default", "; ".join(needs.used)),
        ("left out", "; ".join(needs.left_out) or "nothing"),
        ("unknowns", f"{layout.size}"),
        ("memory needed", f"about {fit_memory(scene, layout) / 2**20:.0f} MiB for solver lbfgsb"),
    ]
    return found
