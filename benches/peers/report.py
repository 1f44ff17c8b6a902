"""The outcome as JSON, as a page, as a picture and as text."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from peers.machine import Machine
from peers.outcome import FLOPS, Outcome, Row
from peers.pictures import picture, scaling_picture
from peers.race import GRADIENT_TOLERANCE, LOSS_TOLERANCE, Times
from peers.roster import OURS
from peers.scaling import Scaling


def write(outcome: Outcome, folder: Path) -> None:
    """`peers.json`, `peers.md` and, if anything was timed, `peers.png`."""
    folder.mkdir(parents=True, exist_ok=True)
    _write_json(as_json(outcome), folder / "peers.json")
    (folder / "peers.md").write_text(page(outcome), encoding="utf-8")
    if any(row.times for row in outcome.rows):
        picture(outcome).savefig(folder / "peers.png", dpi=160)


def write_scaling(scaling: Scaling, machine: Machine, folder: Path) -> None:
    """`scaling.json` and `scaling.png`."""
    folder.mkdir(parents=True, exist_ok=True)
    _write_json(scaling_as_json(scaling, machine), folder / "scaling.json")
    scaling_picture(scaling).savefig(folder / "scaling.png", dpi=160)


def as_json(outcome: Outcome) -> dict[str, Any]:
    """The document `peers.json`."""
    settings, machine = outcome.settings, outcome.machine
    rows = []
    for row in outcome.rows:
        rows.append(
            {
                "name": row.name,
                **_times_as_json(row.times),
                "ratio_to_ours": _rounded(outcome.ratio(row)),
                "fraction_of_peak": _rounded(outcome.fraction_of_peak(row)),
                "as_installed": {
                    **_times_as_json(row.installed.times),
                    "ratio_to_ours": _rounded(outcome.ratio_installed(row)),
                },
                "peak_mib": _rounded(row.installed.peak_mib),
                "loss_error": _rounded(row.tuned.loss_error, 2),
                "gradient_error": _rounded(row.tuned.gradient_error, 2),
                "status": row.status,
            }
        )
    return {
        "size": settings.size,
        "pictures": settings.pictures,
        "threads": settings.threads,
        "rounds": settings.rounds,
        "fma_peak_gflops": _rounded(machine.fma_peak_gflops),
        "memory_gbs": _rounded(machine.memory_gbs),
        "vector_bits": machine.vector_bits,
        "machine": machine.name,
        "load_at_start": _rounded(machine.load, 3),
        "freed_memory_kept": outcome.tuned,
        "versions": outcome.versions,
        "rows": rows,
    }


def scaling_as_json(scaling: Scaling, machine: Machine) -> dict[str, Any]:
    """The document `scaling.json`."""
    return {
        "threads": scaling.threads,
        "rounds": scaling.rounds,
        "machine": machine.name,
        "load_at_start": _rounded(machine.load, 3),
        "fit": "t = a P + b P N",
        "a_ns": _rounded(scaling.per_pixel_ns),
        "b_ns": _rounded(scaling.per_sample_ns),
        "worst_deviation": _rounded(scaling.deviation(scaling.worst)),
        "points": [
            {
                "size": point.side,
                "pictures": point.pictures,
                "median_ms": _rounded(point.median_ms),
                "quartiles_ms": [_rounded(q) for q in point.quartiles_ms],
                "deviation": _rounded(scaling.deviation(point)),
            }
            for point in scaling.points
        ],
    }


def text(outcome: Outcome) -> str:
    """The table for a terminal."""
    lines = [f"{'':24}{'ms':>8}{'quartiles':>16}{'ratio':>8}{'peak MiB':>10}"]
    for row in outcome.rows:
        if row.times is None:
            lines.append(f"{row.name:24}{row.status}")
            continue
        lower, upper = row.times.quartiles_ms
        spread = f"{lower:.1f} to {upper:.1f}"
        lines.append(
            f"{row.name:24}{row.times.median_ms:8.1f}{spread:>16}"
            f"{_or_dash(outcome.ratio(row), '.2f'):>8}{_or_dash(row.installed.peak_mib, '.0f'):>10}"
        )
    return "\n".join(lines)


def scaling_text(scaling: Scaling) -> str:
    """The points and the fit, for a terminal."""
    lines = [f"{'size':>6}{'pictures':>10}{'ms':>10}{'of fit':>9}"]
    for point in scaling.points:
        lines.append(
            f"{point.side:6}{point.pictures:10}{point.median_ms:10.2f}"
            f"{scaling.deviation(point):+9.1%}"
        )
    worst = scaling.worst
    lines.append(
        f"t = {scaling.per_pixel_ns:.2f} ns · P + {scaling.per_sample_ns:.2f} ns · P · N; farthest "
        f"from it: {worst.side}², {worst.pictures} pictures, {scaling.deviation(worst):+.1%}"
    )
    return "\n".join(lines)


def page(outcome: Outcome) -> str:
    """The page `peers.md`."""
    settings, machine = outcome.settings, outcome.machine
    head = ["", "ms", "quartiles", "times ours", "of FMA peak", "as installed", "peak MiB"]
    table = [head, ["---"] + ["---:"] * (len(head) - 1)]
    for row in outcome.rows:
        name = f"**{row.name}**" if row.name == OURS else row.name
        if row.times is None:
            table.append([name, "not timed", "", "", "", "", ""])
            continue
        lower, upper = row.times.quartiles_ms
        fraction = outcome.fraction_of_peak(row)
        table.append(
            [
                name,
                f"{row.times.median_ms:.1f}",
                f"{lower:.1f} to {upper:.1f}",
                _or_dash(outcome.ratio(row), ".1f"),
                _or_dash(fraction, ".1%"),
                _installed(outcome, row),
                _or_dash(row.installed.peak_mib, ".0f"),
            ]
        )
    rows = "\n".join("| " + " | ".join(cells) + " |" for cells in table)
    absent = "".join(
        f"\nNot timed: {row.name}: {row.status}.\n" for row in outcome.rows if row.times is None
    )
    versions = ", ".join(f"{name} {version}" for name, version in outcome.versions.items())
    if machine.fma_peak_gflops is None:
        peak = "The machine's own speed was not measured."
    else:
        peak = (
            f"`cargo bench --bench machine` ({machine.vector_bits}-bit vectors): "
            f"{machine.fma_peak_gflops:.0f} GFLOP/s of float32 multiply-adds\n  from registers, "
            f"{machine.memory_gbs:.1f} GB/s read from memory, on the same number of threads."
        )
    waiting = max(
        (row.times.waiting_share for row in outcome.rows if row.times is not None), default=0.0
    )
    load = "unknown" if machine.load is None else f"{machine.load:.2f}"
    return PAGE.format(
        size=settings.size,
        pictures=settings.pictures,
        threads=settings.threads,
        rounds=settings.rounds,
        machine=machine.name,
        versions=versions,
        rows=rows,
        absent=absent,
        peak=peak,
        waiting=f"{waiting:.1%}",
        load=load,
        flops=FLOPS,
        loss=f"{LOSS_TOLERANCE:g}",
        gradient=f"{GRADIENT_TOLERANCE:g}",
        kept=KEPT if outcome.tuned else NOT_KEPT,
    )


PAGE = """\
# Our objective beside other ways to it

