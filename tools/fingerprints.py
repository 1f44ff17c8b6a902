"""Hashes of what fits give, to the last bit: made once, compared after every change of the code.

    python tools/fingerprints.py                 compare, with one and with two threads
    python tools/fingerprints.py --write         make them anew, when results are meant to change
    python tools/fingerprints.py --cases tiled   only the cases whose names have this in them

Each case is a small scene and the options of a fit. Its fingerprint is the sha256 of
`materials.exr` (which holds the uncertainties too), of `lighting.json`, and of loss and gradient of
the objective at its start. They hold for one set of vector instructions and one version of numpy
and scipy, which stand beside them; on another machine there is nothing to compare.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import platform
import sys
import tempfile
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import scipy

import pbrfit
from pbrfit import Priors, Scene
from pbrfit.synthetic import make_scene

FILE = Path(__file__).resolve().parent.parent / "tests/data/fingerprints.json"

THREADS = (1, 2)


@dataclass(frozen=True)
class Case:
    """A scene, and how it is fitted."""

    scene: Callable[[], Scene]
    options: dict[str, Any] = field(default_factory=dict)
    tiled: bool = False


def room(**changes: Any) -> Scene:
    """A small room; `changes` to `make_scene`."""
    return make_scene("room", **{"size": 24, "lights": 8, "held_out": 1, "seed": 3, **changes})


def grey() -> Scene:
    """Pictures of which all channels are equal."""
    scene = room(noise=0.01)
    images = np.repeat(scene.images.mean(axis=-1, keepdims=True), 3, axis=-1)
    return replace(scene, images=images, truth=None)


def masked() -> Scene:
    """A disc."""
    scene = room(noise=0.01)
    y, x = np.mgrid[-1:1:24j, -1:1:24j]
    return replace(scene, mask=x**2 + y**2 < 0.9, truth=None)


def weighted() -> Scene:
    """Samples of weight 0, a quarter and 1."""
    scene = room(noise=0.01)
    weights = np.random.default_rng(0).choice([0.0, 0.25, 1.0], scene.images.shape[:3])
    return replace(scene, weights=weights, truth=None)


def float32() -> Scene:
    """Pictures as files have them."""
    scene = room(noise=0.01)
    return replace(scene, images=scene.images.astype(np.float32))


def known_lights() -> Scene:
    """Lights that are given."""
    scene = room(noise=0.01)
    assert scene.truth is not None
    return replace(scene, lighting=scene.truth.lighting)


def wrong_normals() -> Scene:
    """Normals that are off by 6 degrees, smoothly."""
    scene = room(noise=0.005, size=32, lights=12)
    y, x = np.mgrid[0:3:32j, 0:3:32j]
    off = 0.1 * np.stack([np.sin(x + y), np.cos(2 * x - y), np.zeros_like(x)], axis=-1)
    return replace(scene, normals=scene.normals + off, truth=None)


def wrong_fov() -> Scene:
    """A field of view that no material explains."""
    return replace(room(), fov=90.0, truth=None)


CASES = {
    "paper exact": Case(room),
    "paper noise": Case(partial(room, noise=0.01)),
    "paper float32": Case(float32),
    "paper 3 pictures": Case(partial(room, lights=3, noise=0.01)),
    "paper 16 pictures": Case(partial(room, lights=16, noise=0.01, size=20)),
    "paper spheres": Case(lambda: make_scene("spheres", size=24, lights=6, held_out=1, seed=1)),
    "paper textured": Case(
        lambda: make_scene("textured", size=24, lights=8, held_out=1, noise=0.01, seed=2)
    ),
    "paper lbfgsb": Case(partial(room, noise=0.01), {"solver": "lbfgsb", "iterations": 60}),
    "paper lbfgsb without priors": Case(
        room, {"solver": "lbfgsb", "iterations": 60, "priors": Priors.none()}
    ),
    "paper order 2": Case(partial(room, noise=0.01), {"sh_order": 2}),
    "paper pictures of order 2": Case(partial(room, sh_order=2), {"sh_order": 2}),
    "paper metallic 0": Case(partial(room, noise=0.01), {"metallic": 0.0}),
    "paper mono light": Case(partial(room, noise=0.01), {"mono_light": True}),
    "paper grey": Case(grey),
    "paper masked": Case(masked),
    "paper weighted": Case(weighted),
    "paper equal exposures": Case(partial(room, noise=0.01), {"equal_exposures": True}),
    "paper without priors": Case(partial(room, noise=0.01), {"priors": Priors.none()}),
    "paper cohesion": Case(
        partial(room, noise=0.01), {"solver": "lbfgsb", "priors": Priors(0.0, cohesion=0.01)}
    ),
    "paper smoothness": Case(
        partial(room, noise=0.01), {"solver": "lbfgsb", "priors": Priors(0.0, smoothness=0.01)}
    ),
    "paper sparsity": Case(
        partial(room, noise=0.01), {"solver": "lbfgsb", "priors": Priors(0.0, sparsity=0.01)}
    ),
    "paper monochrome": Case(partial(room, noise=0.01), {"priors": Priors(monochrome=0.01)}),
    "paper known lights": Case(known_lights),
    "paper wrong field of view": Case(wrong_fov, {"iterations": 60, "refine_normals": "off"}),
    "paper normals refined": Case(wrong_normals, {"refine_normals": "on", "iterations": 40}),
    "paper tiled": Case(partial(room, size=72, noise=0.01), {"refine_normals": "off"}, tiled=True),
    "paper tiled both priors": Case(
        partial(room, size=72, noise=0.01),
        {
            "refine_normals": "off",
            "priors": Priors(1.0, monochrome=0.001),
            "iterations": 40,
        },
        tiled=True,
    ),
    "principled exact": Case(partial(room, model="principled")),
    "principled noise": Case(partial(room, model="principled", noise=0.01)),
    "principled lbfgsb": Case(
        partial(room, model="principled", noise=0.01), {"solver": "lbfgsb", "iterations": 40}
    ),
    "principled order 2": Case(partial(room, model="principled", noise=0.01), {"sh_order": 2}),
    "principled normals refined": Case(
        lambda: replace(wrong_normals(), model="principled"),
        {"refine_normals": "on", "iterations": 30},
    ),
    "principled tiled": Case(
        partial(room, size=72, noise=0.01, model="principled"),
        {"refine_normals": "off"},
        tiled=True,
    ),
}


def in_tiles() -> AbstractContextManager[object]:
    """Every picture is a large one: a subset of every second pixel, then tiles of 30."""
    from contextlib import ExitStack

    from pbrfit.fit import decompose as decompose_module
    from pbrfit.fit import settings
    from pbrfit.fit.tiles import fit_tiles

    stack = ExitStack()
    stack.enter_context(mock.patch.object(settings, "WHOLE_PIXELS_MAX", 0))
    stack.enter_context(
        mock.patch.object(
            decompose_module, "fit_tiles", partial(fit_tiles, subset_pixels=1296, side=30)
        )
    )
    return stack


def fingerprint(case: Case, threads: int) -> dict[str, str]:
    """Hashes of one fit."""
    scene = case.scene()
    chosen = {
        name: case.options[name]
        for name in ("sh_order", "metallic", "mono_light", "priors", "equal_exposures")
        if name in case.options
    }
    objective = pbrfit.Objective(scene, threads=threads, **chosen)
    loss, gradient = objective.value_and_grad(objective.start())
    with in_tiles() if case.tiled else nullcontext():
        result = pbrfit.decompose(scene, threads=threads, **case.options)
    with tempfile.TemporaryDirectory() as folder:
        result.save(Path(folder) / "result")
        files = {
            name: (Path(folder) / "result" / name).read_bytes()
            for name in ("materials.exr", "lighting.json")
        }
    files["objective"] = np.float64(loss).tobytes() + gradient.tobytes()
    return {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}


def machine() -> dict[str, str]:
    """What the bits depend on beside the code."""
    flags = ""
    if Path("/proc/cpuinfo").exists():
        text = Path("/proc/cpuinfo").read_text()
        flags = next((x for x in ("avx512f", "avx2") if f" {x}" in text), "")
    return {
        "processor": f"{platform.machine()} {flags}".strip(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
    }


def main() -> int:
    """Make or compare; 1 if a bit has changed."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--cases", default="")
    options = parser.parse_args()
    found = {}
    chosen = {name: case for name, case in CASES.items() if options.cases in name}
    known = json.loads(FILE.read_text()) if FILE.exists() and not options.write else None
    if known is not None and known["machine"] != machine():
        print(f"made on {known['machine']}, this is {machine()}: not comparable")
    failed = 0
    for name, case in chosen.items():
        each = [fingerprint(case, threads) for threads in THREADS]
        found[name] = each[0]
        verdict = "same"
        if any(other != each[0] for other in each[1:]):
            verdict = "DIFFERS BY THREADS"
        elif known is not None and known["cases"].get(name) != each[0]:
            expected = known["cases"].get(name, {})
            verdict = "CHANGED: " + ", ".join(
                file for file, value in each[0].items() if expected.get(file) != value
            )
        failed += verdict != "same"
        print(f"{name:<32} {verdict}", flush=True)
    if options.write:
        FILE.write_text(json.dumps({"machine": machine(), "cases": found}, indent=1) + "\n")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
