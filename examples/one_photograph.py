"""From one photograph to materials, without any network.

    python examples/one_photograph.py --out DIR

renders a furnished room once as the photograph and again under other lights, damages three of these
pictures as generators do, and gives them to the public commands: `pbrfit generate` with the offline
generator reviews them and makes a scene folder, `pbrfit decompose` goes on. DIR/scene/review.png
shows what was taken and what was refused, and why (docs/tutorials/one-photograph.md).
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

import numpy as np

from pbrfit.io import images
from pbrfit.io.color import encode_srgb
from pbrfit.io.output import FolderForm, new_folder
from pbrfit.synthetic import make_scene
from pbrfit_evaluation.review.pictures import Kind, damaged, relights

SEED = 2003
PICTURES = 12
DAMAGES: dict[int, Kind] = {4: "shift", 7: "recolour-object", 10: "clone"}

GIVEN = FolderForm(("photo.png",), ("photo.png", "normals.exr", "relit/light_*.png"))
"""Form of the folder that `write_pictures` fills."""


def main() -> int:
    """Run the example; returns the exit code of the command that ended it."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="folder to write")
    parser.add_argument("--size", metavar="PIXELS", type=int, default=384)
    parser.add_argument("--iterations", metavar="K", type=int, default=500)
    parser.add_argument("--overwrite", action="store_true", help="replace what an earlier run left")
    options = parser.parse_args()
    out, given = options.out, options.out / "given"
    with new_folder(given, overwrite=options.overwrite, form=GIVEN) as folder:
        write_pictures(folder, options.size)
    generate = [
        *("generate", given / "photo.png", "--out", out / "scene", "--fov", "60"),
        *("--generator", f"folder:{given / 'relit'}", "--normals", given / "normals.exr"),
        *("--segments", "none", "--depth", "none"),
    ]
    decompose = ["decompose", out / "scene", "--out", out / "result"]
    decompose += ["--iterations", str(options.iterations)]
    again = ["--overwrite"] if options.overwrite else []
    for command in (generate, decompose):
        ran = subprocess.run([sys.executable, "-m", "pbrfit", *command, *again], check=False)
        if ran.returncode:
            return ran.returncode
    return 0


def write_pictures(folder: Path, size: int) -> None:
    """Write photo.png, normals.exr and relit/: what somebody would have to begin with."""
    view = relights("furnished", "own", SEED, size=size, count=PICTURES + 1)
    rng = np.random.default_rng(SEED)
    (folder / "relit").mkdir()
    for i, picture in enumerate(view.images):
        shown = picture
        if i in DAMAGES:
            shown, _ = damaged(picture, DAMAGES[i], view.segments, rng)
        codes = np.round(255 * encode_srgb(shown.clip(0, 1))).astype(np.uint8)
        name = (
            f"relit/light_{i:02d}-{DAMAGES[i]}.png" if i in DAMAGES else f"relit/light_{i:02d}.png"
        )
        if i == 0:
            name = "photo.png"
        images.write_png(folder / name, codes, tag="srgb")
    # The same room: what its generator draws does not depend on the number of lights.
    normals = make_scene("furnished", size=size, lights=2, held_out=1, seed=SEED).normals
    images.write_exr(
        folder / "normals.exr", {axis: normals[..., i] for i, axis in enumerate("XYZ")}
    )


if __name__ == "__main__":
    sys.exit(main())
