"""Segments from the pictures and normals of a scene alone, where nobody tells them.

Edges of materials and of things stay where they are in all pictures; edges of shadows move. So the
difference of two neighbouring pixels is the median over the pictures of how much their radiance
differs, and the pixels are joined as by Felzenszwalb and Huttenlocher (IJCV 2004): along the edges
of a grid with eight neighbours, the smallest difference first, two regions become one where the
difference is at most the largest within either, plus `LOOSENESS` over its number of pixels. Regions
of fewer than `LEAST` pixels join the most alike of their neighbours.

The mask is not looked at, for that of rooms leaves out the outlines of things.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.model.geometry import angles_between
from pbrfit.scene.scene import Scene

DEGREES = 60.0
"""Angle between two neighbours' normals that counts as much as a factor e of radiance."""

LOOSENESS = 1.5
LEAST = 12
"""Of the regions; chosen on rooms of seeds from 7000 to 7003."""


def found_segments(scene: Scene) -> NDArray[np.int32]:
    """(H, W) ids from 1 of the regions that pictures and normals show."""
    height, width = scene.images.shape[1:3]
    ids = np.arange(height * width).reshape(height, width)
    mean = np.mean(scene.images, axis=(1, 2, 3), keepdims=True)
    # A hundredth of the mean keeps noise in the dark small.
    log = np.log(np.maximum(scene.images / mean, 0.0) + 0.01)
    ends, differences = [], []
    for down, across in ((0, 1), (1, 0), (1, 1), (1, -1)):
        one = np.s_[: height - down, max(0, -across) : width - max(0, across)]
        other = np.s_[down:, max(0, across) : width + min(0, across)]
        radiance = np.abs(log[:, *other] - log[:, *one]).mean(axis=-1)
        turn = np.nan_to_num(angles_between(scene.normals[other], scene.normals[one]))
        differences.append((np.median(radiance, axis=0) + turn / DEGREES).ravel())
        ends.append(np.stack([ids[one].ravel(), ids[other].ravel()], axis=-1))
    return joined(np.concatenate(ends), np.concatenate(differences), height * width).reshape(
        height, width
    )


def joined(
    ends: NDArray[np.intp], differences: NDArray[np.floating[Any]], count: int
) -> NDArray[np.int32]:
    """Ids from 1 of the regions of a graph of `count` nodes; edges (E, 2), differences (E,)."""
    above = list(range(count))
    size, within = [1] * count, [0.0] * count

    def root(node: int) -> int:
        while above[node] != node:
            above[node] = above[above[node]]
            node = above[node]
        return node

    order = np.argsort(differences, kind="stable")
    edges = list(zip(ends[order].tolist(), differences[order].tolist(), strict=True))
    for small in (False, True):
        for (one, other), difference in edges:
            a, b = root(one), root(other)
            if a == b:
                continue
            if small:
                join = min(size[a], size[b]) < LEAST
            else:
                most = min(within[a] + LOOSENESS / size[a], within[b] + LOOSENESS / size[b])
                join = difference <= most
            if join:
                above[b] = a
                size[a] += size[b]
                within[a] = max(within[a], within[b], difference)
    roots = np.array([root(node) for node in range(count)])
    return np.unique(roots, return_inverse=True)[1].astype(np.int32) + 1
