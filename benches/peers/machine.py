"""The machine that the figures belong to."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

CPU_INFO = Path("/proc/cpuinfo")
QUIET = 0.5
"""Load above which something else is at work."""


@dataclass(frozen=True)
class Machine:
    """Its name, and what `benches/machine.rs` measured on it.

    Attributes
    ----------
    fma_peak_gflops
        float32 multiply-adds from registers, 10⁹ operations a second (two each), by threads.
    memory_gbs
        Memory read, 10⁹ bytes a second, likewise.
    load
        Processes that wanted to run in the last minute before the start, on average.
    """

    name: str
    load: float | None
    vector_bits: int | None = None
    fma_peak_gflops: Mapping[int, float] = field(default_factory=dict)
    memory_gbs: Mapping[int, float] = field(default_factory=dict)

    def fraction(self, operations: float, ms: float, threads: int) -> float | None:
        """Operations a second over the peak; None where that was not measured."""
        peak = self.fma_peak_gflops.get(threads)
        return None if peak is None else operations / (1e6 * ms * peak)

    @classmethod
    def find(cls, measured: Path | None, threads: Sequence[int]) -> Machine:
        """The machine that runs this; `measured` is a JSON file that the machine bench wrote."""
        load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
        here = cls(_name(), load)
        if measured is None:
            return here
        bench = json.loads(measured.read_text(encoding="utf-8"))
        rows = {row["threads"]: row for row in bench["measured"]}
        for count in threads:
            if count not in rows:
                raise SystemExit(f"{measured}: expected figures for {count} threads, found none")
        peaks = {count: rows[count]["fma_gflops"] for count in threads}
        memory = {count: rows[count]["memory_gbs"] for count in threads}
        return cls(here.name, load, bench["vector_bits"], peaks, memory)


def _name() -> str:
    processor = platform.processor() or platform.machine()
    if CPU_INFO.exists():
        lines = CPU_INFO.read_text(encoding="utf-8").splitlines()
        models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
        processor = models[0] if models else processor
    return f"{processor}, {os.cpu_count()} processors, {platform.system()} {platform.machine()}"
