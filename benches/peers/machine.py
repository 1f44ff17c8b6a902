"""The machine that the figures belong to."""

from __future__ import annotations

import json
import os
import platform
from dataclasses import dataclass
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
        float32 multiply-adds from registers, 10⁹ operations a second (two each); all threads.
    memory_gbs
        Memory read, 10⁹ bytes a second; all threads.
    load
        Processes that wanted to run in the last minute before the start, on average.
    """

    name: str
    threads: int
    load: float | None
    vector_bits: int | None = None
    fma_peak_gflops: float | None = None
    memory_gbs: float | None = None

    @classmethod
    def find(cls, measured: Path | None, threads: int) -> Machine:
        """The machine that runs this; `measured` is a JSON file that the machine bench wrote."""
        load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
        here = cls(_name(), threads, load)
        if measured is None:
            return here
        bench = json.loads(measured.read_text(encoding="utf-8"))
        for row in bench["measured"]:
            if row["threads"] == threads:
                return cls(
                    here.name,
                    threads,
                    load,
                    bench["vector_bits"],
                    row["fma_gflops"],
                    row["memory_gbs"],
                )
        raise SystemExit(f"{measured}: expected figures for {threads} threads, found none")


def _name() -> str:
    processor = platform.processor() or platform.machine()
    if CPU_INFO.exists():
        lines = CPU_INFO.read_text(encoding="utf-8").splitlines()
        models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
        processor = models[0] if models else processor
    return f"{processor}, {os.cpu_count()} processors, {platform.system()} {platform.machine()}"
