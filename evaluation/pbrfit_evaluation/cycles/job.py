"""A render as a job: what is asked for, its key, and the cache that keeps answers between runs."""

from __future__ import annotations

import hashlib
import json
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io.output import new_folder
from pbrfit.values.checks import one_of
from pbrfit_evaluation.arrays import Array
from pbrfit_evaluation.cycles.export import Stage
from pbrfit_evaluation.cycles.process import (
    WORKER,
    CyclesError,
    blender_version,
    find_python,
    run_worker,
)

Transport = Literal["brdf", "shadows", "full"]
Distribution = Literal["GGX", "MULTI_GGX"]
_RESULTS = ("radiance.npy", "truth.npz", "outcome.json")

Terms = list[tuple[float, tuple[int, int, int]]]


def basis_polynomials() -> list[Terms]:
    """The 16 functions of `kernel.sh_basis` as polynomials of a unit vector (x, y, z).

    For each its terms: a factor and the powers of x, y and z. On the unit sphere z² = 1 - x² - y²
    leaves a choice; here every polynomial is homogeneous but for l = 2, 3 and m = 0, ±1, which use
    1.
    """
    scaled: list[tuple[int, int, Terms]] = [  # p, q and the terms' sum over √(p / qπ)
        (1, 4, [(1, (0, 0, 0))]),
        (3, 4, [(1, (0, 1, 0))]),
        (3, 4, [(1, (0, 0, 1))]),
        (3, 4, [(1, (1, 0, 0))]),
        (15, 4, [(1, (1, 1, 0))]),
        (15, 4, [(1, (0, 1, 1))]),
        (5, 16, [(3, (0, 0, 2)), (-1, (0, 0, 0))]),
        (15, 4, [(1, (1, 0, 1))]),
        (15, 16, [(1, (2, 0, 0)), (-1, (0, 2, 0))]),
        (35, 32, [(3, (2, 1, 0)), (-1, (0, 3, 0))]),
        (105, 16, [(2, (1, 1, 1))]),
        (21, 32, [(5, (0, 1, 2)), (-1, (0, 1, 0))]),
        (7, 16, [(5, (0, 0, 3)), (-3, (0, 0, 1))]),
        (21, 32, [(5, (1, 0, 2)), (-1, (1, 0, 0))]),
        (105, 16, [(1, (2, 0, 1)), (-1, (0, 2, 1))]),
        (35, 32, [(1, (3, 0, 0)), (-3, (1, 2, 0))]),
    ]
    return [
        [(float(np.sqrt(p / (q * np.pi)) * factor), powers) for factor, powers in terms]
        for p, q, terms in scaled
    ]


@dataclass(frozen=True, eq=False)
class Job:
    """One render."""

    stage: Stage
    positions: Array | None
    """(K, 3) of white point lights in camera space; None = the 16 SH basis functions, signed, as
    panoramas."""
    transport: Transport
    """"brdf": every surface receives all light that its own hemisphere sends. "shadows": less what
    other surfaces block. "full": and what they reflect."""
    samples: int
    """Light paths a pixel and picture."""
    seed: int = 0
    specular: float = 0.5
    """Principled's "Specular IOR Level"; 0.5 is F0 = 0.04 at an index of 1.5."""
    distribution: Distribution = "MULTI_GGX"
    """Principled's. "GGX": light that leaves a facet towards another is lost. "MULTI_GGX",
    Blender's default: the lobe is scaled up by it."""

    def __post_init__(self) -> None:
        one_of("transport", self.transport, Transport)
        one_of("distribution", self.distribution, Distribution)
        if not 1 <= self.samples < 2**24:
            raise InputError(f"samples: expected a number from 1, found {self.samples}")
        if not 0 <= self.seed < 2**31:
            raise InputError(f"seed: expected a number from 0 to 2^31 - 1, found {self.seed}")

    def description(self) -> dict[str, Any]:
        """Return what `job.json` says, but for the number of threads."""
        reach = max(float(np.abs(mesh.vertices).max()) for mesh in self.stage.meshes)
        bounces = (12, 4, 4) if self.transport == "full" else (0, 0, 0)  # between surfaces
        light = (
            {"kind": "harmonics", "basis": basis_polynomials(), "distance": 10.0 * reach}
            if self.positions is None
            else {"kind": "points", "positions": self.positions.tolist()}
        )
        return {
            "size": self.stage.size,
            "fov": self.stage.fov,
            "meshes": [
                {
                    "varies": mesh.varies,
                    "blocks_light": mesh.blocks_light,
                    "albedo": mesh.albedo[0].tolist(),
                    "roughness": float(mesh.roughness[0]),
                    "metallic": float(mesh.metallic[0]),
                }
                for mesh in self.stage.meshes
            ],
            "maps": list(self.stage.maps),
            "light": light,
            "transport": self.transport,
            "bounces": dict(zip(("all", "diffuse", "glossy"), bounces, strict=True)),
            "samples": self.samples,
            "seed": self.seed,
            "specular": self.specular,
            "distribution": self.distribution,
        }

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return what `arrays.npz` holds: float32, indices int32."""
        found: dict[str, NDArray[Any]] = {
            f"map.{name}": values for name, values in self.stage.maps.items()
        }
        for i, mesh in enumerate(self.stage.meshes):
            found[f"{i}.vertices"] = mesh.vertices.astype(np.float32)
            found[f"{i}.normals"] = mesh.normals.astype(np.float32)
            found[f"{i}.triangles"] = mesh.triangles
            if mesh.varies:
                columns = (mesh.albedo, mesh.roughness[:, None], mesh.metallic[:, None])
                found[f"{i}.material"] = np.concatenate(columns, axis=1).astype(np.float32)
        return found

    def key(self, blender: str) -> str:
        """Hash of all that decides about the pixels, the worker's own source included."""
        digest = hashlib.sha256()
        digest.update(blender.encode())
        digest.update(WORKER.read_bytes())
        digest.update(json.dumps(self.description(), sort_keys=True).encode())
        for name, values in sorted(self.arrays().items()):
            digest.update(f"{name} {values.dtype} {values.shape}".encode())
            digest.update(np.ascontiguousarray(values).tobytes())
        return digest.hexdigest()[:32]


