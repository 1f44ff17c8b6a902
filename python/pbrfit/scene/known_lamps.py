"""Known lamps of a scene's pictures, from the files that tell them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pbrfit.io.lamp_files import matched, read_lamps
from pbrfit.model.lamps import Lamps, lamps_of_rows
from pbrfit.values.arrays import Array


def load(path: Path, names: Sequence[str]) -> tuple[Lamps, str]:
    """Lamps of a file for pictures of these names, and in words what they are and what was assumed.

    Raises InputError or OSError as `read_lamps` and `matched`.
    """
    rows, said = read_lamps(path)
    pictures, how = matched(path, [row.picture for row in rows], names)
    kept = [(row, i) for row, i in zip(rows, pictures, strict=True) if i >= 0]
    lamps = lamps_of_rows([row for row, _ in kept], [i for _, i in kept])
    parts = (f"known, {in_words(lamps)}, from {path.name}", how, said)
    return lamps, "; ".join(filter(None, parts))


def in_words(lamps: Lamps) -> str:
    """How many there are, how far, and whether their colours are known."""
    unknown = np.isnan(lamps.colors)
    colors = "unknown" if unknown.all() else "known in part" if unknown.any() else "known"
    return f"{lamps.in_words()}, colours {colors}"


def angles(directions: Array) -> Array:
    """Azimuth and elevation (K, 2) in degrees of unit vectors (K, 3).

    Azimuth 0 is +Z, where the viewer is, and 90 is +X; elevation is towards +Y.
    """
    x, y, z = directions.T
    turned = np.stack([np.arctan2(x, z), np.arcsin(np.clip(y, -1.0, 1.0))], axis=-1)
    return np.asarray(np.degrees(turned))


def spread(directions: Array) -> float:
    """Largest angle in degrees between two of some unit vectors (K, 3)."""
    least = float(np.clip((directions @ directions.T).min(initial=1.0), -1.0, 1.0))
    return float(np.degrees(np.arccos(least)))
