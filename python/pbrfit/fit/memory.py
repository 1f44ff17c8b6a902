"""How much memory a fit will need, and how much there is: said before anything large is made."""

from __future__ import annotations

import logging
import math
import os
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from pbrfit import address_space
from pbrfit._core import InputError
from pbrfit.fit import settings
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.model.lighting import BAND_OF
from pbrfit.model.reflection import DEFAULT_MODEL, Model
from pbrfit.result.options import Solver, TransportChoice
from pbrfit.scene.scene import Scene
from pbrfit.threads import AT_ONCE_MAX, processors

log = logging.getLogger("pbrfit")

FIXED_BYTES = 20 << 20
PIECE_BYTES = 30 << 20
PIECE_PIXEL_BYTES = 208
UNKNOWN_BYTES: dict[Solver, int] = {"gauss-newton": 76, "lbfgsb": 420}
"""Bytes of any fit; of a piece of work, as many at once as threads, and a pixel of each; and an
unknown. A room of 256² with 16 pictures took 124 MiB by two threads."""

REFINING_PIXEL_BYTES = 450
"""Bytes of a pixel while normals are refined, beside two more pieces of work: with 16 pictures
256² took 295 to 311 MiB in all by two threads and 437 by four, 512² took 666 by two."""

TABLE_ROWS: dict[Model, int] = {"paper": 5, "principled": 11}
"""Rows of a pixel's table of surroundings, by model, with a value of each SH function."""

