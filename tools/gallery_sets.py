"""Scene folders of the public sets that the gallery shows, from checkouts of their repositories.

    python tools/gallery_sets.py CHECKOUTS DATA

CHECKOUTS holds a working tree of each repository under the second half of its name, at the commit
below; those that are not there are left out. DATA gets a scene folder a set (docs/formats.md).
"""

from __future__ import annotations

import argparse
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from pbrfit.io.lamp_files import read_lamps
from pbrfit.io.output import new_folder

LINEAR = 'color_space = "linear"\n'


@dataclass(frozen=True)
class PublicScene:
    """One scene of a public set.

    Attributes
    ----------
    name
        Folder that is written.
    repository
        Owner and name on github.com.
    commit
        Of the files that were read.
    folder
        In the repository.
    pictures
        Pattern of its pictures.
    licence
        As the repository states it; None = not stated.
    settings
        Text of `scene.toml`.
    quarter_turns
        Against the clock, of pictures and lamps.
    saturation_min
        Least share by which the strongest channel must exceed the weakest, in the mean picture, for
        a pixel to be used; 0 = all are.
    level_min
        Least value of the mean picture's strongest channel for a pixel to be used.
    """

    name: str
    repository: str
    commit: str
    folder: str
    pictures: str
    licence: str | None
    settings: str = ""
    quarter_turns: int = 0
    saturation_min: float = 0.0
    level_min: float = 0.0


REAL_RTI = ("Univr-RTI/RealRTI", "6f0eb851691ff660316b6fe4ed762ad816e6fd04")
NORMAL_PHOTOS = ("mikatalk/photo-normal-map", "3e5629a85e9bff3224629fd1b2d6281f4de6e7ba")
SHAPE = ("dlichy/ShapeAndMaterial", "b981ad67e7454a1c503a8bbf033073b3d41b3f1f")

SCENES = (
    PublicScene(
        "icon",
        "Univr-RTI/NeuralRTI",
        "8540cc31528c2dd1da19ee34349ba12f2f0a5d59",
        "exampledataset",
        "image*.jpg",
        "MIT",
        LINEAR,
        quarter_turns=1,
    ),
    PublicScene("sand", *NORMAL_PHOTOS, "src/img", "[bclrt]*-1024.png", "MIT"),
    PublicScene("paper", *NORMAL_PHOTOS, "src/img", "paper-*-1024.png", "MIT"),
    PublicScene(
        "stones",
        "cpetry/NormalMap-Online",
        "16cbed47787a02d096640351a46c3c0750dfc61f",
        "images",
        "default_picture_*.jpg",
        "MIT",
    ),
    PublicScene(
        "leaves",
        "YertleTurtleGit/photometric-stereo-mappings",
        "df37223de2f3a2a347335c676d428fe1224485d6",
        "test_data",
        "*_TL.png",
        "GPL-3.0",
        saturation_min=0.45,
    ),
    PublicScene(
        "jacket",
        "YertleTurtleGit/scanning-pipeline",
        "5f541db5af5b572747d79e2e53422ef9a03fee18",
        "test-datasets/spherical-gradient",
        "test_*.jpg",
        "GPL-3.0",
        level_min=0.12,
    ),
    PublicScene("mug", *SHAPE, "data/sample_dataset/196CANON", "[0-9].JPG", None),
    PublicScene("pumpkin", *SHAPE, "data/sample_dataset/300CANON", "[0-9].JPG", None),
    PublicScene("door", *REAL_RTI, "item1", "image*.jpg", None, LINEAR),
    PublicScene("fresco", *REAL_RTI, "item2", "image*.jpg", None, LINEAR),
    PublicScene("canvas", *REAL_RTI, "item5", "image*.jpg", None, LINEAR),
    PublicScene("clay", *REAL_RTI, "item8", "image*.jpg", None, LINEAR),
    PublicScene("coin", *REAL_RTI, "item10", "image*.jpg", None, LINEAR),
    PublicScene("statue", *REAL_RTI, "item11", "image*.jpg", None, LINEAR),
)
"""Best ones to look at first."""


def main() -> int:
    """Write what is asked for and there."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("checkouts", metavar="CHECKOUTS", type=Path)
    parser.add_argument("data", metavar="DATA", type=Path)
    options = parser.parse_args()
    for scene in SCENES:
        folder = options.checkouts / scene.repository.partition("/")[2] / scene.folder
        if not folder.is_dir():
            print(f"{scene.name}: no {folder}, left out", file=sys.stderr)
        elif not (options.data / scene.name).exists():
            with new_folder(options.data / scene.name) as written:
                write(scene, folder, written)
    return 0


def write(scene: PublicScene, source: Path, folder: Path) -> None:
    """Write the scene folder of a set."""
    paths = sorted(source.glob(scene.pictures), key=lambda path: (len(path.name), path.name))
    (folder / "images").mkdir()
    for path in paths:
        if scene.quarter_turns:
            turned = Image.fromarray(np.rot90(np.asarray(Image.open(path)), scene.quarter_turns))
            turned.save(folder / "images" / f"{path.stem}.png")
        else:
            shutil.copyfile(path, folder / "images" / path.name.lower())
    (folder / "scene.toml").write_text(scene.settings, encoding="utf-8")
    for lamps in source.glob("*.lp"):
        write_lamps(scene, lamps, folder / "lamps.lp")
    given = source / "mask.png"
    if given.is_file():
        shutil.copyfile(given, folder / "mask.png")
    elif scene.saturation_min or scene.level_min:
        from scipy.ndimage import binary_opening

        every = np.stack([np.asarray(Image.open(path).convert("RGB")) for path in paths])
        mean = every.mean(axis=0) / 255
        high, low = mean.max(axis=-1), mean.min(axis=-1)
        used = (high >= scene.level_min) & (high - low >= scene.saturation_min * high)
        mask = Image.fromarray(np.where(binary_opening(used, iterations=2), 255, 0).astype("uint8"))
        mask.save(folder / "mask.png")


def write_lamps(scene: PublicScene, source: Path, path: Path) -> None:
    """Write directions of lamps, turned as the pictures are."""
    rows, _ = read_lamps(source)
    lines = [str(len(rows))]
    for row in rows:
        x, y, z = row.place
        for _ in range(scene.quarter_turns % 4):
            x, y = -y, x
        lines.append(f"{row.picture} {x:.6f} {y:.6f} {z:.6f}")
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
