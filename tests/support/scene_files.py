"""Tiny scenes and scene folders in every format, for the tests of what users touch."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from pbrfit.cli import main
from pbrfit.io import images
from pbrfit.io.color import encode_srgb
from pbrfit.model.geometry import view_directions
from pbrfit.scene.arrays import Truth
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import draw, make_scene
from pbrfit.synthetic.geometry import trace

SIZE = 16
LIGHTS = 3

T = TypeVar("T")


def known(value: T | None) -> T:
    """What might be absent and is not."""
    assert value is not None
    return value


@functools.cache
def room() -> Scene:
    """A synthetic room without its truth, dimmed so that integer formats clip nothing."""
    bright = make_scene("room", size=SIZE, lights=LIGHTS, held_out=1)
    return Scene(
        images=(bright.images / bright.images.max()).astype(np.float32),
        normals=bright.normals,
        fov=bright.fov,
        segments=bright.segments,
        names=bright.names,
    )


def world(kind: Any, seed: int, height: int, width: int, fov: float) -> tuple[Any, Any, Any]:
    """Depth along the axis, true normals, and where there is anything, of a synthetic room."""
    made = draw(kind, np.random.default_rng(seed))
    views = view_directions(height, width, fov)
    hits = trace(made.primitives, made.eye, -views.reshape(-1, 3) @ made.turn.T)
    z = hits.distance.reshape(height, width) * views[..., 2]
    return z, (hits.normals @ made.turn).reshape(height, width, 3), hits.index.reshape(z.shape) >= 0


def truth_of(scene: Scene) -> Truth:
    return known(scene.truth)


def lights_of(scene: Scene) -> NDArray[np.float64]:
    """Known lights of its pictures."""
    return known(truth_of(scene).lighting)


def held_out_of(scene: Scene) -> tuple[NDArray[Any], NDArray[np.float64]]:
    """Held-out pictures and their lights."""
    truth = truth_of(scene)
    return known(truth.relight_images), known(truth.relight_lighting)


def write_exr(path: Path, image: NDArray[Any]) -> None:
    images.write_exr(path, {name: image[..., c] for c, name in enumerate("RGB")})


def write_integers(path: Path, image: NDArray[Any], kind: Any = np.uint8) -> None:
    levels = np.iinfo(kind).max
    images.write_png(path, np.rint(encode_srgb(image) * levels).astype(kind), tag="srgb")


def write_jpeg(path: Path, image: NDArray[Any], exif: Image.Exif | None = None) -> None:
    pixels = np.rint(encode_srgb(image) * 255).astype(np.uint8)
    Image.fromarray(pixels).save(path, quality=100, subsampling=0, exif=exif or Image.Exif())


def write_hdr(path: Path, image: NDArray[Any]) -> None:
    """Radiance RGBE without compression."""
    largest = np.maximum(image.max(axis=-1), 1e-30)
    exponent = np.floor(np.log2(largest)) + 1
    mantissa = np.floor(image / np.exp2(exponent - 8)[..., None])
    rgbe = np.dstack([mantissa, exponent + 128]).astype(np.uint8)
    header = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {len(image)} +X {image.shape[1]}\n"
    path.write_bytes(header.encode() + rgbe.tobytes())


FORMATS: dict[str, tuple[str, Callable[[Path, NDArray[Any]], None], float, str]] = {
    "float EXR": (".exr", write_exr, 0.0, "linear Rec.709"),
    "16-bit PNG": (".png", functools.partial(write_integers, kind=np.uint16), 2e-5, "sRGB (16-bit"),
    "8-bit PNG": (".png", write_integers, 5e-3, "sRGB (8-bit PNG"),
    "JPEG": (".jpg", write_jpeg, 3e-2, "sRGB (8-bit JPEG"),
    "HDR": (".hdr", write_hdr, 8e-3, "linear Rec.709"),
}
"""Suffix, writer, the largest error of linear values in [0, 1], how `assumed` tells the colour."""


def write_normals(folder: Path, normals: NDArray[Any]) -> None:
    images.write_exr(
        folder / "normals.exr", {name: normals[..., c] for c, name in enumerate("XYZ")}
    )


def write_folder(folder: Path, form: str = "float EXR", fov: str | None = "fov = 60") -> Path:
    """A scene folder of the room: pictures in one format, normals, scene.toml with the fov."""
    suffix, write, _, _ = FORMATS[form]
    (folder / "images").mkdir(parents=True)
    for name, image in zip(room().names, room().images, strict=True):
        write(folder / "images" / f"{name}{suffix}", image)
    write_normals(folder, room().normals)
    if fov is not None:
        (folder / "scene.toml").write_text(fov + "\n")
    return folder


def tree(folder: Path) -> dict[str, str]:
    """All that is below a folder, with what text files hold."""
    return {
        str(p.relative_to(folder)): p.read_text() if p.is_file() else "" for p in folder.rglob("*")
    }


Argument = str | Path | int | float


def run(*arguments: Argument) -> int:
    """Exit code of the command in this process."""
    try:
        return main([str(argument) for argument in arguments])
    except SystemExit as end:  # --help, --version and wrong usage
        return int(end.code or 0)