CGROUP_FILES = {
    1: ("memory/", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
    2: ("", "memory.max", "memory.current", "inactive_file"),
}
"""Folder, files and statistic of both versions of control groups."""

ROOT = Path("/")
"""Where the system's files are; tests have their own."""


@dataclass(frozen=True)
class FitMemory:
    """Bytes that a fit needs beside the interpreter and its libraries."""

    scene: int
    """Its arrays, which are there already."""
    fit: int
    """Of a fit with the given normals and without surroundings."""
    refining: int = 0
    """Beside these while normals are refined."""
    tables: int = 0
    """Beside these for tables of surroundings, with which no normals are refined."""

    @property
    def further(self) -> int:
        """That are not there yet."""
        return self.fit + max(self.refining, self.tables)

    @property
    def peak(self) -> int:
        """At the peak."""
        return self.scene + self.further

    @property
    def saved(self) -> tuple[int, str] | None:
        """What the fit would need less without the dearer of both, and the option that says so."""
        if self.refining == self.tables:
            return None
        option = "refine_normals off" if self.refining > self.tables else "transport none"
        return abs(self.refining - self.tables), option


def of_fit(
    layout: ParameterLayout,
    solver: Solver,
    *,
    held: int,
    refine_normals: bool = False,
    transport: TransportChoice = "none",
    model: Model = DEFAULT_MODEL,
    tiled: bool = False,
    threads: int = 0,
) -> FitMemory:
    """What a fit needs of a scene whose arrays take `held` bytes, by so many threads (0 = all).

    The core has the samples, twice while it is made; while normals are refined there are three
    more. In tiles that is what the subset needs, and maps of all pixels. A table of surroundings is
    in Python and in the core and, for a while, there is what is reflected once more, in the unit of
    x; for that all pictures are there twice.
    """
    pixels = min(settings.TILES_SUBSET_PIXELS_MAX, layout.pixels) if tiled else layout.pixels
    samples = layout.pictures * layout.channels
    in_core = 4 * samples * (1 + layout.weighted)
    unknowns = layout.channels + 1 + (not layout.metallic_known)
    of_unknowns = UNKNOWN_BYTES[solver] * unknowns
    pieces = min(threads or processors(), AT_ONCE_MAX)
    fit = FIXED_BYTES + (in_core + max(in_core, of_unknowns)) * pixels
    fit += pieces * (PIECE_BYTES + PIECE_PIXEL_BYTES * pixels)
    refining = (2 + pieces) * PIECE_BYTES
    refining += (3 * in_core + REFINING_PIXEL_BYTES) * pixels
    fit = max(fit, (3 << 20) * layout.pictures)  # joint steps with a lamp in each
    tables = 0
    if transport != "none":
        reflected = 0 if transport == "occlusion" else samples
        tables = 4 * TABLE_ROWS[model] * (2 * len(BAND_OF) + 3 * reflected) * pixels
        tables += 2 * 4 * reflected * layout.valid.size
    return FitMemory(
        scene=held,
        fit=fit + 470 * layout.pixels * tiled,  # maps, and what they become when written
        refining=refining * refine_normals,
        tables=tables,
    )


def bytes_of(scene: Scene) -> int:
    """Of the arrays of a scene; what is alike for all pictures or channels is held once."""
    of_pixels = scene.normals, scene.normal_sigma, scene.depth
    arrays = scene.images, scene.weights, scene.limits, *of_pixels
    held = 0
    for array in arrays:
        if array is not None:
            own = [n for n, stride in zip(array.shape, array.strides, strict=True) if stride]
            held += array.itemsize * math.prod(own)
    return held


def check(solver: Solver, needed: FitMemory) -> None:
    """Say how much memory a fit needs if that is much, and refuse it if there is not so much.

    Where nobody knows what the process may still have, it is never refused.
    """
    free = available()
    if free is not None and needed.further > free:
        advice = "; solver gauss-newton needs less" if solver == "lbfgsb" else ""
        if needed.saved is not None:
            less, option = needed.saved
            advice += f"; {option} needs {size(less)} less"
        raise InputError(
            f"solver {solver}: expected {size(needed.further)} of memory to be available, "
            f"found {size(free)}; use smaller or fewer pictures{advice}"
        )
    if needed.further > 2**30:
        known = "" if free is None else f"; {size(free)} are available"
        log.warning("solver %s needs about %s of memory%s", solver, size(needed.further), known)


@dataclass(frozen=True)
class Plan:
    """How a scene is fitted."""

    tiled: bool
    """In tiles, or all pixels at once."""
    refine_normals: bool
    needed: FitMemory
    hindered: str | None = None
    """Why normals are not refined for lack of memory; else None."""


def plan(
    layout: ParameterLayout,
    solver: Solver,
    *,
    refine_normals: bool,
    optional: bool = False,
    transport: TransportChoice = "none",
    **takes: Any,
) -> Plan:
    """How a scene is fitted: the first of these ways that there is memory for.

    The solver gauss-newton fits it at once, or in tiles where it has more than `whole_pixels_max`
    valid pixels; or in tiles all the same; or without refining normals, where that is `optional`.
    The solver lbfgsb has no tiles. Where there is memory for none, it is the way that needs least.
    Other arguments are those of `of_fit`.
    """
    whole = solver == "lbfgsb" or layout.pixels <= whole_pixels_max(transport)
    needed = partial(of_fit, layout, solver, transport=transport, **takes)
    ways = [
        Plan(tiled, refining, needed(refine_normals=refining, tiled=tiled))
        for refining in ((True, False) if refine_normals and optional else (refine_normals,))
        for tiled in [False] * whole + [True] * (solver == "gauss-newton")
    ]
    free = available()
    fit = [way for way in ways if free is None or way.needed.further <= free]
    chosen = fit[0] if fit else min(ways, key=lambda way: way.needed.further)
    if chosen.refine_normals == refine_normals or free is None:
        return chosen
    least = min(way.needed.further for way in ways if way.refine_normals)
    why = f"it needs {size(least)} of memory, and {size(free)} are available"
    return replace(chosen, hindered=why)


def whole_pixels_max(transport: TransportChoice) -> int:
    """Pixels that are fitted at once at most."""
    limit = settings.WHOLE_PIXELS_MAX
    return limit if transport == "none" else min(limit, settings.TRANSPORT_WHOLE_PIXELS_MAX)


def available() -> int | None:
    """Bytes that this process may still take without swapping; None where the system does not say.

    The least of what the machine has left, what the process's control groups (containers, batch
    jobs) still allow, and what is left of its address space.
    """
    limits = [_machine_has(), *_groups_allow(), address_space.left()]
    return min((limit for limit in limits if limit is not None), default=None)


def size(count: float) -> str:
    """Bytes for people."""
    return f"{count / 2**30:.1f} GiB" if count >= 2**30 else f"{count / 2**20:.0f} MiB"


def _machine_has() -> int | None:
    for line in _lines("proc/meminfo"):
        name, _, amount = line.partition(":")
        if name == "MemAvailable":
            return 1024 * int(amount.split()[0])
    try:
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return None  # macOS and Windows


def _groups_allow() -> list[int]:
    """What each group that the process is in, and each around it, has left."""
    left = []
    for line in _lines("proc/self/cgroup"):
        _, controllers, path = line.split(":", 2)
        if controllers and "memory" not in controllers.split(","):
            continue
        root, limit, usage, reclaimable = CGROUP_FILES[2 if not controllers else 1]
        group, root = Path(path.lstrip("/")), f"sys/fs/cgroup/{root}"
        # In a container the path may be that outside of it; then only the root is there.
        for folder in (group, *group.parents):
            most, used = (_number(f"{root}{folder}/{file}") for file in (limit, usage))
            if most is None or used is None:
                continue
            statistics = dict(line.split() for line in _lines(f"{root}{folder}/memory.stat"))
            # Files that were read once count as used, and are given up when memory is wanted.
            left.append(max(0, most - used + int(statistics.get(reclaimable, 0))))
    return left


def _lines(path: str) -> list[str]:
    try:
        return (ROOT / path).read_text(encoding="utf-8").splitlines()
    except OSError:
        return []


def _number(path: str) -> int | None:
    """The number in a file; None where there is none, or "max"."""
    text = "".join(_lines(path))
    return int(text) if text.isdecimal() else None
