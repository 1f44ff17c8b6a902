"""The Rust core: flat arrays in, flat arrays out; `pbrfit` wraps it."""

from typing import final

import numpy as np
from numpy.typing import NDArray

class InputError(ValueError): ...

def sh_basis(directions: NDArray[np.float64]) -> NDArray[np.float64]: ...
def ggx_band_weights(
    roughness: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
def shade(
    normal: NDArray[np.float64],
    view: NDArray[np.float64],
    albedo: NDArray[np.float64],
    roughness: NDArray[np.float64],
    metallic: NDArray[np.float64],
) -> NDArray[np.float64]: ...
def shade_vjp(
    normal: NDArray[np.float64],
    view: NDArray[np.float64],
    albedo: NDArray[np.float64],
    roughness: NDArray[np.float64],
    metallic: NDArray[np.float64],
    cotangent: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]: ...
def render(
    normals: NDArray[np.float64],
    views: NDArray[np.float64],
    albedo: NDArray[np.float64],
    roughness: NDArray[np.float64],
    metallic: NDArray[np.float64],
    lighting: NDArray[np.float64],
    threads: int,
) -> NDArray[np.float64]: ...
@final
class Problem:
    """The pictures of one scene, and the loss over them.

    images (N, P, 3) float32; normals, views (P, 3) float64 unit vectors; threads 0 = all.
    Unknowns x = [albedo R | G | B | roughness | metallic (P each) | lighting (N, 16, 3)].
    """

    def __new__(
        cls,
        images: NDArray[np.float32],
        normals: NDArray[np.float64],
        views: NDArray[np.float64],
        threads: int = 0,
    ) -> Problem: ...
    @property
    def size(self) -> int: ...
    @property
    def pixels(self) -> int: ...
    @property
    def pictures(self) -> int: ...
    def value_and_grad(self, x: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]: ...
    def render(self, x: NDArray[np.float64]) -> NDArray[np.float32]: ...
    def light_equations(
        self, x: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
