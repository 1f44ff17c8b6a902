"""Scenes as users have them: after one thing that cameras and files do; fitted with all defaults.

All are made of a scene of 16 pictures with a mean radiance of 0.4 and white noise of `NOISE`, in
float32; those of JPEG files, with their twins, of the scene without noise. What a file format does
is done by files of that format, which `Scene.load` reads.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from PIL import Image

from pbrfit.result.options import FitOptions
from pbrfit.scene.arrays import CHANNELS
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import make_scene
from pbrfit_evaluation.arrays import Array, Floats, known
from pbrfit_evaluation.grid import NOISE, PICTURES, Case, Grid, measured
from pbrfit_evaluation.recipes import lit_anew
from pbrfit_evaluation.review.pictures import codes

KINDS = ("room", "furnished", "detailed")

REFERENCE = "noise"
"""What others are multiples of, unless they have a twin."""


@dataclass(frozen=True)
class Disturbance:
    """What is done to a scene."""

    title: str
    """In tables and plots."""
    twin: str = REFERENCE
    """Scenes that have the same but for what is measured: errors are multiples of theirs."""


DISTURBANCES: Mapping[str, Disturbance] = {
    "noise": Disturbance("float32, 1 % noise"),
    "clean": Disturbance("float32, no noise"),
    "png": Disturbance("PNG, 8-bit sRGB"),
    "jpeg-90-444": Disturbance("JPEG 90, 4:4:4", "white-90-444"),
    "white-90-444": Disturbance("white noise as JPEG 90, 4:4:4"),
    "jpeg-90-420": Disturbance("JPEG 90, 4:2:0", "white-90-420"),
    "white-90-420": Disturbance("white noise as JPEG 90, 4:2:0"),
    "jpeg-75-444": Disturbance("JPEG 75, 4:4:4", "white-75-444"),
    "white-75-444": Disturbance("white noise as JPEG 75, 4:4:4"),
    "jpeg-75-420": Disturbance("JPEG 75, 4:2:0", "white-75-420"),
    "white-75-420": Disturbance("white noise as JPEG 75, 4:2:0"),
    "hot": Disturbance("0.2 % hot samples"),
    "black": Disturbance("one picture black"),
    "clipped": Disturbance("floats clipped at 0.9"),
    "brightest": Disturbance("brightest 0.2 % clipped"),
    "shifted": Disturbance("one picture shifted"),
    "another": Disturbance("one of another scene"),
    "gamma": Disturbance("gamma 1.1"),
    "vignetting": Disturbance("vignetting of 30 %"),
    "grey": Disturbance("grey scene and lights"),
    "together": Disturbance("PNG of all at once"),
    "fov-true": Disturbance("90° wide, known"),
    "fov-unknown": Disturbance("90° wide, unknown", "fov-true"),
    "fov-wrong": Disturbance("90° wide, 60° given", "fov-true"),
}

UNCLIPPED = 0.995
"""Share of the samples below white in files of 8 bits: the brightest 0.5 % clip."""

HOT_SHARE, HOT_RANGE = 0.002, 10.0
"""Share of the samples that are hot, and how far they reach, in mean radiances."""

CLIPPED_AT, UNCLIPPED_FLOATS = 0.9, 0.998
"""Radiance above which floats are clipped; share of the samples that are below the other limit."""

BAD_PICTURE = 5
"""Number of the picture that is black, shifted or of another scene."""

TOGETHER = ("another", "black", "shifted", "hot", "gamma", "vignetting")
"""What is done to one scene, in this order."""

SHIFT = 2
"""Pixels that a picture is shifted to the right; its first column is repeated."""

OTHER_SEED = 500
"""Added to the seed of a scene: that of another, which is in no run of fewer scenes than this."""

GAMMA, VIGNETTING = 1.1, 0.3
"""Exponent of radiance over white; share of the light that the corners lose, by the square of the
distance to the middle."""

FOV_TRUE, FOV_WRONG = 90.0, 60.0
"""Degrees: that of the pictures, and that which is given."""


def disturbed(disturbance: str, kind: str, seed: int, size: int) -> Scene:
    """Make a scene after one of `DISTURBANCES`, with its ground truth.

    `kind`, `seed` and `size` are those of `pbrfit.synthetic.make_scene`; what is drawn here has a
    stream of its own.
    """
    of = partial(made, kind, seed, size)
    rng = np.random.default_rng([seed, 3])
    format_, _, rest = disturbance.partition("-")
    match format_:
        case "jpeg":
            return in_files(of(), jpeg(rest))
        case "white":
            return _with_noise_of(of(), jpeg(rest), rng)
        case "fov":
            scene = of(NOISE, fov=FOV_TRUE)
            if rest == "wrong":
                return replace(scene, fov=FOV_WRONG)
            return read_back(scene, say_fov=False) if rest == "unknown" else scene
        case "clean":
            return of()
        case "png":
            return in_files(of(NOISE), write_png)
        case "grey":
            return grey(of(), rng)
        case "together":
            # Each with a picture of its own, in files that do not tell the field of view.
            scene = of(NOISE)
            for i, one in enumerate(TOGETHER):
                scene = _spoilt(scene, one, kind, seed, size, rng, bad_picture=BAD_PICTURE + 2 * i)
            return in_files(scene, write_png, say_fov=False)
    return _spoilt(of(NOISE), disturbance, kind, seed, size, rng)


def _spoilt(
    given: Scene,
    disturbance: str,
    kind: str,
    seed: int,
    size: int,
    rng: Generator,
    *,
    bad_picture: int = BAD_PICTURE,
) -> Scene:
    """After a disturbance of the pictures; of one alone it is the bad one."""
    pictures: Floats = given.images.copy()
    valid = given.valid
    match disturbance:
        case "hot":
            hot = rng.random(pictures.shape) < HOT_SHARE
            brightest = HOT_RANGE * float(pictures[:, valid].mean(dtype=np.float64))
            pictures[hot] = brightest * rng.random(hot.sum())
        case "black":
            pictures[bad_picture] = NOISE * rng.standard_normal(pictures.shape[1:])
        case "clipped":
            pictures = np.minimum(pictures, np.float32(CLIPPED_AT))
        case "brightest":
            pictures = np.minimum(pictures, np.quantile(pictures[:, valid], UNCLIPPED_FLOATS))
        case "shifted":
            moved = np.pad(pictures[bad_picture], ((0, 0), (SHIFT, 0), (0, 0)), mode="edge")
            pictures[bad_picture] = moved[:, :-SHIFT]
        case "another":
            other = made(kind, seed + OTHER_SEED, size, NOISE)
            pictures[bad_picture] = other.images[bad_picture]
        case "gamma":
            white = _white(given)
            # What a tone curve makes of radiance; noise below black becomes black.
            pictures = np.maximum(pictures / white, 0) ** GAMMA * white
        case "vignetting":
            height, width = valid.shape
            y, x = np.mgrid[:height, :width] + 0.5
            squared = (x / width - 0.5) ** 2 + (y / height - 0.5) ** 2
            pictures = pictures * (1 - VIGNETTING * squared / 0.5)[..., None]
    return replace(given, images=pictures.astype(np.float32))


# --------------------------------------------------------------------------------------- scenes


def made(kind: str, seed: int, size: int, noise: float = 0.0, **more: Any) -> Scene:
    """A scene before anything is done to it, in float32; `more` as for `make_scene`."""
    given = {"lights": PICTURES, "held_out": PICTURES, "fov": FOV_WRONG} | more
    scene = make_scene(kind, size=size, seed=seed, noise=noise, **given)
    return replace(scene, images=scene.images.astype(np.float32))


def _white(scene: Scene) -> float:
    """Radiance that an exposure of the pictures makes white."""
    return float(np.quantile(scene.images[:, scene.valid], UNCLIPPED))


def grey(scene: Scene, rng: Generator) -> Scene:
    """Materials and lights without colour, at the same mean radiance; grey pictures with noise.

    Each is the mean over its channels, also of what a camera gives with noise in each of them.
    """

    def mean(values: Floats | None) -> Array:
        return np.repeat(known(values).mean(axis=-1, keepdims=True, dtype=np.float64), 3, axis=-1)

    colored = known(scene.truth)
    materials = replace(colored.materials, albedo=mean(colored.materials.albedo))
    lit = lit_anew(scene, materials, mean(colored.lighting), mean(colored.relight_lighting))
    pictures = lit.images + mean(NOISE * rng.standard_normal(lit.images.shape))
    return replace(lit, images=pictures.astype(np.float32))


# ---------------------------------------------------------------------------------------- files

Write = Callable[[Path, NDArray[np.uint8]], None]
"""Writes codes (H, W, 3) to a path without its suffix."""


def write_png(path: Path, codes: NDArray[np.uint8]) -> None:
    """A `Write` of PNG files."""
    Image.fromarray(codes).save(path.with_suffix(".png"))


def jpeg(said: str) -> Write:
    """Of quality and chroma subsampling, such as "90-420"."""
    quality, _, chroma = said.partition("-")
    how: Any = {"quality": int(quality), "subsampling": ":".join(chroma)}
    return lambda path, codes: Image.fromarray(codes).save(path.with_suffix(".jpg"), **how)


def in_files(scene: Scene, write: Write, *, say_fov: bool = True) -> Scene:
    """Exposed, encoded as sRGB of 8 bits, written, and read; held-out pictures stay."""
    white, truth = _white(scene), known(scene.truth)
    # Held-out lights and pictures are not those of the files, and need no exposure.
    truth = replace(truth, lighting=known(truth.lighting) / white)
    images = (scene.images / white).astype(np.float32)
    return replace(read_back(replace(scene, images=images), write, say_fov=say_fov), truth=truth)


def _with_noise_of(clean: Scene, write: Write, rng: Generator) -> Scene:
    """Float pictures with white noise of the RMS that files leave in the samples they can hold."""
    white, exact = _white(clean), clean.images.astype(np.float64)
    error = in_files(clean, write).images - exact / white
    held = error[(exact < white) & clean.valid[..., None]]
    sigma = white * float(np.sqrt(np.mean(np.square(held))))
    pictures = exact + sigma * rng.standard_normal(exact.shape)
    return replace(clean, images=pictures.astype(np.float32))


def read_back(scene: Scene, write: Write | None = None, *, say_fov: bool = True) -> Scene:
    """As `Scene.load` reads it from a folder, with its ground truth as it was.

    Pictures are float32 EXR, or what `write` makes of their sRGB codes. A folder need not say the
    field of view.
    """
    with TemporaryDirectory() as parent:
        folder = Path(parent) / "scene"
        replace(scene, truth=None).save(folder)
        if write is not None:
            for name, picture in zip(scene.names, scene.images, strict=True):
                path = folder / "images" / name
                path.with_suffix(".exr").unlink()
                write(path, codes(np.nan_to_num(picture)))
        settings = folder / "scene.toml"
        if not say_fov:
            lines = settings.read_text(encoding="utf-8").splitlines(keepends=True)
            kept = (line for line in lines if not line.startswith("fov"))
            settings.write_text("".join(kept), encoding="utf-8")
        return replace(Scene.load(folder), truth=scene.truth)


GRID = Grid(
    {key: one.title for key, one in DISTURBANCES.items()},
    brings={key: (REFERENCE, one.twin) for key, one in DISTURBANCES.items()},
    kinds=KINDS,
    pictured=("noise", "jpeg-90-420", "jpeg-75-420", "clipped", "shifted"),
    few=tuple(name for name in DISTURBANCES if "444" not in name and "75" not in name),  # JPEG once
)


def run(case: Case, _: int) -> dict[str, Any]:
    """Errors, the scale and what is said of the field of view.

    One thread, so that processor seconds compare.
    """
    scene = disturbed(case.condition, case.kind, case.seed, case.size)
    refine = FitOptions().refine_normals
    result, found = measured(case, GRID.ways[case.way], scene, 1, refine_normals=refine)
    true_fov = FOV_TRUE if case.condition.startswith("fov") else FOV_WRONG
    found_albedo, albedo = (
        of.albedo[scene.valid] for of in (result.materials, known(scene.truth).materials)
    )
    deviations = known(result.uncertainty).albedo_scale
    return {
        **found,
        "refined": result.refinement.refined,
        "scale": scale_errors(found_albedo, albedo, deviations),
        "fov": {
            "degrees": result.fov,
            "error": abs(result.fov - true_fov),
            "said": result.assumed.get("fov"),
            "contradicted": result.camera is not None and result.camera.contradicted,
        },
    }


def scale_errors(
    found: Floats, true: Floats, deviations: Sequence[float]
) -> dict[str, dict[str, float]]:
    """By channel the `error` of the scale of albedos (P, 3), and its `deviation`.

    The error is |ln s|, where s times the true albedo is nearest to the found one. To first order
    its standard deviation is `Uncertainty.albedo_scale`.
    """
    scales = (found * true).sum(axis=0) / np.square(true).sum(axis=0)
    errors = np.abs(np.log(np.maximum(scales, np.finfo(np.float64).tiny)))
    return {
        channel: {"error": float(error), "deviation": float(deviation)}
        for channel, error, deviation in zip(CHANNELS, errors, deviations, strict=True)
    }


def covered(scale: dict[str, dict[str, float]]) -> list[bool]:
    """By channel, whether the error of the scale is within two deviations.

    Pictures without noise in float32 leave an error of some 1e-7, which is rounding and which no
    deviation is of.
    """
    return [one["error"] <= max(2 * one["deviation"], 1e-6) for one in scale.values()]