@dataclass(frozen=True, eq=False)
class Rendered:
    """What came back."""

    radiance: NDArray[np.float32]
    """(K, H, W, 3) float32, linear Rec.709: under each basis function, or each white point light of
    radiant intensity such that a white diffuse surface facing it at 1 m has radiance 1."""
    albedo: NDArray[np.float32]
    roughness: NDArray[np.float32]
    metallic: NDArray[np.float32]
    normals: NDArray[np.float32]
    positions: NDArray[np.float32]
    """`albedo`, `roughness`, `metallic`, `normals` and `positions`: (H, W, ...) float32 at the
    pixels' centres, normals and positions in camera space."""
    segments: NDArray[np.uint16]
    """(H, W) object ids from 1, 0 where nothing is."""
    cpu_seconds: float
    """What building and rendering took of all processors, when it was rendered."""


def default_cache() -> Path:
    """Folder for renders in the user's cache: $XDG_CACHE_HOME, ~/.cache or %LOCALAPPDATA%."""
    home = os.environ.get("LOCALAPPDATA" if sys.platform == "win32" else "XDG_CACHE_HOME")
    return (Path(home) if home else Path.home() / ".cache") / "pbrfit" / "cycles"


def rendered(
    job: Job, *, cache: Path | None = None, threads: int = 2, timeout: float = 3600.0
) -> Rendered:
    """Take a render from the cache, a folder each, or make it and keep it there.

    None = `default_cache`. The result does not depend on `threads`; after `timeout` seconds the
    renderer is stopped. Raises CyclesNotFoundError if there is no Python with bpy, which even a
    cached render needs, for its version is part of the key; CyclesError if the renderer fails.
    Nothing is left in the cache then.
    """
    python = find_python()
    folder = (cache or default_cache()) / job.key(blender_version(python))
    if not folder.is_dir():
        try:
            with new_folder(folder) as temporary:
                _render(job, python, temporary, threads, timeout)
        except FileExistsError:  # another process was faster, with the same pixels
            if not folder.is_dir():
                raise
    return _read(folder)


def _render(job: Job, python: Path, folder: Path, threads: int, timeout: float) -> None:
    description = job.description() | {"threads": threads}
    (folder / "job.json").write_text(json.dumps(description), encoding="utf-8")
    np.savez(folder / "arrays.npz", allow_pickle=False, **job.arrays())
    run_worker(python, folder, timeout)
    for name in _RESULTS:
        if not (folder / name).is_file():
            raise CyclesError(f"Cycles: expected {name} from the renderer, found none")
    if not np.isfinite(np.load(folder / "radiance.npy")).all():
        raise CyclesError("Cycles: expected finite radiance, found NaN or infinity")
    (folder / "arrays.npz").unlink()  # ten times larger than the pictures


def _read(folder: Path) -> Rendered:
    outcome = json.loads((folder / "outcome.json").read_text(encoding="utf-8"))
    with np.load(folder / "truth.npz") as truth:
        return Rendered(
            radiance=np.load(folder / "radiance.npy"),
            cpu_seconds=outcome["cpu_seconds"],
            **truth,
        )
