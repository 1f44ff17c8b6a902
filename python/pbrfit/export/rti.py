"""Files of reflectance transformation imaging: directions of lamps, and relightable images.

A relightable image says for each pixel what it shows under light from (l_u, l_v, l_w), unit vector
to the right, upwards and to the viewer. A polynomial texture map has one colour for all of them:

    L = a₀ l_u² + a₁ l_v² + a₂ l_u l_v + a₃ l_u + a₄ l_v + a₅,      (R, G, B) · L/255.

Hemispherical harmonics have nine coefficients a channel, Σ a_k H_k(l): they show gloss better.
`.rti` holds them for RTIViewer, `info.json` with its planes for web viewers (OpenLIME, relight).

Sources: T. Malzbender, D. Gelb and H. Wolters, "Polynomial texture maps", SIGGRAPH 2001; T.
Malzbender and D. Gelb, "Polynomial Texture Map (.ptm) File Format", version 1.2, 2001; P. Gautron
et al., "A novel hemispherical basis for accurate and efficient rendering", EGSR 2004; readers of
the other forms in cnr-isti-vclab/relight (`legacy_rti.cpp`) and openlime (`ShaderRTI.js`).
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import PurePosixPath

import numpy as np

from pbrfit._core import InputError
from pbrfit.io.color import encode_srgb
from pbrfit.model.lamps import Lamps
from pbrfit.model.lighting import spread_directions
from pbrfit.model.reflection import sh_basis
from pbrfit.result import metrics
from pbrfit.result.relighting import relight
from pbrfit.result.result import Result
from pbrfit.values.arrays import Array, Codes, Mask

LP_FILE = "lamps.lp"
LP_HOLDS = "directions to the lamps, X right, Y up, Z to the viewer, by picture file"

WEB_FOLDER = "openlime"
WEB_HOLDS = {
    "info.json": "hemispherical harmonics for web viewers (OpenLIME): scales of the planes",
    **{f"plane_{k}.jpg": f"coefficient {k + 1} of 9, of red, green and blue" for k in range(9)},
}

JPEG_QUALITY = 95

DIRECTIONS = 50
"""Lights that coefficients are fitted to: five or more a coefficient."""

LOWEST = 10.0
"""Degrees above the horizon of the lowest of them, about."""

CODES = 254
"""Steps between the lowest and the highest value of a coefficient, one less than bytes have: that 0
falls on a whole code moves the others by up to one."""

SCALE_MIN = 1e-6
"""Smallest step of a coefficient that the nine decimals of a file can tell."""


def one_lamp_a_picture(lamps: Lamps | None, pictures: int) -> bool:
    """Whether `lp` can tell the lamps: each picture has just one."""
    return lamps is not None and np.array_equal(lamps.pictures, np.arange(pictures))


def lp(result: Result) -> str:
    """Directions to the lamps, one a picture, of near ones from the middle of the surface.

    A line has the picture's file name, as far as the result knows it, else its name.

    Raises InputError if a picture has no lamp or several.
    """
    if not one_lamp_a_picture(result.lamps, len(result.pictures)):
        found = "none" if result.lamps is None else result.lamps.in_words()
        raise InputError(
            f"format: expected a result with a lamp in each of {len(result.pictures)} pictures for "
            f"lp, found {found}"
        )
    files = _file_names(result)
    directions, _ = result.lamps_seen()
    lines = [
        " ".join([name, *(f"{value:.9f}" for value in direction)])
        for name, direction in zip(files, directions.tolist(), strict=True)
    ]
    return "\n".join([str(len(lines)), *lines, ""])


def _file_names(result: Result) -> list[str]:
    """Of the pictures; what is no file of the scene's keeps its name."""
    files: dict[str, list[str]] = {}
    for path in map(PurePosixPath, result.inputs):
        if path.parent == PurePosixPath("images"):
            files.setdefault(path.stem, []).append(path.name)
    return [files[name][0] if len(files.get(name, ())) == 1 else name for name in result.pictures]


def ptm(result: Result) -> tuple[bytes, float]:
    """A polynomial texture map of a result, and the radiance that is its white.

    Pixels outside the mask are black.
    """
    fitted, mean, white = _fitted(result, basis)
    largest = mean.max(axis=-1, keepdims=True)
    color = np.divide(mean, largest, out=np.ones_like(mean), where=largest > 0)
    # Of all channels' polynomials the multiple of the colour that is closest to them.
    along = color / np.square(color).sum(axis=-1, keepdims=True)
    codes, scales, biases = _coded(255 * np.einsum("kpc,pc->kp", fitted, along))
    height, width = result.mask.shape
    head = [
        *("PTM_1.2", "PTM_FORMAT_LRGB", str(width), str(height)),
        " ".join(f"{scale:.9f}" for scale in scales),
        " ".join(f"{bias:.0f}" for bias in biases),
        "",
    ]
    brightness = _placed(codes.T, np.clip(biases, 0, 255), result.mask)
    colors = _placed(np.rint(255 * color), np.zeros(3), result.mask)
    rows_from_below = brightness[::-1].tobytes() + colors[::-1].tobytes()
    return "\n".join(head).encode("ascii") + rows_from_below, white


