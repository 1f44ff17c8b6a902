"""What came out of the race, relative to ours and to the machine."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import dataclass

from peers.machine import Machine
from peers.race import Settings, Standing
from peers.roster import OURS, ROSTER

FLOPS = 99
"""Of the matrix form, for one pixel, picture and channel: three products of 32 operations, the
residual and its square."""


def operations(pixels: int, pictures: int) -> int:
    """That an evaluation needs."""
    return FLOPS * 3 * pixels * pictures


@dataclass(frozen=True)
class Outcome:
    """All standings, by number of threads."""

    settings: Settings
    machine: Machine
    standings: tuple[Standing, ...]

    def of(self, name: str, threads: int) -> Standing:
        """That of a peer."""
        return next(s for s in self.standings if (s.name, s.threads) == (name, threads))

    def ratio(self, standing: Standing) -> float | None:
        """Time over ours with as many threads."""
        ours = self.of(OURS, standing.threads)
        if standing.times is None or ours.times is None:
            return None
        return standing.times.median_ms / ours.times.median_ms

    def best(self, threads: int) -> Standing | None:
        """The fastest but ours."""
        found = [s for s in self.standings if s.threads == threads and s.name != OURS and s.times]
        return min(found, key=lambda s: s.times.median_ms if s.times else 0.0, default=None)

    def fraction_of_peak(self, standing: Standing) -> float | None:
        """Useful operations a second over the machine's multiply-add peak."""
        if standing.times is None:
            return None
        done = operations(self.settings.pixels, self.settings.pictures)
        return self.machine.fraction(done, standing.times.median_ms, standing.threads)

    @property
    def versions(self) -> dict[str, str]:
        """Of Python, and of each package that took part."""
        found = {s.package: s.version for s in self.standings if s.version}
        packages = dict.fromkeys(entry.package for entry in ROSTER)
        versions = {package: found[package] for package in packages if package in found}
        return {"python": platform.python_version(), **versions}


def names(standings: Sequence[Standing]) -> list[str]:
    """Ours first, then by the best time at any number of threads; those without times last."""

    def fastest(name: str) -> float:
        times = [s.times.median_ms for s in standings if s.name == name and s.times]
        return min(times, default=float("inf"))

    others = dict.fromkeys(s.name for s in standings if s.name != OURS)
    return [OURS, *sorted(others, key=fastest)]
