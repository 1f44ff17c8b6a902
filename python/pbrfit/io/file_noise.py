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
from pbrfit.io.jpeg_noise import SIDE, Tables, block_variances
from pbrfit.io.resampling import area_shares

ROUNDING = 1 / 12
"""Variance of rounding, in codes²."""


@dataclass(frozen=True, eq=False)
class FileNoise:
    """Of one picture of integers, small: nothing a sample is kept."""

    conversion: Conversion
    levels: int
    """Codes there are: 256 or 65536."""
    rounding: float
    """Variance of rounding to codes that is left in a sample, in codes²."""
    blocks: NDArray[np.float16] | None
    """(rows, columns, 3): of R, G and B, what JPEG adds: a standard deviation, in codes."""
    rows: NDArray[np.int32]
    columns: NDArray[np.int32]
    """(H,) and (W,): in which block a sample is."""
    correlation: float
    """Of these errors with those of another picture of the view: 0 for rounding."""

    def deviation(
        self,
        pixels: NDArray[np.floating[Any]],
        rows: slice = slice(None),
        columns: slice = slice(None),
    ) -> NDArray[np.float32]:
        """Standard deviations (h, w, 3) of some rows and columns, which are `pixels` (h, w, 3)."""
        variance: NDArray[np.float32] = np.full(3, self.rounding, dtype=np.float32)
        if self.blocks is not None:
            of_blocks = np.square(self.blocks, dtype=np.float32)
            variance = variance + of_blocks[np.ix_(self.rows[rows], self.columns[columns])]
        variance = variance * np.square(self.conversion.slopes(pixels, self.levels))
        matrix = self.conversion.matrix
        if matrix is not None:
            variance = variance @ np.square(matrix).T.astype(np.float32)
        return np.asarray(np.sqrt(variance, dtype=np.float32))


@dataclass(frozen=True, eq=False)
class Stored:
    """Samples as a file holds them, from which `FileNoise` is made."""

    codes: NDArray[Any]
    """(H, W, 1 or 3), uint8 or uint16, before they are turned."""
    orientation: int
    """EXIF 2.32: 1 to 8."""
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
        turned = self.orientation >= 5
        small = size[::-1] if turned else size
        full = self.codes.shape[:2]
        rounding = ROUNDING
        for length, to in zip(full, small, strict=True):
            if length != to:
                rounding *= float(area_shares(length, to).power(2).sum()) / to
        places = [
            ((np.arange(to) + 0.5) * length / to).astype(np.int32) // SIDE
            for length, to in zip(full, small, strict=True)
        ]
        blocks, correlation = None, 0.0
        if self.tables is not None:
            variances, shared = block_variances(self.codes, self.tables, small)
            if variances.shape[0] > small[0] or variances.shape[1] > small[1]:
                variances = variances[np.ix_(*places)]
                places = [np.arange(to, dtype=np.int32) for to in small]
            blocks = np.sqrt(variances).astype(np.float16)
            correlation = shared / (float(variances.mean()) + rounding)
        rows, columns = places
        if turned:
            blocks = None if blocks is None else blocks.swapaxes(0, 1)
            rows, columns = columns, rows
        # As the samples themselves are turned, see `images`.
        if self.orientation in (2, 3, 6, 7):
            columns = columns[::-1]
        if self.orientation in (3, 4, 7, 8):
            rows = rows[::-1]
        maximum = int(np.iinfo(self.codes.dtype).max)
        return FileNoise(self.conversion, maximum + 1, rounding, blocks, rows, columns, correlation)
