"""How much the suite measures."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Effort:
    """How much is measured."""

    name: str
    band_points: int
    pixels_of_a_kind: int
    pictures: int
    branch_pixels: int
    scan_points: int
    residual_pixels: int
    summed_pixels: tuple[int, ...]
    summed_pictures: int
    summed_many: tuple[int, int]
    draws: int
    subnormal_pixels: int
    repeated: tuple[tuple[int, int], ...]
    fit_size: int
    fit_pictures: int
    fit_iterations: int


FULL = Effort(
    name="full",
    band_points=12_000,
    pixels_of_a_kind=393_216,
    pictures=8,
    branch_pixels=64,
    scan_points=201,
    residual_pixels=65_536,
    summed_pixels=tuple(4**k for k in range(3, 11)),
    summed_pictures=16,
    summed_many=(65_536, 256),
    draws=32,
    subnormal_pixels=65_536,
    repeated=((1, 1), (17, 3), (1000, 5), (70_001, 4), (300_000, 2)),
    fit_size=48,
    fit_pictures=16,
    fit_iterations=300,
)

QUICK = Effort(
    name="quick",
    band_points=2_000,
    pixels_of_a_kind=8_192,
    pictures=8,
    branch_pixels=32,
    scan_points=41,
    residual_pixels=4_096,
    summed_pixels=tuple(4**k for k in range(3, 9)),
    summed_pictures=16,
    summed_many=(4096, 256),
    draws=8,
    subnormal_pixels=8_192,
    repeated=((1, 1), (17, 3), (1000, 5), (20_001, 4)),
    fit_size=10,
    fit_pictures=5,
    fit_iterations=20,
)
