"""An exported .glb in Blender: what it becomes there, and how Cycles renders it."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.synthetic.cycles.process import find_python

WORKER = Path(__file__).with_name("blender_worker.py")

TURN = -90.0
"""What docs/export.md tells users to turn the world by, in degrees about Z."""


@dataclass(frozen=True)
class Rendering:
    """A render of the card.

    Attributes
    ----------
    name
        Of the picture.
    panorama
        File of the light.
    turn
        Z rotation of the world's Mapping node, degrees.
    scale
        Scale of that node; −1 mirrors.
    distribution
        Of the Principled BSDF; "MULTI_GGX" is Blender's default.
    diffuse
        A Diffuse BSDF of the base colour instead.
    flip_green
        Normals as if the texture had the other convention.
    bump_correction
        Blender's option of that name, on by default: darkens light from behind the plane.
    samples
        A pixel.
    """

    name: str
    panorama: Path
    turn: float = TURN
    scale: tuple[int, int, int] = (1, 1, 1)
    distribution: str = "MULTI_GGX"
    diffuse: bool = False
    flip_green: bool = False
    bump_correction: bool = True
    samples: int = 256


@dataclass(frozen=True)
class InBlender:
    """What came back: `facts` and `seen` as the worker describes them; (H, W, 4) by name."""

    facts: dict[str, Any]
    seen: dict[str, NDArray[np.float32]]
    pictures: dict[str, NDArray[np.float32]]


def in_blender(
    folder: Path,
    glb: Path,
    size: tuple[int, int],
    renderings: Sequence[Rendering],
    timeout: float = 300,
) -> InBlender:
    """Import `glb` and render it at `size` (width, height); `folder` is for the files exchanged."""
    folder.mkdir()
    job = {
        "glb": str(glb),
        "size": size,
        "threads": 2,
        "renders": [asdict(of) | {"panorama": str(of.panorama)} for of in renderings],
    }
    (folder / "job.json").write_text(json.dumps(job), encoding="utf-8")
    ours = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "PYTHONWARNINGS")
    done = subprocess.run(
        [find_python(), WORKER, folder],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=timeout,
        env={name: value for name, value in os.environ.items() if name not in ours},
    )
    if done.returncode != 0:
        raise RuntimeError(f"Blender failed:\n{done.stderr[-2000:]}")
    with np.load(folder / "seen.npz") as seen:
        return InBlender(
            json.loads((folder / "facts.json").read_text(encoding="utf-8")),
            dict(seen),
            {of.name: np.load(folder / f"{of.name}.npy") for of in renderings},
        )


def to_camera_space(vectors: NDArray[Any]) -> NDArray[Any]:
    """From Blender's axes, Z up, to ours and glTF's, Y up: (x, y, z) -> (x, z, −y)."""
    return np.stack([vectors[..., 0], vectors[..., 2], -vectors[..., 1]], axis=-1)
