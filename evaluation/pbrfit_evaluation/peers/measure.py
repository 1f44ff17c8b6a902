"""A scene by a method: our fit, a guess, or a network that sees one picture."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.display.tone import codes, encoded
from pbrfit.model.materials import Materials
from pbrfit.result import metrics
from pbrfit.scene.scene import Scene
from pbrfit_evaluation import cycles
from pbrfit_evaluation.arrays import Floats
from pbrfit_evaluation.estimator_errors import estimated_normals
from pbrfit_evaluation.grid import NOISE, Case, Grid, measured
from pbrfit_evaluation.recipes import GUESS, Way
from pbrfit_evaluation.suite import Options
from pbrfit_evaluation.table1 import measure as table1
from pbrfit_evaluation.table1.measure import ROWS

PEERS = ("marigold", "rgbx")

WAYS: Mapping[str, Way] = {
    # As people run it: the normals are those of an estimator, and may be refined.
    "pbrfit": Way("pbrfit, all pictures", {"refine_normals": "auto"}),
    "constant": GUESS,
    "marigold": Way("Marigold-IID, one picture"),
    "rgbx": Way("RGB-X, one picture"),
}


@dataclass(frozen=True)
class Task(Case):
    """A furnished room by a method, in pictures of our forward model or of Blender Cycles."""

    samples: int = 5
    """Predictions of Marigold-IID that are combined."""
    steps: int | None = None
    """Of the peers' samplers; None = as their authors recommend."""
    longer_side: int = 1000
    """Of what RGB-X is shown, in pixels."""
    checkpoint: str | None = None
    device: str = field(default="auto", repr=False)
    """`checkpoint` and `device`: of a peer: its network, and where it computes."""


Peer = Callable[[NDArray[np.uint8], Task], Materials]
"""Finds maps in a picture."""


def work(task: Task, threads: int) -> dict[str, Any]:
    """Errors of a method on a scene, the picture that peers are shown, and maps of the first."""
    scene = given(task, threads)
    at, way = evenly_lit(scene), WAYS[task.way]
    if task.way in PEERS:
        import torch

        torch.set_num_threads(threads)  # else the one thread that tasks leave to BLAS
        peer = _loaded(task.way, task.checkpoint, task.device, task.longer_side)
        assert not isinstance(peer, str)
        maps = peer(shown_picture(scene, at), task).within(scene.valid)
        # Lights that fit the maps best, for the error of the pictures; materials stay.
        way = Way(way.words, {"iterations": 0, "priors": None}, lambda _: maps)
    return {**measured(task, way, scene, threads)[1], "picture": at}


def given(task: Case, threads: int = 0) -> Scene:
    """A scene as every method has it: noisy pictures, and normals of an estimator's quality."""
    if task.condition == "own":
        exact = task.drawn(noise=NOISE)
    else:
        exact = table1.cycles_scene(task, ROWS["cycles-panorama"], threads)
        noise = np.random.default_rng(task.seed).normal(scale=NOISE, size=exact.images.shape)
        exact = replace(exact, depth=None, images=exact.images + noise)
    return replace(exact, normals=estimated_normals(exact, task.seed))


def evenly_lit(scene: Scene) -> int:
    """The picture that a peer is shown: the one whose darkest tenth is brightest beside its white.

    Hard to read pictures, with much in the dark, would make peers worse than they are.
    """

    def evenness(image: Floats) -> float:
        grey = image.mean(axis=-1)[scene.valid]
        return float(np.percentile(grey, 10) / max(np.percentile(grey, 98), 1e-12))

    return int(np.argmax([evenness(image) for image in scene.images]))


def shown_picture(scene: Scene, picture: int) -> NDArray[np.uint8]:
    """(H, W, 3) sRGB of 8 bits, exposed so that the 98th percentile is white."""
    image = np.where(np.isfinite(scene.images[picture]), scene.images[picture], 0.0)
    white = metrics.white_of(image[scene.valid])
    return codes(encoded(image / white))


def why_not(options: Options, condition: str, way: str) -> str:
    """Why a method cannot run, such as for packages or weights that are missing; empty if it can.

    A peer is loaded to find out, and stays for `work` in this process.
    """
    lacks = "--quick leaves Cycles out" if options.quick else cycles.why_not()
    if condition == "cycles" and lacks:
        return lacks
    if way not in PEERS:
        return ""
    peer = _loaded(way, getattr(options, way), options.device, options.longer_side)
    return peer if isinstance(peer, str) else ""


def sized(options: Options, condition: str) -> tuple[int, int]:
    """Scenes, and the side of their pictures."""
    if condition == "cycles":
        return options.cycles_scenes, options.cycles_size
    return options.scenes, options.size


GRID = Grid(
    {"own": "our renders", "cycles": "rooms by Cycles"},
    WAYS,
    pictured=tuple(WAYS),
    why_not=why_not,
    sized=sized,
)


@cache
def _loaded(method: str, model: str | None, device: str, longer_side: int) -> Peer | str:
    """Load a peer once a process; the message, where that fails: it would fail again."""
    assert model is not None
    try:
        if method == "marigold":
            from pbrfit.acquire.marigold import MarigoldIID

            marigold = MarigoldIID(model, device=device)
            return lambda picture, task: marigold.maps(
                picture, seed=task.seed, samples=task.samples, steps=task.steps
            )
        from pbrfit_evaluation.peers.rgbx import RgbToX

        rgbx = RgbToX(model, device=device, longer_side=longer_side)
        return lambda picture, task: rgbx.maps(picture, seed=task.seed, steps=task.steps)
    except InputError as error:
        return str(error)


def cases(options: Options) -> list[Task]:
    """Every scene by every method that can run."""
    return [
        Task(
            **vars(case),
            **{
                name: getattr(options, name)
                for name in ("samples", "steps", "longer_side", "device")
            },
            checkpoint=getattr(options, case.way, None),
        )
        for case in GRID.cases(options)
    ]
