"""What came out of the race: a row a peer, relative to ours and to the machine."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import dataclass

from peers.machine import Machine
from peers.race import KEEP_FREED_MEMORY, Settings, Standing, Times, race
from peers.roster import OURS, ROSTER, Entry

FLOPS = 99
"""Of the matrix form, for one pixel, picture and channel: three products of 32 operations, the
residual and its square."""


@dataclass(frozen=True)
class Row:
    """One peer. Times are None where there are none.

    Attributes
    ----------
    tuned
        With freed memory kept by the process (glibc only), which helps most peers.
    installed
        With the system's memory allocation as it comes. Where there is no glibc, `tuned` is this.
    """

    name: str
    status: str
    tuned: Standing
    installed: Standing

    @property
    def times(self) -> Times | None:
        """The times that count: the tuned ones."""
        return self.tuned.times


@dataclass(frozen=True)
class Outcome:
    """All rows: ours and those with times from fast to slow, then the others."""

    settings: Settings
    machine: Machine
    rows: tuple[Row, ...]
    tuned: bool
    """Whether there were two passes."""

    @classmethod
    def of_race(cls, entries: Sequence[Entry], settings: Settings, machine: Machine) -> Outcome:
        """Run it: once as installed and, where there is glibc, once more with memory kept."""
        installed = race(entries, settings, {}, "as installed")
        tuned = platform.libc_ver()[0] == "glibc"
        standings = (
            race(entries, settings, KEEP_FREED_MEMORY, "memory kept") if tuned else installed
        )
        return cls.of_standings(standings, installed, settings, machine, tuned=tuned)

    @classmethod
    def of_standings(
        cls,
        standings: Sequence[Standing],
        installed: Sequence[Standing],
        settings: Settings,
        machine: Machine,
        *,
        tuned: bool,
    ) -> Outcome:
        """From both passes over the same peers."""
        rows = [
            Row(kept.name, kept.status if kept.status != "ok" else plain.status, kept, plain)
            for kept, plain in zip(standings, installed, strict=True)
        ]
        rows.sort(key=lambda row: row.times.median_ms if row.times else float("inf"))
        return cls(settings, machine, tuple(rows), tuned)

    @property
    def ours(self) -> Row:
        """Our own row."""
        return next(row for row in self.rows if row.name == OURS)

    def ratio(self, row: Row) -> float | None:
        """Time over ours."""
        return _ratio(row.tuned, self.ours.tuned)

    def ratio_installed(self, row: Row) -> float | None:
        """Time over ours, both as installed."""
        return _ratio(row.installed, self.ours.installed)

    def fraction_of_peak(self, row: Row) -> float | None:
        """Useful operations a second over the machine's multiply-add peak."""
        if row.times is None or self.machine.fma_peak_gflops is None:
            return None
        flops = FLOPS * 3 * self.settings.pixels * self.settings.pictures
        return flops / (1e6 * row.times.median_ms * self.machine.fma_peak_gflops)

    @property
    def versions(self) -> dict[str, str]:
        """Of Python, of each package that took part, and of the libraries below numpy."""
        found = {row.tuned.package: row.tuned for row in self.rows if row.tuned.version}
        versions = {"python": platform.python_version()}
        for package in dict.fromkeys(entry.package for entry in ROSTER):
            if package in found:
                versions[package] = found[package].version or ""
        if "numpy" in found:
            versions["numpy's libraries"] = ", ".join(found["numpy"].libraries)
        return versions


def _ratio(standing: Standing, ours: Standing) -> float | None:
    if standing.times is None or ours.times is None:
        return None
    return standing.times.median_ms / ours.times.median_ms
