"""How much memory a fit will need, and how much there is: said before anything large is made."""

from __future__ import annotations

import logging
import math
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from pbrfit import address_space
from pbrfit._core import InputError
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.fit.settings import (
    LAMP_PIXELS,
    PIXELS_AT_ONCE,
    PRIOR_FIT_PIXELS,
    PRIOR_METALLIC_NODES,
    PRIOR_ROUGHNESS_NODES,
    PRODUCT_PIXELS,
    TILES_SUBSET_PIXELS_MAX,
    TRANSPORT_WHOLE_PIXELS_MAX,
    WHOLE_PIXELS_MAX,
)
from pbrfit.model.reflection import Model
from pbrfit.result.options import TransportChoice
from pbrfit.scene.scene import Scene
from pbrfit.threads import AT_ONCE_MAX

log = logging.getLogger("pbrfit")

Method = Literal["gauss-newton", "lbfgsb"]
"""Solvers whose memory is known."""

METHODS: tuple[Method, ...] = get_args(Method)

SOLVER_BYTES: dict[Method, int] = {"gauss-newton": 16 * 8, "lbfgsb": 480}
"""Bytes an unknown. Of gauss-newton sixteen float64 vectors; between 256² and 512² it takes 90. Of
lbfgsb measured with scipy 1.17's L-BFGS-B and 10 pairs: its workspace, bounds, x and gradient."""

BLOCK = 128
"""Pixels in a block of the Rust core; pixels are padded to whole blocks."""

DIRECTION_BYTES = 32 + 24
"""Bytes a pixel in the Rust core: normal and mirror direction in float32 and what that leaves of
them, n·v in float64."""

GIVEN_DIRECTION_BYTES = 48
"""The same where normals are free: given normal and view direction in float64."""

REFINING_BYTES = 8 * (7 + 3 * 5) + 64 + 3 * 24 + 2 * 32
"""Bytes a pixel while its normal is refined, beside cores: its unknowns with tangent offsets, and
without them in three states; pairs of neighbours and their weights; normals in three states; the
priors of two fits. Whole fits of 512² and 1024² with 16 pictures took 340 and 205 beside the
rest."""

TRANSFER_ROWS: dict[Model, int] = {"paper": 5, "principled": 11}
"""Rows R of a pixel's table of surroundings."""

TRANSFER_COLUMNS = 16
"""SH functions that each row has a value of, whatever the lights' order is."""

VECTOR_BYTES = 5 * 24
"""Bytes a pixel while the core is made: view directions, and two copies of those and of normals."""

WORTH_SAYING = 2**30
"""Bytes above which a fit says how much memory it needs."""

MAPS_BYTES = 470
"""Bytes a pixel: the maps that a fit in tiles finds, and what is made of them when they are
written. 8 MP with 16 pictures took 466 at their peak."""

ROOT = Path("/")
"""Where the system's files are; tests have their own."""


@dataclass(frozen=True)
class FitMemory:
    """Bytes that a fit needs beside the interpreter and its libraries."""

    scene: int
    """Its arrays, which are there already."""
    core: int
    """Pictures and directions in the Rust core."""
    making: int
    """For a while, beside these, while the core is made: pictures in the unit of x."""
    solver: int
    """Beside scene and core while the solver runs: its vectors."""
    refining: int = 0
    """Beside all of these while the solver fits refined normals: cores of the fits before and of
    free normals, and states of all pixels; 0 where normals are held."""
    transfer: int = 0
    """Beside all but the last: tables of surroundings, in which no normals are refined."""

    @property
    def further(self) -> int:
        """That are not there yet."""
        return self.core + max(self.making, self.solver) + max(self.refining, self.transfer)

    @property
    def peak(self) -> int:
        """At the peak."""
        return self.scene + self.further


def of_fit(
    scene: Scene, layout: ParameterLayout, method: Method, *, refine_normals: bool = False
) -> FitMemory:
    """What `decompose` needs of memory with a solver, without surroundings."""
    return of_layout(
        layout,
        method,
        held=bytes_of(scene),
        exact=scene.images.dtype != np.float32,
        refine_normals=refine_normals,
    )


