"""The outcome as tables, rows, a plot and evidence of the documentation."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

from pbrfit.report.html import Cell
from pbrfit_evaluation.report import evidence
from pbrfit_evaluation.suite import Row, Table, Value
from peers.kernel import Point
from peers.outcome import Outcome, names, operations
from peers.pictures import picture
from peers.roster import OURS

PROTOCOL = "pbrfit-race-1: median over rounds of the median of five evaluations, all in turn"


def tables(outcome: Outcome, kernel: Sequence[Point]) -> dict[str, Table]:
    """The race, the best peer, the kernel, and what they ran on."""
    return {
        "The race": _race(outcome),
        "The best peer": _best(outcome),
        "The kernel": _kernel(outcome, kernel),
        "Versions": Table(
            ["package", "version"], [[name, text] for name, text in outcome.versions.items()]
        ),
    }


def _race(outcome: Outcome) -> Table:
    settings = outcome.settings
    columns = [""]
    for threads in settings.threads:
        columns += [f"ms, {_threads(threads)}", "quartiles", "times ours", "of FMA peak"]
    columns += ["peak MiB"]
    lines: list[list[Value]] = []
    for name in names(outcome.standings):
        line: list[Value] = [Cell(name, "best") if name == OURS else name]
        peak = None
        for threads in settings.threads:
            standing = outcome.of(name, threads)
            if standing.times is None:
                line += [None, standing.status, None, None]
                continue
            peak = standing.peak_mib
            lower, upper = standing.times.quartiles_ms
            line += [standing.times.median_ms, f"{lower:.1f} to {upper:.1f}"]
            line += [outcome.ratio(standing), outcome.fraction_of_peak(standing)]
        lines.append([*line, peak])
    return Table(columns, lines)


def _best(outcome: Outcome) -> Table:
    lines: list[list[Value]] = []
    for threads in outcome.settings.threads:
        best = outcome.best(threads)
        ratio = None if best is None else outcome.ratio(best)
        lines.append([_threads(threads), "none" if best is None else best.name, ratio])
    return Table(["", "the best peer", "its time over ours"], lines)


def _kernel(outcome: Outcome, points: Sequence[Point]) -> Table:
    threads = outcome.settings.threads
    columns = ["model", "pixels", "pictures"]
    for count in threads:
        columns += [f"ms, {_threads(count)}", "of FMA peak"]
    found = {(p.model, p.side, p.pictures, p.threads): p.median_ms for p in points}
    lines: list[list[Value]] = []
    for model, side, pictures in dict.fromkeys((p.model, p.side, p.pictures) for p in points):
        line: list[Value] = [model, f"{side}²", float(pictures)]
        for count in threads:
            ms = found[model, side, pictures, count]
            done = operations(side**2, pictures)
            line += [ms, outcome.machine.fraction(done, ms, count)]
        lines.append(line)
    return Table(columns, lines)


def rows(outcome: Outcome, kernel: Sequence[Point]) -> list[Row]:
    """For the summary."""
    found = []
    for standing in outcome.standings:
        metrics = {"loss_error": standing.loss_error, "gradient_error": standing.gradient_error}
        if standing.times is not None:
            metrics |= {"ms": standing.times.median_ms, "times_ours": outcome.ratio(standing)}
            metrics |= {"of_peak": outcome.fraction_of_peak(standing)}
            metrics |= {"waiting_share": standing.times.waiting_share}
        name = f"{standing.name}, {_threads(standing.threads)}"
        found.append(Row(name, 0, None, metrics, status=standing.status))
    for point in kernel:
        name = f"{point.model}, {point.side}², {point.pictures} pictures, {_threads(point.threads)}"
        found.append(Row(name, 0, None, {"ms": point.median_ms}))
    machine = outcome.machine
    for threads, peak in machine.fma_peak_gflops.items():
        metrics = {"fma_gflops": peak, "memory_gbs": machine.memory_gbs[threads]}
        found.append(Row(f"machine, {_threads(threads)}", 0, None, metrics))
    return found


def record(outcome: Outcome, kernel: Sequence[Point], docs: Path) -> None:
    """Fill the pages."""
    settings = outcome.settings
    file = io.BytesIO()
    picture(outcome).savefig(file, format="png", dpi=160)
    evidence.record(
        docs,
        "race",
        command=f"make bench-peers ({settings.size}², {settings.pictures} pictures, "
        f"{settings.rounds} rounds)",
        protocol=PROTOCOL,
        tables=tables(outcome, kernel),
        rows=rows(outcome, kernel),
        files={"times.png": file.getvalue()},
    )


def _threads(count: int) -> str:
    return f"{count} thread" if count == 1 else f"{count} threads"
