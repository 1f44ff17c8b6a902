"""What files did to their samples: standard deviations of quantisation, in linear radiance.

A code is the true one rounded, off by 1/√12 (uniform error), or more where a JPEG's coefficients
were rounded (`pbrfit.io.jpeg_noise`). The slope of the decoding curve turns deviations of codes
into those of radiance, and a matrix M, squared entry by entry, variances into those of its colours,
as if channels were independent. A mean of samples with shares s_i and independent errors has Σ s_i²
of the variance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.io.color import Conversion
from pbrfit.io.jpeg_noise import Tables, jpeg_variance, kept_variance


@dataclass(frozen=True, eq=False)
class FileNoise:
    """Of one picture of integers."""

    conversion: Conversion
    levels: int
    """Codes there are: 256 or 65536."""
    variance: NDArray[np.float64]
    """(3,): of the errors of R, G and B, in codes²."""
    correlation: float
    """Of these errors with those of another picture of the view: 0 for rounding."""

    def deviation(self, pixels: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
        """Standard deviations of `pixels` (..., 3)."""
        slopes = self.conversion.slopes(pixels, self.levels)
        variance = np.square(slopes) * self.variance.astype(np.float32)
        matrix = self.conversion.matrix
        if matrix is not None:
            variance = variance @ np.square(matrix).T.astype(np.float32)
        return np.asarray(np.sqrt(variance, dtype=np.float32))


@dataclass(frozen=True, eq=False)
class Stored:
    """Samples as a file holds them, from which `FileNoise` is made."""

    codes: NDArray[Any]
    """(H, W, 1 or 3), uint8 or uint16, before they are turned."""
    turned: bool
    """Whether their rows are to be seen as columns."""
    conversion: Conversion
    form: str
    """Name of the format."""
    tables: Tables | None
    """Of a JPEG file."""

    def in_words(self) -> str:
        """The form of the file, in short."""
        of_jpeg = f", {self.tables.in_words()}" if self.tables is not None else ""
        return f"{8 * self.codes.dtype.itemsize}-bit {self.form}{of_jpeg}"

    def noise(self, size: tuple[int, int]) -> FileNoise:
        """Of the picture averaged down to `size`, (height, width) as it is to be seen."""
        small = size[::-1] if self.turned else size
        rounding = 1 / 12
        for length, to in zip(self.codes.shape, small, strict=False):
            rounding *= float(kept_variance(length, to).sum())
        variance, shared = np.full(3, rounding), 0.0
        if self.tables is not None:
            of_jpeg, shared = jpeg_variance(self.codes, self.tables, small)
            variance += of_jpeg
        levels = int(np.iinfo(self.codes.dtype).max) + 1
        return FileNoise(self.conversion, levels, variance, shared / float(variance.mean()))