@dataclass(frozen=True)
class TransferMemory:
    """Bytes that tables of surroundings take."""

    of_pixel: int
    """A pixel that is fitted: R × (16 + N·C) float32 in Python and in the core, and for a while
    what is reflected once more, in the unit of x."""
    of_picture: int
    """A pixel of the whole picture: all pictures in float32, here and in the core; 0 where nothing
    is reflected."""

    @classmethod
    def of(
        cls, layout: ParameterLayout, model: Model, asked: TransportChoice, *, depth: bool
    ) -> TransferMemory | None:
        """What a fit may need that is asked for some `FitOptions.transport`; None = nothing."""
        if not depth or asked == "none":
            return None
        samples = layout.pictures * layout.channels if asked != "occlusion" else 0
        rows = TRANSFER_ROWS[model]
        return cls(4 * rows * (2 * TRANSFER_COLUMNS + 3 * samples), 2 * 4 * samples)


def whole_pixels_max(transfer: TransferMemory | None) -> int:
    """Pixels that are fitted at once at most."""
    limit = WHOLE_PIXELS_MAX
    return limit if transfer is None else min(limit, TRANSPORT_WHOLE_PIXELS_MAX)


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


def of_layout(
    layout: ParameterLayout,
    method: Method,
    *,
    held: int,
    exact: bool = False,
    refine_normals: bool = False,
    transfer: TransferMemory | None = None,
) -> FitMemory:
    """As `of_fit`, for `held` bytes of the scene's arrays, with tables of surroundings if any.

    With `exact` pictures are in float64, and the core has them in 48 bits.
    """
    pixels, channels, pictures = layout.pixels, layout.channels, layout.pictures
    planes = pictures * channels * (1 + layout.weighted)
    size = layout.valid.size
    blocks = BLOCK * -(-pixels // BLOCK)
    samples = 4 * (planes + exact * pictures * channels)
    core = (samples + DIRECTION_BYTES) * blocks
    refining = 0
    if refine_normals:
        # The first fit, the one before the last, and free normals.
        refining = 2 * core + (samples + GIVEN_DIRECTION_BYTES) * blocks
        refining += REFINING_BYTES * pixels
    solver = SOLVER_BYTES[method] * layout.size
    if method == "gauss-newton":
        few = _of_few_pixels(layout, (samples + DIRECTION_BYTES))
        solver += few if layout.lighting is None else max(few, _of_lamps(layout))
    return FitMemory(
        scene=held,
        core=core,
        making=(samples + VECTOR_BYTES) * pixels,
        solver=solver,
        refining=refining,
        transfer=0 if transfer is None else transfer.of_pixel * pixels + transfer.of_picture * size,
    )


def _of_few_pixels(layout: ParameterLayout, core: int) -> int:
    """Of joint steps and the mixture prior, for which some pixels stand for all.

    The core of those that products are from takes `core` bytes each, and keeps 4 for each of K
    weights and 3 derivatives in all pictures (5 where normals are free) a channel. The
    preconditioner is a matrix of the lights of K pictures at most, beside the one that it is made
    from. Of the prior there are all likelihoods of the pixels that it is fitted to, and three
    arrays like them of each piece that is worked on.
    """
    derivatives = 5 if layout.free_normals else 3
    of_channel = layout.coefficients + layout.pictures * derivatives
    few = min(PRODUCT_PIXELS, layout.pixels)
    products = (core + 4 * layout.channels * of_channel) * few
    lights = layout.channels * layout.coefficients * min(layout.pictures, layout.coefficients)
    likelihoods = min(PRIOR_FIT_PIXELS, layout.pixels) + 3 * AT_ONCE_MAX * PIXELS_AT_ONCE
    nodes = PRIOR_ROUGHNESS_NODES[2] * PRIOR_METALLIC_NODES[2]
    return products + 2 * 8 * lights**2 + 4 * nodes * likelihoods


def _of_lamps(layout: ParameterLayout) -> int:
    """Of joint steps of a lamp a picture, in float64.

    A picture has nine unknowns: place, colour, ambient light. There are four matrices of those of
    all pictures (`lamps.shared_step`), and four arrays that couple them to six of each pixel.
    """
    unknowns = 9 * layout.pictures
    return 4 * 8 * unknowns * (unknowns + 6 * min(layout.pixels, LAMP_PIXELS))


def of_tiles(
    layout: ParameterLayout,
    *,
    held: int,
    exact: bool = False,
    refine_normals: bool = False,
    transfer: TransferMemory | None = None,
) -> FitMemory:
    """The same where the scene is fitted in tiles: as of a subset, and maps of all pixels."""
    pixels = min(TILES_SUBSET_PIXELS_MAX, layout.pixels)
    few = replace(layout, valid=np.ones((1, pixels), dtype=bool), segments=None)
    subset = of_layout(few, "gauss-newton", held=held, exact=exact, refine_normals=refine_normals)
    tables = 0
    if transfer is not None:
        tables = transfer.of_pixel * pixels + transfer.of_picture * layout.valid.size
    solver = subset.solver + MAPS_BYTES * layout.pixels
    return replace(subset, solver=solver, transfer=tables)


def check(method: Method, needed: FitMemory) -> None:
    """Say how much memory a fit needs if that is much, and refuse it if there is not so much.

    Where nobody knows what the process may still have, it is never refused.
    """
    free = available()
    if free is not None and needed.further > free:
        advice = "; solver gauss-newton needs less" if method == "lbfgsb" else ""
        if needed.transfer > needed.refining:
            less = needed.transfer - needed.refining
            advice += f"; transport none needs {size(less)} less"
        elif needed.refining:
            advice += f"; refine_normals off needs {size(needed.refining - needed.transfer)} less"
        raise InputError(
            f"solver {method}: expected {size(needed.further)} of memory to be available, "
            f"found {size(free)}; use smaller or fewer pictures{advice}"
        )
    if needed.further > WORTH_SAYING:
        known = "" if free is None else f"; {size(free)} are available"
        log.warning("solver %s needs about %s of memory%s", method, size(needed.further), known)


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
    solver: Method,
    *,
    held: int,
    exact: bool = False,
    refine_normals: bool,
    optional: bool = False,
    transfer: TransferMemory | None = None,
) -> Plan:
    """How a scene is fitted: the first of these ways that there is memory for.

    The solver gauss-newton fits it at once, or in tiles where it has more than `whole_pixels_max`
    valid pixels; or in tiles all the same; or without refining normals, where that is `optional`.
    The solver lbfgsb has no tiles. Where there is memory for none, it is the way that needs least.
    Other arguments are those of `of_layout`.
    """
    ways = []
    for refining in (refine_normals, False) if refine_normals and optional else (refine_normals,):
        takes: dict[str, Any] = {"held": held, "exact": exact, "transfer": transfer}
        if solver == "lbfgsb" or layout.pixels <= whole_pixels_max(transfer):
            needed = of_layout(layout, solver, refine_normals=refining, **takes)
            ways.append(Plan(False, refining, needed))
        if solver == "gauss-newton":
            needed = of_tiles(layout, refine_normals=refining, **takes)
            ways.append(Plan(True, refining, needed))
    free = available()
    fit = [way for way in ways if free is None or way.needed.further <= free]
    chosen = fit[0] if fit else min(ways, key=lambda way: way.needed.further)
    if chosen.refine_normals == refine_normals or free is None:
        return chosen
    least = min(way.needed.further for way in ways if way.refine_normals)
    return replace(
        chosen,
        hindered=f"it needs {size(least)} of memory, and {size(free)} are available",
    )


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
        if controllers == "":
            root, limit, usage = "sys/fs/cgroup", "memory.max", "memory.current"
            reclaimable = "inactive_file"
        elif "memory" in controllers.split(","):
            root, limit, usage = (
                "sys/fs/cgroup/memory",
                "memory.limit_in_bytes",
                "memory.usage_in_bytes",
            )
            reclaimable = "total_inactive_file"
        else:
            continue
        group = Path(path.lstrip("/"))
        # In a container the path may be that outside of it; then only the root is there.
        for folder in (group, *group.parents):
            most, used = (_number(f"{root}/{folder}/{file}") for file in (limit, usage))
            if most is None or used is None:
                continue
            statistics = dict(line.split() for line in _lines(f"{root}/{folder}/memory.stat"))
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