def _fitted(result: Result, terms: Callable[[Array], Array]) -> tuple[Array, Array, float]:
    """Coefficients (K, P, 3) of terms by least squares, mean (P, 3), and the radiance of white.

    Of what is shown under `directions`, from 0 to 1 in sRGB, as viewers show it: 1 is the 98th
    percentile under a light from the viewer. Lights have the strength of `DirectionalLight`, and
    cast shadows where `relight` does.
    """
    lights = directions()
    solve = np.linalg.pinv(terms(lights))
    white = metrics.white_of(_relit(result, np.array([0.0, 0.0, 1.0])))
    inside = result.mask
    fitted = np.zeros((len(solve), np.count_nonzero(inside), 3))
    mean = np.zeros(fitted.shape[1:])
    for column, light in zip(solve.T, lights, strict=True):
        shown = encode_srgb(np.clip(_relit(result, light)[inside] / white, 0.0, 1.0))
        mean += shown / len(lights)
        fitted += column[:, None, None] * shown
    return fitted, mean, white


def harmonics(light: Array) -> Array:
    """(N, 9) hemispherical harmonics up to order 2, in the order of `.rti`, of unit vectors (N, 3).

    Spherical ones, times √2, of directions that have the same azimuth and the cosine t = 2 l_w − 1.
    """
    t = 2 * np.clip(light[:, 2:], 0.0, 1.0) - 1
    across = light[:, :2] / np.maximum(np.linalg.norm(light[:, :2], axis=1, keepdims=True), 1e-12)
    spherical = sh_basis(np.concatenate([across * np.sqrt(1 - t * t), t], axis=1))
    signs = np.sqrt(2) * np.array([1, 1, 1, 1, -1, 1, 1, 1, -1])
    return np.asarray(signs * spherical[:, [0, 3, 2, 1, 8, 7, 6, 5, 4]])


def rti(result: Result) -> tuple[bytes, float]:
    """Hemispherical harmonics of a result for RTIViewer, and the radiance that is their white.

    A code c of coefficient k means c/255 · scale_k + low_k in all channels. Rows are from below; of
    a pixel all of red, green, blue. Pixels outside the mask are black.
    """
    codes, steps, zeros, white = _planes(result)
    height, width = result.mask.shape
    head = f"#HSH1.2\n3\n{width} {height} 3\n9 2 1\n".encode("ascii")
    little = (part.astype("<f4").tobytes() for part in (255 * steps, 0.0 - zeros * steps))
    return b"".join([head, *little, codes[::-1].swapaxes(2, 3).tobytes()]), white


def openlime(result: Result) -> tuple[dict[str, bytes], float]:
    """The same as the files of `WEB_HOLDS`, a JPEG for each coefficient of the three channels.

    A value c from 0 to 1 means (c − bias) · scale.
    """
    from PIL import Image  # here: it takes longer to import than most of this package

    codes, steps, zeros, white = _planes(result)
    height, width = result.mask.shape
    info = {"width": width, "height": height, "format": "jpg", "quality": JPEG_QUALITY}
    info |= {"type": "hsh", "colorspace": "rgb", "nplanes": 27}
    scale, bias = np.repeat([255 * steps, zeros / 255], 3, axis=1).tolist()
    info["materials"] = [{"scale": scale, "bias": bias}]
    files = {"info.json": json.dumps(info, indent=1).encode()}
    for k in range(9):
        plane = io.BytesIO()
        image = Image.fromarray(codes[:, :, k])
        image.save(plane, "JPEG", quality=JPEG_QUALITY, subsampling=0)
        files[f"plane_{k}.jpg"] = plane.getvalue()
    return files, white


def _planes(result: Result) -> tuple[Codes, Array, Array, float]:
    """Codes (H, W, 9, 3) of hemispherical harmonics, steps and zeros (9,) as of `_coded`, white."""
    coefficients, _, white = _fitted(result, harmonics)
    of_pixels, steps, zeros = _coded(coefficients.reshape(9, -1))
    of_pixels = np.moveaxis(of_pixels.reshape(coefficients.shape), 0, 1)
    return _placed(of_pixels, zeros[:, None], result.mask), steps, zeros, white


def directions() -> Array:
    """(DIRECTIONS, 3) unit vectors to lights, evenly spread over the hemisphere of the viewer."""
    return spread_directions(DIRECTIONS, 1 - np.sin(np.radians(LOWEST)))


def basis(light: Array) -> Array:
    """(..., 6): what coefficients of a texture map are multiplied by, of vectors (..., 2 or 3)."""
    u, v = light[..., 0], light[..., 1]
    return np.stack([u * u, v * v, u * v, u, v, np.ones_like(u)], axis=-1)


def _relit(result: Result, direction: Array) -> Array:
    lamp = Lamps(np.zeros(1, np.intp), direction[None], colors=np.ones((1, 3)))
    return relight(result, lamp)


def _coded(coefficients: Array) -> tuple[Array, Array, Array]:
    """Codes of coefficients (K, M); what a code of each means, and which means 0, (K,)."""
    low = np.minimum(coefficients.min(axis=1), 0.0)
    high = np.maximum(coefficients.max(axis=1), 0.0)
    steps = np.round(np.maximum((high - low) / CODES, SCALE_MIN), 9)
    zeros = np.abs(np.rint(low / steps))
    codes = np.rint(coefficients / steps[:, None]) + zeros[:, None]
    return np.clip(codes, 0, 255), steps, zeros


def _placed(codes: Array, outside: Array, mask: Mask) -> Codes:
    """(H, W, ...): codes (P, ...) of the pixels in the mask, and those of all others."""
    found = np.empty((*mask.shape, *codes.shape[1:]), np.uint8)
    found[:] = outside
    found[mask] = codes
    return found


FILES = {
    "ptm": (ptm, "polynomial texture map, LRGB: the surface under a hard light from any direction"),
    "rti": (rti, "hemispherical harmonics for RTIViewer: the surface under a hard light"),
}
"""What makes `relit.ptm` and `relit.rti`, and what these hold."""
