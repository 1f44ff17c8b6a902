"""Render the scene of the moving lamp: a helmet under panoramas, by Cycles, with its truth.

    python tools/helmet_scene.py DATA [--out out/helmet] [--height 640] [--samples 64] [--turns 2]

DATA holds two folders: `gltf_FlightHelmet`, the glTF sample model FlightHelmet (Microsoft,
Khronos; CC0) without its archive, and `hdri`, panoramas in .hdr. Each panorama lights --turns
pictures. It is turned any way and softened, as if a diffuser stood before it: spherical
harmonics, which the fit takes light to be, have no sharp lamps. The pictures have all that a path
tracer has: shadows and light between surfaces. Normals are the true ones, with those of the
textures. The lenses are left out. Needs the environment of `make cycles-env`. The folder holds a
scene with `truth/`, against which

    pbrfit decompose out/helmet --out out/helmet-result --model principled

prints errors, and `tools/moving_lamp.py` draws the result.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pbrfit import Environment, Materials, Scene, Truth
from pbrfit.result.relit_files import write_exr
from pbrfit_evaluation.cycles.process import find_python, run_worker

ROOT = Path(__file__).resolve().parents[1]
WORKER = Path(__file__).with_name("helmet_in_cycles.py")

TURN = -35.0
"""Of the helmet about the vertical, in degrees: it looks to the left."""
CAMERA = (-0.016, 0.327, 1.75)
"""Metres; it looks along -Z. The helmet stands at (0, 0, 0) on y = 0 and is 0.72 high."""
FOV = 17.1
ASPECT = 0.65
"""Width over height."""
SOFTNESS = 25.0
"""Degrees; standard deviation of what softens the panoramas."""
BOUNCES = {"all": 8, "diffuse": 4, "glossy": 4}


def main() -> None:
    """Render and write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("data", metavar="DATA", type=Path)
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "helmet")
    parser.add_argument("--height", type=int, default=640, help="of the pictures, in pixels")
    parser.add_argument("--samples", type=int, default=64, help="a pixel, before denoising")
    parser.add_argument("--turns", type=int, default=2, help="pictures a panorama")
    parser.add_argument("--noisy", action="store_true", help="do not denoise")
    parser.add_argument("--depth", action="store_true", help="give the depth too")
    parser.add_argument("--overwrite", action="store_true")
    options = parser.parse_args()
    panoramas = sorted((options.data / "hdri").glob("*.hdr"))
    model = options.data / "gltf_FlightHelmet" / "FlightHelmet.gltf"
    job = {
        "model": str(model.absolute()),
        "without": ["Lenses"],
        "turn": TURN,
        "camera": CAMERA,
        "fov": FOV,
        "size": options.height,
        "height": options.height,
        "width": round(ASPECT * options.height),
        "samples": options.samples,
        "denoise": not options.noisy,
        "bounces": BOUNCES,
        "threads": 2,
        "seed": 0,
    }
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        lights = {}
        for at, path in enumerate(panoramas * options.turns):
            stem = path.stem.removesuffix("_1k")
            lights[f"{at:02d}_{stem}"] = light = folder / f"light_{at:02d}.exr"
            write_exr(light, softened(path, Rotation.random(rng=at)))
        job["lights"] = [str(light) for light in lights.values()]
        (folder / "job.json").write_text(json.dumps(job), encoding="utf-8")
        run_worker(find_python(), folder, 3600, worker=WORKER)
        seen = np.load(folder / "truth.npz")
        pictures = np.load(folder / "radiance.npy")
    length = np.linalg.norm(seen["normals"], axis=-1)
    mask = (seen["segments"] > 0) & (length > 0.5)
    maps = {key: np.where(mask, seen[key], np.nan) for key in ("roughness", "metallic")}
    albedo = np.where(mask[..., None], seen["albedo"].clip(0, 1), np.nan)
    scene = Scene(
        images=pictures,
        normals=seen["normals"],
        fov=FOV,
        mask=mask,
        names=tuple(lights),
        depth=np.where(mask, CAMERA[2] - seen["positions"][..., 2], 0) if options.depth else None,
        truth=Truth(Materials(albedo, **maps)),
    )
    scene.save(options.out, overwrite=options.overwrite)
    print(f"{options.out}: {len(lights)} pictures of {job['width']} × {job['height']}")


def softened(path: Path, turn: Rotation) -> NDArray[np.float32]:
    """A small panorama, (48, 96, 3), of mean 1: the one of the file, turned and blurred."""
    sharp = Environment.read(path).pixels
    rows, columns = sharp.shape[0] // 64, sharp.shape[1] // 128
    coarse = sharp.reshape(64, rows, 128, columns, 3).mean(axis=(1, 3)).reshape(-1, 3)
    source, solid = directions(64)
    seen, weights = directions(48)
    near = np.exp((turn.apply(seen) @ source.T - 1) / np.radians(SOFTNESS) ** 2) * solid
    blurred = near @ coarse / near.sum(axis=1, keepdims=True)
    return (blurred / np.average(blurred.mean(axis=1), weights=weights)).reshape(48, 96, 3)


def directions(height: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Of the pixels of a panorama whose centre is at -Z and whose top is +Y, and their size."""
    elevation = np.pi * (0.5 - (np.arange(height) + 0.5) / height)
    azimuth = np.pi * ((np.arange(2 * height) + 0.5) / height - 1)
    up, right = np.meshgrid(elevation, azimuth, indexing="ij")
    towards = [np.cos(up) * np.sin(right), np.sin(up), -np.cos(up) * np.cos(right)]
    return np.stack(towards, axis=-1).reshape(-1, 3), np.cos(up).ravel()


if __name__ == "__main__":
    main()