One evaluation of the loss and its gradient by every unknown, {size}² pixels, {pictures} pictures,
{threads} threads: what a solver asks for in each step. Written by `make bench-peers`.

{rows}
{absent}
![Times of one evaluation](peers.png)

{machine}; {versions}. Load before the start: {load}.

## How it was measured

- **Same data, same task.** Random unit normals, materials, lights and pictures from one seed. Loss:
  mean over pixels, pictures and channels of (I − T)², model as in [model.md](../model.md).
  Unknowns: albedo, roughness, metallic of every pixel, 48 light coefficients a picture.
- **Checked, then timed.** A peer takes part if its loss agrees with ours to {loss} and its gradient
  to {gradient}, relative, in each of albedo, roughness, metallic and lights.
- **In turn.** Each peer has a process that stays alive. In each of {rounds} rounds every peer
  evaluates once to warm up and five times for the clock, of which the median counts; then it
  sleeps 0.1 s, in which thread pools come to rest. While others worked, no peer used more than
  {waiting} of one processor.
- **Threads.** {threads} each, by the settings that OpenMP, the BLAS libraries, PyTorch and XLA have
  for that.
- **ms, quartiles**: over the rounds. {kept}
- **of FMA peak**: {flops} operations for each pixel, picture and channel, which is what the matrix
  form needs, over time and over the machine's peak.
  {peak}
- **peak MiB**: highest resident memory during the rounds, over what the process held before it had
  any data (libraries loaded and used once on a small case). Pictures and other constants are in it,
  once, in the form that the peer keeps. As installed. Measured on Linux only.

What helps the peers: SH bases and n·v are made beforehand; unknowns and gradients stay in the
framework's own float32 arrays, where ours takes and returns float64 arrays as scipy needs them;
band weights are polynomials of degree 16 in float32, off by 3·10⁻⁶, cheaper than any exact form.

## The peers

- **einsum**: as one reads it from the paper, a diffuse and a specular sum over coefficients,
  `kp,nkc->cnp` twice, then the sum of both. Band weights go to coefficients by a product with a
  one-hot matrix, not by an index, which cripples eager gradients.
- **matrix**: the two bases are combined to one weight matrix a channel first; then it is three
  matrix products, I = W Lᵀ and the two of the gradient. So are both rows of numpy, and ours.
- **eager, torch.compile, jit**: gradients by the framework's automatic differentiation.
- **numpy**: gradient written by hand. Whole arrays with BLAS's threads; or in blocks of 8192 pixels
  that stay in the cache, on a pool of threads. Orders of axes, and loops or batches over channels,
  are for each framework the fastest of those tried.
- **pbrfit**: called from Python, as the solver does.
"""

KEPT = """\
glibc is told to keep freed memory
  (`MALLOC_ARENA_MAX=1`, `MALLOC_MMAP_MAX_=0`, a large `MALLOC_TRIM_THRESHOLD_`), for all alike:
  peers with large intermediate arrays otherwise spend much of their time on page faults.
  **as installed**: without that, as a user meets it first, in a race of its own; in brackets times
  ours."""

NOT_KEPT = """\
Memory allocation is the system's own, so the column **as installed** says the same; in
  brackets times ours."""


def _times_as_json(times: Times | None) -> dict[str, Any]:
    if times is None:
        return {"median_ms": None, "quartiles_ms": None, "processors": None}
    return {
        "median_ms": _rounded(times.median_ms),
        "quartiles_ms": [_rounded(q) for q in times.quartiles_ms],
        "processors": _rounded(times.processors, 3),
        "waiting_share": _rounded(times.waiting_share, 2),
    }


def _installed(outcome: Outcome, row: Row) -> str:
    times, ratio = row.installed.times, outcome.ratio_installed(row)
    if times is None:
        return "–"
    return f"{times.median_ms:.1f} ({_or_dash(ratio, '.1f')})"


def _or_dash(value: float | None, form: str) -> str:
    return "–" if value is None else format(value, form)


def _rounded(value: float | None, digits: int = 4) -> float | None:
    return None if value is None else float(f"{value:.{digits}g}")


def _write_json(document: dict[str, Any], path: Path) -> None:
    path.write_text(json.dumps(document, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
