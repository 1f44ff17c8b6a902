"""An exported .glb in Blender: what it becomes there, and how Cycles renders it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit import Materials, Result, decompose
from pbrfit.model import panorama
from pbrfit.synthetic import make_scene
from pbrfit_evaluation.cycles.process import find_python, run_worker

WORKER = Path(__file__).with_name("blender_worker.py")

TURN = -90.0
"""What docs/export.md tells users to turn the world by, in degrees about Z."""


@dataclass(frozen=True)
class Rendering:
    """A render of the card under a panorama, turned about Z by so many degrees, or mirrored.

    `distribution` is that of the Principled BSDF, for which `diffuse` puts a Diffuse BSDF of the
    base colour. The normal texture is left out (`flat`) or read in the other convention
    (`flip_green`).
    """

    name: str
    panorama: Path
    turn: float = TURN
    scale: tuple[int, int, int] = (1, 1, 1)
    distribution: str = "MULTI_GGX"
    diffuse: bool = False
    flip_green: bool = False
    flat: bool = False
    samples: int = 256


@dataclass(frozen=True)
class InBlender:
    """What feeds the surface; what Blender sees at the pixels; pictures (H, W, 4) by name."""

    facts: dict[str, Any]
    seen: dict[str, NDArray[np.float32]]
    pictures: dict[str, NDArray[np.float32]]


def in_blender(
    folder: Path,
    glb: Path,
    size: tuple[int, int],
    renderings: Sequence[Rendering],
    *,
    camera_only: bool = False,
    timeout: float = 300,
) -> InBlender:
    """Import `glb` and render it at `size` (width, height); `folder` is for the files exchanged.

    With `camera_only` no rays but the camera's meet it, as docs/export.md wants for facets.
    """
    folder.mkdir()
    job = {
        "glb": str(glb),
        "size": size[0],
        "height": size[1],
        "threads": 2,
        "seed": 1,
        "bounces": dict.fromkeys(("all", "diffuse", "glossy"), 0),
        "camera_only": camera_only,
        "renders": [asdict(of) | {"panorama": str(of.panorama)} for of in renderings],
    }
    (folder / "job.json").write_text(json.dumps(job), encoding="utf-8")
    run_worker(find_python(), folder, timeout, worker=WORKER)
    facts = json.loads((folder / "facts.json").read_text(encoding="utf-8"))
    pictures = {of.name: np.load(folder / f"{of.name}.npy") for of in renderings}
    with np.load(folder / "seen.npz") as seen:
        return InBlender(facts, dict(seen), pictures)


def to_camera_space(vectors: NDArray[Any]) -> NDArray[Any]:
    """From Blender's axes, Z up, to ours and glTF's, Y up: (x, y, z) -> (x, z, −y)."""
    return np.stack([vectors[..., 0], vectors[..., 2], -vectors[..., 1]], axis=-1)


def relief(height: int, width: int, fov: float = 45.0, tilt: float = 12.0) -> Result:
    """A tiled wall with metal studs: normals lean by up to `tilt` degrees, a corner is masked."""
    y, x = np.mgrid[:height, :width] / width
    tile = (np.floor(x * 6) + np.floor(y * 6)) % 3
    colors = np.array([[0.75, 0.3, 0.15], [0.2, 0.5, 0.65], [0.8, 0.75, 0.6]])
    albedo = colors[tile.astype(int)] * (0.8 + 0.2 * np.sin(40 * x))[..., None]
    studs = np.hypot((x * 6) % 1 - 0.5, (y * 6) % 1 - 0.5) < 0.3
    albedo = np.where(studs[..., None], 0.5 + 0.5 * albedo, albedo)
    slope = np.tan(np.radians(tilt)) / np.sqrt(2)
    down, right = slope * np.sin(2 * np.pi * 3 * y + 1), slope * np.cos(2 * np.pi * 3 * x + y)
    normals = np.stack([right, down, np.ones_like(x)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    mask = np.hypot(x, y) > 0.12
    materials = Materials(albedo, 0.3 + 0.5 * x, studs.astype(float))
    return planted(materials, normals, mask, fov=fov, lighting=lopsided_lights())


def planted(
    materials: Materials, normals: NDArray[np.float64], mask: NDArray[np.bool_], **more: Any
) -> Result:
    """A result of these maps, which become NaN outside the mask."""
    for values in (materials.albedo, materials.roughness, materials.metallic, normals):
        values[~mask] = np.nan
    like = decompose(make_scene("room", size=8, lights=3, held_out=1), iterations=1)
    return replace(like, materials=materials, normals=normals, mask=mask, uncertainty=None, **more)


def lopsided_lights() -> NDArray[np.float64]:
    """Three lights, (3, 16, 3), nowhere negative and from all sides different."""
    random = np.random.default_rng(5)
    lights = random.normal(size=(3, 16, 3))
    lights[:, 0] = 2.0
    return np.stack([panorama.nonnegative(light) for light in lights])
