"""Decompose pictures that were not made with pbrfit's own model.

    python examples/real_pictures.py DATA --out DIR

turns two kinds of photometric stereo data into scene folders (docs/formats.md) and gives them to
the public command, `pbrfit decompose`:

- arrays: `*.npz` with `images` (N, H, W, 3), linear; `gt_normal.npy` (H, W, 3); `mask.png`;
- pictures: `NAME0.png`, `NAME1.png`, ...; `normal.png`; `mask.png`.

DATA is such a folder, or a folder that holds `bunny_ps` and `visiont3lab_shrek`. What comes out,
and what to think of it: docs/real-pictures.md.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

from pbrfit import InputError, Scene, images
from pbrfit.output import new_folder

SOURCES = {
    "bunny_ps": """\
    what     rendered bunny: 25 HDR pictures of a glossy material and 12 of a matt one, true normals
    from     github.com/yasumat/RobustPhotometricStereo
             commit f03aa95b57e746a7d31df76b1c0fa0a83584a3c1, data/bunny
    licence  GPL-3.0 (stated in its README)
    files    bunny_specular_25.npz, bunny_lambert_noshadow_12.npz: the .npy pictures of
             bunny_specular and bunny_lambert_noshadow as `images`, float32; gt_normal.npy; mask.png
""",
    "visiont3lab_shrek": """\
    what     rendered figure: 8 pictures under 8 lights, mask, estimated normals
    from     github.com/visiont3lab/photometric_stereo
             commit 9ded70dfbbe409dd2e0a2a6946c71c180d47a926, photostereo_py/samples/shrek.zip
    licence  MIT (stated in its README)
    files    shrek0.png ... shrek7.png, mask.png, normal.png: its .bmp files as PNG
""",
}

# The stored normals are not (n+1)/2: beside a least-squares fit of the eight known lights, v is
# SCALE n + OFFSET in each channel, with a residual of 0.005, as if stretched to fill [0, 1].
NORMAL_SCALE = np.array([0.559, 0.561, 0.555])
NORMAL_OFFSET = np.array([0.412, 0.412, 0.447])


def main() -> int:
    """Run the example; returns 0, or 2 if there was nothing to decompose."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("data", metavar="DATA", type=Path, help="folder of the data")
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="folder to write")
    parser.add_argument("--iterations", metavar="K", type=int, default=500)
    parser.add_argument("--max-size", metavar="PIXELS", type=int)
    parser.add_argument("--overwrite", action="store_true", help="replace what an earlier run left")
    options = parser.parse_args()

    scenes: list[Path] = []
    try:
        for folder in find_folders(options.data):
            scenes += write_scenes(folder, options.out, overwrite=options.overwrite)
    except (InputError, OSError) as error:
        print(f"real_pictures: {error}", file=sys.stderr)
        return 2
    for scene in scenes:
        result = scene.with_name("result")
        command = [sys.executable, "-m", "pbrfit", "decompose", str(scene), "--out", str(result)]
        command += ["--iterations", str(options.iterations)]
        if options.max_size is not None:
            command += ["--max-size", str(options.max_size)]
        if options.overwrite:
            command.append("--overwrite")
        print(f"\n$ pbrfit {' '.join(command[3:])}", flush=True)
        code = subprocess.run(command, check=False).returncode
        if code:
            return code
        print(f"preview: {result / 'preview.png'}")
    return 0 if scenes else 2


def find_folders(data: Path) -> list[Path]:
    """Find the data: `data` itself or known folders in it; say where absent ones come from."""
    if is_arrays(data) or is_pictures(data):
        return [data]
    present = [data / name for name in SOURCES if (data / name).is_dir()]
    for name, source in SOURCES.items():
        if data / name not in present:
            print(f"{data / name}: not there, left out. Where this data comes from:\n{source}")
    return present


def is_arrays(folder: Path) -> bool:
    """Whether the folder holds arrays and their normals."""
    return (folder / "gt_normal.npy").exists()


def is_pictures(folder: Path) -> bool:
    """Whether the folder holds numbered pictures and their normals."""
    return (folder / "normal.png").exists() and bool(numbered(folder))


def numbered(folder: Path) -> list[Path]:
    """Pictures whose names end in a digit."""
    return sorted(p for p in folder.glob("*.png") if re.search(r"\d$", p.stem))


def write_scenes(folder: Path, out: Path, *, overwrite: bool) -> list[Path]:
    """Write a scene folder for every set of pictures in `folder`; returns their paths."""
    mask = images.read_data(folder / "mask.png")[..., 0]
    if is_arrays(folder):
        normals = np.load(folder / "gt_normal.npy")
        valid = usable(mask >= 0.5, normals, folder)
        written = []
        for arrays in sorted(folder.glob("*.npz")):
            path = out / arrays.stem / "scene"
            pictures = np.load(arrays)["images"]
            Scene(images=pictures, normals=normals, fov=0.0, mask=valid).save(
                path, overwrite=overwrite
            )
            written.append(path)
        return written

    stored = images.read_data(folder / "normal.png")[..., :3]
    normals = (stored - NORMAL_OFFSET) / NORMAL_SCALE
    # Pixels on the outline are part figure, part background: only fully white ones, less a border.
    valid = usable(binary_erosion(mask == 1.0), normals, folder)
    path = out / folder.resolve().name / "scene"
    with new_folder(path, overwrite=overwrite) as scene:
        (scene / "images").mkdir()
        for picture in numbered(folder):
            shutil.copy(picture, scene / "images")
        images.write_exr(scene / "normals.exr", {n: normals[..., i] for i, n in enumerate("XYZ")})
        images.write_png(scene / "mask.png", np.where(valid, 255, 0).astype(np.uint8), srgb=False)
        # The camera is not known; whoever estimated the normals took it as orthographic.
        (scene / "scene.toml").write_text("fov = 0\n", encoding="utf-8")
    return [path]


def usable(mask: NDArray[np.bool_], normals: NDArray[Any], folder: Path) -> NDArray[np.bool_]:
    """Leave out pixels without a normal, which pbrfit would refuse, and say how many."""
    length = np.linalg.norm(normals, axis=-1)
    has_normal = np.isfinite(length) & (length >= 0.5)
    print(
        f"{folder}: {np.count_nonzero(mask & has_normal)} pixels used, "
        f"{np.count_nonzero(mask & ~has_normal)} of the mask without a usable normal left out"
    )
    return np.asarray(mask & has_normal)


if __name__ == "__main__":
    sys.exit(main())
