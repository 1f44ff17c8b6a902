"""Our own time over picture size P and number of pictures N, and how well a P + b P N fits it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from tqdm import tqdm

from peers.case import Case
from peers.ours import Ours

FULL = ((128, 256, 512, 1024, 2048), (8, 16, 32, 64))
QUICK = ((64, 128), (8, 16))
PICTURES = 16
"""While the size varies."""
SIDE = 256
"""While the number of pictures varies."""


@dataclass(frozen=True)
class Point:
    """One size: median time and quartiles of an evaluation."""

    side: int
    pictures: int
    median_ms: float
    quartiles_ms: tuple[float, float]

    @property
    def pixels(self) -> int:
        """P."""
        return self.side * self.side


@dataclass(frozen=True)
class Scaling:
    """The points, and the fit t = a P + b P N.

    Attributes
    ----------
    per_pixel_ns, per_sample_ns
        a, and b: a sample is a pixel of one picture, all three channels.
    """

    points: tuple[Point, ...]
    threads: int
    rounds: int
    per_pixel_ns: float
    per_sample_ns: float

    def fitted_ms(self, pixels: float, pictures: float) -> float:
        """The fit."""
        return 1e-6 * pixels * (self.per_pixel_ns + self.per_sample_ns * pictures)

    def deviation(self, point: Point) -> float:
        """Measured over fitted, minus 1."""
        return point.median_ms / self.fitted_ms(point.pixels, point.pictures) - 1

    @property
    def worst(self) -> Point:
        """The point farthest from the fit."""
        return max(self.points, key=lambda point: abs(self.deviation(point)))


def measure(sides: Sequence[int], counts: Sequence[int], threads: int, rounds: int) -> Scaling:
    """Time every size in turn, round by round, and fit."""
    sizes = [(side, PICTURES) for side in sides]
    sizes += [(SIDE, count) for count in counts if (SIDE, count) not in sizes]
    problems = [Ours(Case.make(side * side, count), threads) for side, count in sizes]
    seconds: list[list[float]] = [[] for _ in sizes]
    for _ in tqdm(range(rounds), desc="rounds", disable=None):
        for problem, of_size in zip(problems, seconds, strict=True):
            problem.evaluate()  # caches hold this size again
            start = time.perf_counter()
            problem.evaluate()
            of_size.append(time.perf_counter() - start)
    points = []
    for (side, count), of_size in zip(sizes, seconds, strict=True):
        lower, median, upper = (float(q) for q in 1e3 * np.quantile(of_size, (0.25, 0.5, 0.75)))
        points.append(Point(side, count, median, (lower, upper)))
    return fit(points, threads, rounds)


def fit(points: Sequence[Point], threads: int, rounds: int) -> Scaling:
    """The points with the fit of least squared relative deviation."""
    time_ns = np.array([1e6 * point.median_ms for point in points])
    terms = np.array([[point.pixels, point.pixels * point.pictures] for point in points])
    (a, b), *_ = np.linalg.lstsq(terms / time_ns[:, None], np.ones(len(points)), rcond=None)
    return Scaling(tuple(points), threads, rounds, float(a), float(b))
