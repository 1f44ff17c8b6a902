"""An export opened in Blender, and rendered under panorama light."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pbrfit_evaluation.arrays import Array
from pbrfit_evaluation.cycles.process import find_python, run_worker

WORKER = Path(__file__).with_name("opened.py")

TURN = -90.0
"""Degrees about Z by which docs/export.md tells users to turn the world."""


def rendered_export(
    folder: Path,
    glb: Path,
    size: int,
    panoramas: Sequence[Path],
    *,
    samples: int = 256,
) -> Array:
    """Pictures (M, size, size, 3), linear Rec.709, of an exported square scene, `material.glb`.

    Under panoramas, EXR files as `pbrfit export` writes them, with so many light paths a pixel.
    `folder` is for the files exchanged, and made here. Raises CyclesNotFoundError if there is no
    Python with bpy, CyclesError if the renderer fails.
    """
    folder.mkdir()
    job = {
        "glb": str(glb),
        "size": size,
        "threads": 1,
        "seed": 1,
        "bounces": dict.fromkeys(("all", "diffuse", "glossy"), 0),
        "panoramas": [str(path) for path in panoramas],
        "samples": samples,
        "turn": TURN,
    }
    (folder / "job.json").write_text(json.dumps(job), encoding="utf-8")
    run_worker(find_python(), folder, 600.0, worker=WORKER)
    pictures = [np.load(folder / f"{number}.npy") for number in range(len(panoramas))]
    return np.stack(pictures)[..., :3].astype(np.float64)
