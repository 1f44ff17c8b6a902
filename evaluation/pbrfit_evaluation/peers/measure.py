"""A scene by a method: our fit, a guess, or a network that sees one picture."""

from __future__ import annotations

import base64
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.fit.decompose import decompose
from pbrfit.model.materials import Materials
from pbrfit.result import metrics
from pbrfit.result.preview import preview
from pbrfit.result.sheet import as_png
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import make_scene
from pbrfit_evaluation import cycles
from pbrfit_evaluation.recipes import explain, within
from pbrfit_evaluation.scores import score
from pbrfit_evaluation.suite import Options
from pbrfit_evaluation.table1 import measure as table1
from pbrfit_evaluation.table1.normals import estimated
from pbrfit_evaluation.table1.rows import BY_KEY as ROWS
from pbrfit_evaluation.table1.rows import Renderer

Method = Literal["pbrfit", "constant", "marigold", "rgbx"]
METHODS: tuple[Method, ...] = get_args(Method)
PEERS: tuple[Method, ...] = ("marigold", "rgbx")

NOISE = 0.01
"""Standard deviation, in radiance; the pictures' mean is 0.4."""


@dataclass(frozen=True)
class Task:
    """A furnished room by a method.

    Attributes
    ----------
    lights
        Pictures of the scene; as many are held out.
    iterations
        Of our fit.
    samples
        Predictions of Marigold-IID that are combined.
    steps
        Of the peers' samplers; None = as their authors recommend.
    longer_side
        Of what RGB-X is shown, in pixels.
    shown
        Whether to keep a sheet of the result.
    model, device
        Of a peer: its checkpoint, and where it computes.
    renderer
        Whose pictures: our forward model's, or those of Blender Cycles with shadows and bounces.
    cycles_cache
        Where its renders are kept.
    """

    method: Method
    seed: int
    size: int
    lights: int
    iterations: int
    samples: int
    steps: int | None
    longer_side: int
    shown: bool = False
    model: str | None = None
    device: str = field(default="auto", repr=False)
    renderer: Renderer = "own"
    cycles_cache: Path | None = field(default=None, repr=False)

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"{self.renderer}_{self.method}_{self.seed}"


Peer = Callable[[NDArray[np.uint8], Task], Materials]
"""Finds maps in a picture."""


def work(task: Task, threads: int) -> dict[str, Any]:
    """Errors of a method on a scene, and pictures of the first few."""
    scene = given(task, threads)
    at = evenly_lit(scene)
    if task.method in PEERS:
        import torch

        torch.set_num_threads(threads)  # else the one thread that tasks leave to BLAS
        peer = _loaded(task.method, task.model, task.device, task.longer_side)
        assert not isinstance(peer, str)
        # Lights that fit the maps best, for the error of the pictures; materials stay.
        result = decompose(
            scene,
            iterations=0,
            start=within(peer(shown_picture(scene, at), task), scene.valid),
            priors=None,
            refine_normals="off",
            threads=threads,
        )
    elif task.method == "constant":
        result = explain(scene, "constant", threads=threads)
    else:
        # As people run it: the normals are those of an estimator, and may be refined.
        result = explain(
            scene, "default", iterations=task.iterations, refine_normals="auto", threads=threads
        )
    found: dict[str, Any] = {"scores": score(result, scene, threads).as_json(), "picture": at}
    if task.shown:
        found["sheet"] = base64.b64encode(as_png(preview(result, scene))).decode("ascii")
    return found


def given(task: Task, threads: int = 0) -> Scene:
    """A scene as every method has it: noisy pictures, and normals of an estimator's quality."""
    lights, seed = task.lights, task.seed
    if task.renderer == "own":
        exact = make_scene(
            "furnished", size=task.size, lights=lights, held_out=lights, noise=NOISE, seed=seed
        )
    else:
        room = table1.Task(
            "cycles-panorama", seed, task.size, lights, 0, cycles_cache=task.cycles_cache
        )
        exact = table1.cycles_scene(room, ROWS["cycles-panorama"], threads)
        noise = np.random.default_rng(seed).normal(scale=NOISE, size=exact.images.shape)
        exact = replace(exact, depth=None, images=exact.images + noise)
    return replace(exact, normals=estimated(exact, seed))


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


def no_cycles(options: Options) -> str:
    """Why there are no rooms by Cycles; empty if there are."""
    return "--quick leaves Cycles out" if options.quick else cycles.why_not() or ""


def why_not(method: Method, options: Options) -> str:
    """Why a method cannot run, such as for packages or weights that are missing; empty if it can.

    A peer is loaded to find out, and stays for `work` in this process.
    """
    if method not in PEERS:
        return ""
    peer = _loaded(method, getattr(options, method), options.device, options.longer_side)
    return peer if isinstance(peer, str) else ""


@cache
def _loaded(method: Method, model: str | None, device: str, longer_side: int) -> Peer | str:
    """Load a peer once a process; the message, where that fails: it would fail again."""
    assert model is not None
    try:
        if method == "marigold":
            from pbrfit_evaluation.peers.marigold import Marigold

            marigold = Marigold(model, device=device)
            return lambda picture, task: marigold.maps(
                picture, seed=task.seed, samples=task.samples, steps=task.steps
            )
        from pbrfit_evaluation.peers.rgbx import RgbToX

        rgbx = RgbToX(model, device=device, longer_side=longer_side)
        return lambda picture, task: rgbx.maps(picture, seed=task.seed, steps=task.steps)
    except InputError as error:
        return str(error)
