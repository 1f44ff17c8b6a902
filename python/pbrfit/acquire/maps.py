"""Maps of materials that networks estimate from one picture, or other tools: estimates of a scene.

A fit takes them as evidence beside all pictures (`pbrfit.fit.estimates`).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.acquire.marigold import ENSEMBLE, MATERIALS_MODEL, MarigoldIID
from pbrfit.acquire.normals import check_reducible
from pbrfit.io.images import read_data, read_picture
from pbrfit.model.estimates import of_maps, read, reduced
from pbrfit.model.materials import Materials
from pbrfit.values.arrays import Codes
from pbrfit.values.quoting import listed

NAMES = {
    "albedo": r"albedo|base_?color|diffuse",
    "roughness": r"rough",
    "metallic": r"metal",
}
"""What the name of a map's file contains, in lower case."""


def by_marigold(
    srgb8: Codes,
    *,
    model: str = MATERIALS_MODEL,
    ensemble: int = ENSEMBLE,
    steps: int | None = None,
    seed: int = 0,
    device: str = "auto",
) -> Materials:
    """Maps of a picture (H, W, 3), sRGB, by Marigold-IID.

    `model` is another checkpoint, on the Hugging Face Hub or in a folder; `ensemble` predictions
    are combined; `steps` are the sampler's, `seed` is that of its noise. Raises InputError if
    packages or weights are missing, or memory runs out.
    """
    network = MarigoldIID(model, device=device)
    found = network.maps(srgb8, seed=seed, samples=ensemble, steps=steps)
    clipped = {name: np.clip(plane, 0, 1) for name, plane in vars(found).items()}
    return of_maps(clipped, srgb8.shape[:2])


def of_files(paths: Sequence[Path], size: tuple[int, int]) -> Materials:
    """Maps of files, at the size (height, width) of the pictures.

    An EXR file with layers albedo, roughness or metallic, such as `materials.exr`, holds all maps.
    Other files hold one, which their name tells (`NAMES`): albedo in the colour space that the file
    states, else sRGB for integers and linear for floats; roughness and metallic as stored. All have
    the pictures' size, or are larger in the same proportion. Raises InputError or OSError if a name
    or a size tells otherwise, or a file cannot be read.
    """
    if len(paths) == 1 and paths[0].suffix.lower() == ".exr" and not _kinds(paths[0]):
        found = read(paths[0])
        check_reducible(paths[0], found.roughness.shape, size)
        return found if found.roughness.shape == size else reduced(found, size)
    maps: dict[str, NDArray[Any]] = {}
    for path in paths:
        kinds = _kinds(path)
        if len(kinds) != 1 or kinds[0] in maps:
            expected = "expected one of albedo (or basecolor, diffuse), roughness and metallic"
            twice = "a second one" if kinds and kinds[0] in maps else listed(kinds) or "none"
            raise InputError(f"{path}: {expected} in each file's name, found {twice}")
        if kinds[0] == "albedo":
            plane: NDArray[Any] = np.clip(read_picture(path).pixels, 0, 1)
        else:
            plane = read_data(path)[..., 0]
        check_reducible(path, plane.shape, size)
        if plane.shape[:2] != size:
            whole = of_maps({kinds[0]: plane}, plane.shape[:2])
            plane = getattr(reduced(whole, size), kinds[0])
        maps[kinds[0]] = plane
    return of_maps(maps, size)


def _kinds(path: Path) -> list[str]:
    return [kind for kind, name in NAMES.items() if re.search(name, path.stem.lower())]
