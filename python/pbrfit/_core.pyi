"""The Rust core: flat arrays in, flat arrays out; `pbrfit` wraps it."""

from collections.abc import Iterator, Sequence
from os import PathLike
from typing import Any, Protocol, TypedDict, Unpack, final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Environment",
    "InputError",
    "KeptSystem",
    "LampSamples",
    "Problem",
    "Raster",
    "Surroundings",
    "allow_end",
    "average_light",
    "decode_exr",
    "decode_icc",
    "decode_raster",
    "encode_png",
    "end_when_told",
    "environment_lobes",
    "finished",
    "ggx_band_weights",
    "hold_end",
    "image_format",
    "lamp_radiance",
    "last_word",
    "lobe_functions",
    "lobe_table",
    "poisson_heights",
    "render",
    "sh_basis",
    "shade",
    "shade_vjp",
    "tiff_pages",
    "unfinished",
    "write_exr",
    "write_png",
]

class InputError(ValueError): ...

def sh_basis(directions: NDArray[np.float64]) -> NDArray[np.float64]: ...
def ggx_band_weights(
    r: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
def lobe_functions(
    r: NDArray[np.float64],
    cosine: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]: ...
def lobe_table() -> bytes: ...
def shade(
    normal: NDArray[np.float64],
    view: NDArray[np.float64],
    albedo: NDArray[np.float64],
    roughness: NDArray[np.float64],
    metallic: NDArray[np.float64],
    model: str = "paper",
) -> NDArray[np.float64]: ...
def shade_vjp(
    normal: NDArray[np.float64],
    view: NDArray[np.float64],
    albedo: NDArray[np.float64],
    roughness: NDArray[np.float64],
    metallic: NDArray[np.float64],
    cotangent: NDArray[np.float64],
    model: str = "paper",
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]: ...
def poisson_heights(
    across: NDArray[np.float64],
    down: NDArray[np.float64],
    held: NDArray[np.float64],
    right: NDArray[np.float64],
    start: NDArray[np.float64],
    enough: float,
    threads: int,
) -> NDArray[np.float64]: ...
def render(
    normals: NDArray[np.float64],
    views: NDArray[np.float64],
    albedo: NDArray[np.float64],
    roughness: NDArray[np.float64],
    metallic: NDArray[np.float64],
    lighting: NDArray[np.float64],
    threads: int,
    model: str = "paper",
    transfer: NDArray[np.float32] | None = None,
    bounced: NDArray[np.float32] | None = None,
) -> NDArray[np.float64]: ...
def lamp_radiance(
    normals: NDArray[np.float64],
    views: NDArray[np.float64],
    albedo: NDArray[np.float64],
    roughness: NDArray[np.float64],
    metallic: NDArray[np.float64],
    directions: NDArray[np.float64],
    threads: int,
    model: str = "paper",
    extents: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """Radiance π f_r (n·l) (P, K, 3) under unit light of the lamps at directions (P, K, 3).

    Extents (P K,) are angular radii, radians; None = points.
    """

def environment_lobes(model: str) -> NDArray[np.float32]:
    """Angle, level, a and b of each lobe, by roughness and √n·v: (R, X, K, 4)."""

@final
class Environment:
    """A panorama (H, 2H, 3) as light, blurred by round lobes."""

    def __new__(cls, pixels: NDArray[np.float32], threads: int) -> Environment: ...
    def levels(self) -> list[NDArray[np.float32]]:
        """The panorama by growing blur, and its two hemispheres: (rows, columns, 3) each."""

    def radiance(
        self,
        normals: NDArray[np.float64],
        views: NDArray[np.float64],
        albedo: NDArray[np.float64],
        roughness: NDArray[np.float64],
        metallic: NDArray[np.float64],
        turn: float,
        threads: int,
        model: str,
    ) -> NDArray[np.float64]:
        """Radiance (P, 3) of pixels under the light turned by so many radians."""

_Surfaces = tuple[
    NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]
]

@final
class LampSamples:
    """Samples of P pixels in N pictures, under K known lamps and light from all sides.

    pictures (P, N, 3) are linear radiance; limits (P, N, 3) 0 data, 1 radiance is at least this, 2
    at most. Lamp k at directions (P, K, 3) brings intensities (P, K, 3) to picture_of[k], in rising
    order; both may be (1, K, 3), alike of all pixels. ambient (N, 3) is SH light beside the lamps,
    its first coefficient. Methods take weights (P, N, 3) of squared residuals, 0 without data, and
    surfaces: normals (P, 3), albedo (P, 3), roughness and metallic (P,).
    """

    def __new__(
        cls,
        pictures: NDArray[np.float64],
        limits: NDArray[np.uint8] | None,
        views: NDArray[np.float64],
        directions: NDArray[np.float64],
        intensities: NDArray[np.float64],
        picture_of: NDArray[np.uint64],
        ambient: NDArray[np.float64],
        threads: int,
        model: str = "paper",
    ) -> LampSamples: ...
    def fit(
        self,
        weights: NDArray[np.float64],
        base_normals: NDArray[np.float64],
        start: _Surfaces,
        prior: tuple[NDArray[np.float64], NDArray[np.float64]],
        free: tuple[bool, bool, bool],
        iterations: int,
    ) -> tuple[
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
    ]:
        """Surface of each pixel by itself, never worse than the start.

        Start normals have to be less than 90 degrees from base normals. Means and precisions (P, 7)
        of the prior are of [tangent offset (a, b) of the base normal, albedo, roughness, metallic]
        and add Σ precision (x − mean)². What is free beside the albedo are normals, metallic,
        roughness; this, if free, starts from 0.03 at least where there are data. Returns the
        surfaces and costs (P,).
        """

    def system(
        self,
        weights: NDArray[np.float64],
        surfaces: _Surfaces,
        strengths: NDArray[np.float64],
        by_place: NDArray[np.float64],
        of_lights: bool = True,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64] | None]:
        """Normal equations of pixels and of the lights that they share.

        strengths (P, K): what lamps bring for a colour of 1. by_place (P, K, 4): how much a lamp's
        direction turns when its place moves across it, and the derivative of ln strength by its
        place. Both are (1, ...) where directions are. The lights' unknowns, M, are places (K, 3),
        colours (K, 3), ambient light (N, 3); a pixel's are offsets (a, b) of its normal, albedo,
        roughness. With Jacobians J of lights and pixels, weights W, residuals e: JₚᵀWJₚ and below
        it JₚᵀWe (P, 7, 6); JₚᵀWJₗ and below it JₗᵀWe (P, 7, M); if asked Σ JₗᵀWJₗ (M, M).
        """

    def judge(
        self,
        weights: NDArray[np.float64],
        surfaces: _Surfaces,
        noise: tuple[float, float, bool, float],
        shadows: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """How likely samples are, and what they weigh.

        By (floor, growth, proportional, least) of the noise a sample y has the variance floor² +
        growth y (`proportional`: y²), or is in a cast shadow, with the probability shadows (N,), if
        it is darker than shown; radiance and residuals count as `least` at least. Returns ln of
        the odds (P, N) that samples are in none, ∞ where no darker; ln of the likelihood (P,); what
        samples weigh in a shadow and in none (P, N, 2, 3).
        """

class _Series(Protocol):
    """Pictures (P, C), one after the other."""

    def __len__(self) -> int: ...
    def __iter__(self) -> Iterator[NDArray[np.float32] | NDArray[np.float64]]: ...

class _Elimination(TypedDict, total=False):
    """How the pixels are eliminated from the normal equations.

    A share `damping` of its diagonal is added to the matrix of each pixel. With `mono` all channels
    have the same light. precision a and deviation v − c − o, both (P', F), are those of a Gaussian
    prior Σ a (v − c − o)² of the F unknowns of a pixel after albedo. With `cluster`, the number
    (P',) that each has and how many clusters G there are, their offsets o (G, F) are shared
    unknowns too, the last.
    """

    damping: float
    mono: bool
    precision: NDArray[np.float64] | None
    deviation: NDArray[np.float64] | None
    cluster: tuple[NDArray[np.uint64], int] | None

@final
class Problem:
    """The pictures of one scene, and the loss over them.

    images (N, P, C) float32 with C = 1 or 3, or a series of (P, C), taken one after the other:
    those in float64 are kept to 48 bits, of which all methods but value_and_grad take notice.
    normals, views (P, 3) float64 unit vectors; weights (N, P) or (N, P, C) float32; lighting
    (N, K, C) float64, known; metallic a number, known; threads 0 = all. K = (sh_order + 1)²,
    sh_order 2 or 3.
    Unknowns x = [albedo (C planes of P) | roughness | metallic | tangent offsets (2 planes) |
    lighting (N, K, C)], without those that are known; normals are unless `free_normals`. A tangent
    offset (a, b), at most 1e3 in size, moves the given normal to (normal + a t₁ + b t₂)/√(1 + a² +
    b²). The loss is the (weighted) mean of the squared residuals.
    `transfer` (P, R, 16) are rows in the place of the model's, the matt part's first: R = 5 of the
    paper's model, 11 of the principled one; and `bounced` (P, R, N·C) what is brought to each, in
    the unit of the images. Not with `free_normals`.
    """

    def __new__(
        cls,
        images: NDArray[np.float32] | _Series,
        normals: NDArray[np.float64],
        views: NDArray[np.float64],
        threads: int = 0,
        *,
        weights: NDArray[np.float32] | None = None,
        sh_order: int = 3,
        metallic: float | None = None,
        lighting: NDArray[np.float64] | None = None,
        free_normals: bool = False,
        model: str = "paper",
        transfer: NDArray[np.float32] | None = None,
        bounced: NDArray[np.float32] | None = None,
    ) -> Problem: ...
    @property
    def size(self) -> int: ...
    @property
    def pixels(self) -> int: ...
    @property
    def pictures(self) -> int: ...
    @property
    def channels(self) -> int: ...
    @property
    def coefficients(self) -> int: ...
    def value_and_grad(
        self,
        x: NDArray[np.float64],
        out: NDArray[np.float64] | None = None,
    ) -> tuple[float, NDArray[np.float64]]:
        """Loss at x and its gradient, which is `out` where that is given.

        `out` is as long as x, contiguous, and may be x itself; its memory is warm at the second
        call, which a new array's never is. After an error it holds nothing that means anything.
        """
    def residuals(self, x: NDArray[np.float64], pixels: NDArray[np.uint64]) -> NDArray[np.float32]:
        """Rendered minus given radiance (N, len(pixels), C) at some pixels, whatever the weights.

        `pixels` are indices below P, in any order.
        """
    def normals(self, maps: NDArray[np.float64]) -> NDArray[np.float64]:
        """Unit normals (P, 3) at the tangent offsets of `maps`, which is x without its lighting."""
    def light_equations(
        self, maps: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Gram matrices (C, 1 or N, K, K) and right sides (C, N, K) of the lights.

        `maps` is x without its lighting. One Gram matrix for all pictures, or one for each where
        samples have weights.
        """
    def material_grid(
        self,
        x: NDArray[np.float64],
        pixels: NDArray[np.uint64],
        roughness: NDArray[np.float64],
        metallic: NDArray[np.float64],
    ) -> NDArray[np.float32]:
        """Least Σω(I−T)² over albedo (P', roughness, metallic) with the lights of x."""
    def fit_materials(
        self,
        x: NDArray[np.float64],
        pixels: NDArray[np.uint64],
        roughness: NDArray[np.float64],
        metallic: NDArray[np.float64],
        *,
        starts: int = 1,
        steps: int = 10,
        exact_steps: int = 1,
        mean: NDArray[np.float64] | None = None,
        precision: NDArray[np.float64] | None = None,
        held_normals: bool = False,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Materials (P', D) that fit best with the lights of x, and Σω(I−T)² (P',) with them.

        Of each pixel alone: the lowest of what is reached from its material in x and from the
        `starts` lowest local minima of the grid roughness × metallic (no grid if one is empty;
        metallic is not read where it is known), by `steps` Levenberg-Marquardt steps on products
        over pictures. Then `exact_steps` on residuals; without, sums have half of the digits.
        Never worse than in x. `mean` and `precision` (P', F) of a Gaussian prior of the F unknowns
        after albedo add Σ precision (v − mean)² to what is minimised, not to the sums returned.
        The D unknowns of a pixel: albedo by channel, roughness, metallic unless it is known and, if
        normals are free, both tangent offsets. These move in the steps on residuals alone, from the
        material of x and from the best found at its normals; not if `held_normals`.
        """
    def best_albedo(
        self, x: NDArray[np.float64], pixels: NDArray[np.uint64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Albedo (P', C) that fits best to the rest of x, and Σω(I−T)² (P',) with it."""
    def normal_equations(
        self, x: NDArray[np.float64], pixels: NDArray[np.uint64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """JᵀΩJ (P', D, D), JᵀΩ(I−T) (P', D) and Σω(I−T)² (P',) of some pixels, the lights held.

        The D unknowns of a pixel: albedo by channel, roughness, metallic unless it is known and, if
        normals are free, both tangent offsets.
        """
    def derivatives(
        self, x: NDArray[np.float64], pixels: NDArray[np.uint64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Derivatives of the radiance of some pixels, and the weights of the samples (P', N, C).

        By the channel's albedo, roughness, metallic and, if normals are free, both tangent offsets,
        (P', N, C, 3 or 5); and by the light, the same for all pictures, (P', C, K).
        """
    def moves_with_lights(
        self,
        x: NDArray[np.float64],
        pixels: NDArray[np.uint64],
        covariances: NDArray[np.float64],
        modes: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Σ over modes of the square of what they move the materials of some pixels by, (P', D).

        covariances (P', D, D), the inverse of JᵀΩJ; modes (M, N, K, C) of the lights. Also
        Jᵀ Ω by the lights of x, (P', D): what their scale changes.
        """
    def schur_complement(
        self,
        x: NDArray[np.float64],
        pixels: NDArray[np.uint64],
        **options: Unpack[_Elimination],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Schur complement S (M, M) and gradient s (M,) of the lights, some pixels eliminated.

        The M unknowns are (light channel, picture, coefficient), then offsets of clusters.
        """
    def kept_system(
        self,
        x: NDArray[np.float64],
        pixels: NDArray[np.uint64],
        **options: Unpack[_Elimination],
    ) -> KeptSystem:
        """S v of `schur_complement` for any number of v, and s, without making S.

        4 C (K + N D) bytes a pixel, D = 3 or, if normals are free, 5; 4 C N more with weights.
        """
    def back_substitute(
        self,
        x: NDArray[np.float64],
        pixels: NDArray[np.uint64],
        v: NDArray[np.float64],
        **options: Unpack[_Elimination],
    ) -> NDArray[np.float64]:
        """Unknowns (P', D) that a Gauss-Newton step leads to when the lights move by v (M,).

        Materials are clipped to [0, 1]. Tangent offsets move by 0.3 at most, the other unknowns
        as is best with that, and grow no longer than tan 60°.
        """

@final
class KeptSystem:
    """The lights' system at one x, some pixels eliminated once for all: `Problem.kept_system`."""

    @property
    def gradient(self) -> NDArray[np.float64]:
        """The gradient s (M,)."""
    def product(self, v: NDArray[np.float64]) -> NDArray[np.float64]:
        """S v (M,), rounded to float32 on the way: to 1e-6 of its part that ignores materials."""

@final
class Surroundings:
    """Triangles (T, 3, 3) that light meets, from either side; each is of a surface, by number."""

    def __new__(
        cls, triangles: NDArray[np.float32], surfaces: NDArray[np.uint8]
    ) -> Surroundings: ...
    @property
    def last_surface(self) -> int:
        """The highest number of a surface."""
    def distances(
        self, origins: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> NDArray[np.float32]:
        """Distance (R,) to what each ray meets first, infinite where it leaves."""
    def transfer(
        self,
        points: NDArray[np.float64],
        normals: NDArray[np.float64],
        views: NDArray[np.float64],
        seeds: NDArray[np.uint64],
        *,
        rays: int,
        model: str,
        threads: int = 0,
        radiance: NDArray[np.float32] | None = None,
        half_width: float = 0.0,
        nearest: NDArray[np.uint32] | None = None,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        """Rows (P, R, 16) of pixels, and what is brought to them (P, R, V), from rays of each.

        Rays start at points (P, 3), and follow from a pixel's own number in seeds (P,). `radiance`
        (H, W, V), V values of each pixel of pictures, tells what a blocked ray brings; None =
        nothing. `half_width` is the tangent of half of their horizontal field of view, 0 =
        orthographic. `nearest` (S·H·W,) has for each surface from number 1 on, and each pixel, the
        pixel that shows the surface nearest to it; surface 0 is whatever a pixel shows.
        """

@final
class Raster:
    @property
    def format(self) -> str: ...
    @property
    def samples(self) -> NDArray[Any]: ...
    @property
    def icc_profile(self) -> bytes | None: ...
    @property
    def exif(self) -> bytes | None: ...
    @property
    def orientation(self) -> int: ...
    @property
    def code_points(self) -> list[int] | None: ...
    @property
    def gamma(self) -> float | None: ...
    @property
    def chromaticities(self) -> list[tuple[float, float]] | None: ...
    @property
    def passed_over(self) -> int: ...

def image_format(data: bytes) -> str | None: ...
def decode_exr(
    data: bytes, path: str | PathLike[str]
) -> tuple[dict[str, NDArray[np.float32]], list[tuple[float, float]] | None, list[str]]: ...
def decode_raster(
    data: bytes, path: str | PathLike[str], indices: bool, page: int | None = None
) -> Raster: ...
def tiff_pages(path: str | PathLike[str]) -> int: ...
def decode_icc(
    profile: bytes, levels: int, path: str | PathLike[str]
) -> tuple[list[NDArray[np.float32]], list[list[float]] | None]: ...
def average_light(
    samples: NDArray[Any],
    used: Sequence[tuple[int, int]],
    curves: NDArray[np.float32],
    codes: tuple[int, int] | None,
    colors: NDArray[np.uint8],
    pixels: NDArray[np.float32],
    limits: NDArray[np.uint8],
) -> bool: ...
def write_exr(
    path: str | PathLike[str], channels: Sequence[tuple[str, NDArray[np.float32]]], half: bool
) -> None: ...
def write_png(path: str | PathLike[str], image: NDArray[Any], tag: str | None) -> None:
    """Write a PNG file: (H, W) or (H, W, 1 to 4), uint8 or uint16, already encoded.

    The tag is what the file says about its encoding: "srgb" (sRGB chunk), "linear" (gAMA chunk of
    1: data, or linear light) or None (nothing). Equal images give equal bytes. An existing file is
    replaced, as a whole or not at all. Raises InputError if the shape or type of `image` is wrong.
    """

def encode_png(image: NDArray[Any], tag: str | None) -> bytes:
    """Give the bytes that `write_png` would write."""

def unfinished(
    temporary: str | PathLike[str],
    aside: tuple[str | PathLike[str], str | PathLike[str]] | None = None,
    parents: Sequence[str | PathLike[str]] = ...,
) -> int: ...
def finished(number: int) -> None: ...
def hold_end() -> None: ...
def allow_end() -> None: ...
def last_word() -> bool: ...
def end_when_told(grace: float, word: str, signals: list[int]) -> int | None: ...
