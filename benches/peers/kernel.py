"""Our own time over numbers of pictures and pixels, both models, as a fraction of the peak."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from tqdm import tqdm

from pbrfit.model.reflection import MODELS, Model
from peers.case import Case
from peers.ours import Ours

SIDE = 512
"""Of pictures while their number varies."""

PICTURES = 16
"""While the size varies."""

SIDES = (64, 128, 256, 1024)
COUNTS = (4, 16, 64)


@dataclass(frozen=True)
class Point:
    """One size: median time of an evaluation."""

    model: Model
    threads: int
    side: int
    pictures: int
    median_ms: float = 0.0


def points(threads: Sequence[int], *, quick: bool) -> list[Point]:
    """What is measured."""
    side = SIDES[0] if quick else SIDE
    sizes = [(side, count) for count in COUNTS]
    if not quick:
        sizes += [(one, PICTURES) for one in SIDES]
    return [Point(model, t, *size) for model, t, size in product(MODELS, threads, sizes)]


def measure(asked: Sequence[Point], rounds: int) -> list[Point]:
    """Time every size in turn, round by round."""
    cases = {
        size: Case.make(size[0] ** 2, size[1]) for size in {(p.side, p.pictures) for p in asked}
    }
    peers = [Ours(cases[p.side, p.pictures], p.threads, p.model) for p in asked]
    seconds: list[list[float]] = [[] for _ in asked]
    for _ in tqdm(range(rounds), desc="kernel", disable=None):
        for peer, of_point in zip(peers, seconds, strict=True):
            peer.evaluate()  # caches hold this size again
            start = time.perf_counter()
            peer.evaluate()
            of_point.append(time.perf_counter() - start)
    return [
        Point(p.model, p.threads, p.side, p.pictures, 1e3 * float(np.median(of_point)))
        for p, of_point in zip(asked, seconds, strict=True)
    ]
