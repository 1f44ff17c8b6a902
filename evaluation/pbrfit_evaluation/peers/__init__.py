"""Networks that find materials in one picture, beside our fit of all pictures.

A peer is not given what the fit is given: it sees one picture and neither normals nor other light.
What it has instead is what it learnt. So this is no race; it says what several pictures are worth.
The pictures have noise, and normals are as an estimator gives them: from exact input the fit would
recover scenes of its own model to the last digit, and nothing would have been compared.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.fit.decompose import decompose
from pbrfit.result import metrics
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import make_scene
from pbrfit_evaluation.peers.pictures import draw_panels
from pbrfit_evaluation.recipes import explain
from pbrfit_evaluation.scores import score
from pbrfit_evaluation.table1.normals import disturbed

Method = Literal["pbrfit", "constant", "marigold", "rgbx"]
METHODS: tuple[Method, ...] = get_args(Method)
PEERS: tuple[Method, ...] = ("marigold", "rgbx")

IN_WORDS: dict[Method, str] = {
    "pbrfit": "pbrfit, all pictures",
    "constant": "constant guess",
    "marigold": "Marigold-IID, one picture",
    "rgbx": "RGB-X, one picture",
}

NOISE = 0.01
"""Standard deviation, in radiance; the pictures' mean is 0.4."""

FIRST_SEED = 6000
"""Of the first scene; nothing was tuned on seeds from there on."""


@dataclass(frozen=True)
class Effort:
    """How much is done.

    Attributes
    ----------
    name
        In reports.
    scenes, kind
        How many synthetic scenes, and of which kind.
    size, lights
        Side of the pictures in pixels; their number, and as many held out.
    iterations
        Of our fit.
    samples
        Predictions of Marigold-IID that are combined.
    steps
        Of the peers' samplers; None = as their authors recommend.
    longer_side
        Of what RGB-X is shown, in pixels.
    shown
        Scenes that are shown in pictures.
    """

    name: str
    scenes: int = 10
    kind: str = "furnished"
    size: int = 256
    lights: int = 16
    iterations: int = 500
    samples: int = 5
    steps: int | None = None
    longer_side: int = 1000
    shown: int = 3


FULL = Effort("full")
QUICK = Effort(
    "quick",
    scenes=2,
    size=64,
    lights=8,
    iterations=60,
    samples=1,
    steps=4,
    longer_side=256,
    shown=2,
)


@dataclass(frozen=True)
class Task:
    """A scene by a method. `model` and `device` are those of a peer."""

    method: Method
    seed: int
    effort: Effort
    model: str | None = None
    device: str = field(default="auto", repr=False)

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"{self.method}_{self.seed}"


def plan(
    effort: Effort, models: Mapping[Method, str], device: str = "auto"
) -> dict[Method, list[Task]]:
    """Tasks by method; `models` has the peers' checkpoints."""
    return {
        method: [
            Task(method, FIRST_SEED + i, effort, models.get(method), device)
            for i in range(effort.scenes)
        ]
        for method in METHODS
    }


def work(task: Task, threads: int) -> dict[str, Any]:
    """Errors of a method on a scene, and pictures of the first few.

    Raises
    ------
    InputError
        If a peer cannot run; it says why.
    """
    effort = task.effort
    peer = _opened(task, threads)  # first: it may not be there
    scene = given(effort, task.seed)
    at = evenly_lit(scene)
    if task.method == "pbrfit":
        # As people run it: the normals are those of an estimator, and may be refined.
        result = explain(
            scene,
            "default",
            iterations=effort.iterations,
            refine_normals="auto",
            threads=threads,
        )
    elif task.method == "constant":
        result = explain(scene, "constant", threads=threads)
    else:
        maps = peer(shown_picture(scene, at), task.seed, effort)
        # Lights that fit the maps best, for the error of the pictures; materials stay.
        result = decompose(
            scene,
            iterations=0,
            start=maps.materials(scene.valid),
            priors=None,
            refine_normals="off",
            threads=threads,
        )
    found: dict[str, Any] = {"scores": score(result, scene, threads).as_json(), "picture": at}
    if task.seed < FIRST_SEED + effort.shown:
        panels = draw_panels(scene, result, at, threads)
        found["panels"] = {
            name: base64.b64encode(png).decode("ascii") for name, png in panels.items()
        }
    return found


def given(effort: Effort, seed: int) -> Scene:
    """A scene as every method has it: noisy pictures, and normals of an estimator's quality."""
    exact = make_scene(
        effort.kind,
        size=effort.size,
        lights=effort.lights,
        held_out=effort.lights,
        noise=NOISE,
        seed=seed,
    )
    assert exact.segments is not None
    # A stream of its own, apart from those of the scene.
    rng = np.random.default_rng([seed, 1])
    return replace(exact, normals=disturbed(exact.normals, exact.views, exact.segments, rng))


def evenly_lit(scene: Scene) -> int:
    """The picture that a peer is shown: the one whose darkest tenth is brightest beside its white.

    Hard to read pictures, with much in the dark, would make peers worse than they are.
    """

    def evenness(image: NDArray[np.floating[Any]]) -> float:
        grey = image.mean(axis=-1)[scene.valid]
        return float(np.percentile(grey, 10) / max(np.percentile(grey, 98), 1e-12))

    return int(np.argmax([evenness(image) for image in scene.images]))


def shown_picture(scene: Scene, picture: int) -> NDArray[np.uint8]:
    """(H, W, 3) sRGB of 8 bits, exposed so that the 98th percentile is white."""
    image = np.where(np.isfinite(scene.images[picture]), scene.images[picture], 0.0)
    white = metrics.white_of(image[scene.valid])
    return np.rint(255 * metrics.display(image, white)).astype(np.uint8)


def _opened(task: Task, threads: int) -> Any:
    """A peer as a function of picture, seed and effort; None for what is none."""
    if task.method not in PEERS:
        return None
    assert task.model is not None
    peer = _loaded(task.method, task.model, task.device, task.effort.longer_side, threads)
    if isinstance(peer, str):
        raise InputError(peer)
    return peer


@cache
def _loaded(method: Method, model: str, device: str, longer_side: int, threads: int) -> Any:
    """Load a peer once a process; the message, where that fails: it would fail again."""
    try:
        if method == "marigold":
            from pbrfit_evaluation.peers.marigold import Marigold

            marigold = Marigold(model, device=device)
            _use_threads(threads)
            return lambda picture, seed, effort: marigold.maps(
                picture, seed=seed, samples=effort.samples, steps=effort.steps
            )
        from pbrfit_evaluation.peers.rgbx import RgbToX

        rgbx = RgbToX(model, device=device, longer_side=longer_side)
        _use_threads(threads)
        return lambda picture, seed, effort: rgbx.maps(picture, seed=seed, steps=effort.steps)
    except InputError as error:
        return str(error)


def _use_threads(threads: int) -> None:
    """PyTorch would take the one thread that tasks leave to BLAS."""
    import torch

    torch.set_num_threads(threads)
