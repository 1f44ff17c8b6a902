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
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io.color import encode_srgb
from pbrfit.model.lamps import Lamps
from pbrfit.result import metrics
from pbrfit.result.relighting import relight
from pbrfit.result.result import Result

Array = NDArray[np.float64]

LP_FILE = "lamps.lp"
LP_HOLDS = "directions to the lamps, X right, Y up, Z to the viewer, by picture file"

PTM_FILE = "relit.ptm"
PTM_HOLDS = "polynomial texture map, LRGB: the surface under a hard light from any direction"

RTI_FILE = "relit.rti"
RTI_HOLDS = "hemispherical harmonics for RTIViewer: the surface under a hard light"

WEB_FOLDER = "openlime"
WEB_HOLDS = {
    "info.json": "hemispherical harmonics for web viewers (OpenLIME): scales of the planes",
    **{f"plane_{k}.jpg": f"coefficient {k + 1} of 9, of red, green and blue" for k in range(9)},
}

JPEG_QUALITY = 95
"""Of planes."""

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
    coefficients = 255 * np.einsum("kpc,pc->kp", fitted, along)
    return _file(coefficients, color, result.mask), white


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
    """(..., 9) hemispherical harmonics H_k of unit vectors (..., 3) to lights.

    With z = l_w, s = √(z − z²), c and s' of the azimuth: orders 0 to 2, in the order of `.rti`.
    """
    z = light[..., 2]
    around = np.arctan2(light[..., 1], light[..., 0])
    cosine, sine, s, t = np.cos(around), np.sin(around), np.sqrt(z - z * z), 2 * z - 1
    one, two, three = np.sqrt(6 / np.pi), np.sqrt(30 / np.pi), 1 / np.sqrt(2 * np.pi)
    return np.stack(
        [
            np.full_like(z, three),
            one * cosine * s,
            np.sqrt(3) * three * t,
            one * sine * s,
            two * np.cos(2 * around) * (z * z - z),
            two * cosine * t * s,
            np.sqrt(5) * three * (1 - 6 * z + 6 * z * z),
            two * sine * t * s,
            two * np.sin(2 * around) * (z * z - z),
        ],
        axis=-1,
    )


def hemispherical(result: Result) -> tuple[bytes, dict[str, bytes], float]:
    """Hemispherical harmonics of a result: `.rti`, files for the web, and the radiance of white.

    A code c from 0 to 255 of coefficient k means c/255 · scale_k + low_k in all channels, and 0
    has a whole code. Pixels outside the mask are black. `.rti` has rows from below, and of each
    pixel all of red, green, blue; plane k of the web is a JPEG of coefficient k of the three.
    """
    from PIL import Image  # here: it takes longer to import than most of this package

    coefficients, _, white = _fitted(result, harmonics)
    steps, zeros = _steps(coefficients.reshape(9, -1))
    codes = np.empty((*result.mask.shape, 9, 3), np.uint8)
    codes[:] = zeros[:, None]
    values = np.moveaxis(coefficients, 0, 1) / steps[:, None] + zeros[:, None]
    codes[result.mask] = np.clip(np.rint(values), 0, 255)
    scale, low = 255 * steps, -zeros * steps
    height, width = result.mask.shape
    head = f"#HSH1.2\n3\n{width} {height} 3\n9 2 1\n".encode("ascii")
    little = (part.astype("<f4").tobytes() for part in (scale, low))
    rti = b"".join([head, *little, codes[::-1].swapaxes(2, 3).tobytes()])
    info = {"width": width, "height": height, "format": "jpg", "quality": JPEG_QUALITY}
    info |= {"type": "hsh", "colorspace": "rgb", "nplanes": 27}
    info["materials"] = [{"scale": _thrice(scale), "bias": _thrice(zeros / 255)}]
    files = {"info.json": json.dumps(info, indent=1).encode()}
    for k in range(9):
        plane = io.BytesIO()
        image = Image.fromarray(codes[:, :, k])
        image.save(plane, "JPEG", quality=JPEG_QUALITY, subsampling=0)
        files[f"plane_{k}.jpg"] = plane.getvalue()
    return rti, files, white


def _thrice(values: Array) -> list[float]:
    return np.repeat(values, 3).astype(float).tolist()


def directions() -> Array:
    """(DIRECTIONS, 3) unit vectors to lights, evenly spread over the hemisphere of the viewer."""
    index = np.arange(DIRECTIONS)
    z = 1 - (index + 0.5) / DIRECTIONS * (1 - np.sin(np.radians(LOWEST)))
    around = index * np.pi * (3 - np.sqrt(5))
    across = np.sqrt(1 - z * z)
    return np.stack([across * np.cos(around), across * np.sin(around), z], axis=-1)


def basis(light: Array) -> Array:
    """(..., 6): what coefficients of a texture map are multiplied by, of vectors (..., 2 or 3)."""
    u, v = light[..., 0], light[..., 1]
    return np.stack([u * u, v * v, u * v, u, v, np.ones_like(u)], axis=-1)


def _relit(result: Result, direction: Array) -> Array:
    lamp = Lamps(np.zeros(1, np.intp), direction[None], colors=np.ones((1, 3)))
    return relight(result, lamp)


def _steps(coefficients: Array) -> tuple[Array, NDArray[np.intp]]:
    """What a code of each coefficient (K, ...) means, and the code that means 0."""
    low = np.minimum(coefficients.min(axis=1), 0.0)
    high = np.maximum(coefficients.max(axis=1), 0.0)
    steps = np.round(np.maximum((high - low) / CODES, SCALE_MIN), 9)
    return steps, np.rint(-low / steps).astype(np.intp)


def _file(coefficients: Array, color: Array, inside: NDArray[np.bool_]) -> bytes:
    """Of coefficients (6, P) in codes of brightness and colours (P, 3) from 0 to 1."""
    scales, biases = _steps(coefficients)
    codes = np.clip(np.rint(coefficients / scales[:, None]) + biases[:, None], 0, 255)
    height, width = inside.shape
    blocks = []
    for values, outside in ((codes.T, biases), (np.rint(255 * color), np.zeros(3))):
        block = np.empty((height, width, values.shape[-1]), np.uint8)
        block[:] = np.clip(outside, 0, 255)
        block[inside] = values
        blocks.append(block[::-1].tobytes())  # rows from below
    head = [
        *("PTM_1.2", "PTM_FORMAT_LRGB", str(width), str(height)),
        " ".join(f"{scale:.9f}" for scale in scales),
        " ".join(map(str, biases.tolist())),
        "",
    ]
    return "\n".join(head).encode("ascii") + b"".join(blocks)
