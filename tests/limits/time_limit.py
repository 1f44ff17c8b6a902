"""How long a fit goes on between two looks at its clock, and after the last one.

    python tests/limits/time_limit.py [--sizes 128 512 1024] [--lights 16] [--only NAME]

A time limit of S seconds ends a fit after S seconds and at most the longest time between two looks.
What follows, uncertainty and final errors, is bounded by the number of pixels and told apart.
"""

from __future__ import annotations

import argparse
import time
import traceback
from dataclasses import dataclass, field
from typing import Any

from pbrfit import Scene, decompose
from pbrfit.fit.solvers.run import Run
from pbrfit.result.options import Priors
from pbrfit.synthetic import make_scene

CONFIGURATIONS: dict[str, dict[str, Any]] = {
    "auto": {"refine_normals": "auto"},
    "normals on": {"refine_normals": "on"},
    "gauss-newton": {"solver": "gauss-newton", "refine_normals": "off"},
    "lbfgsb": {"solver": "lbfgsb", "refine_normals": "off", "iterations": 20},
    "huber": {"robust": "huber", "refine_normals": "off", "iterations": 20},
    "no priors": {"priors": Priors.none(), "refine_normals": "off"},
}


@dataclass
class Looks:
    """Gaps between looks at the clock of a fit."""

    last: float
    place: str = "the call"
    gaps: list[tuple[float, str, str]] = field(default_factory=list)

    def look(self) -> None:
        now = time.perf_counter()
        frames = [f for f in traceback.extract_stack()[:-2] if "pbrfit" in f.filename]
        place = " < ".join(f"{f.name}:{f.lineno}" for f in reversed(frames[-4:]))
        self.gaps.append((now - self.last, self.place, place))
        self.last, self.place = time.perf_counter(), place


def noisy(size: int, lights: int) -> Scene:
    """A furnished room with some noise, whose normals are a few degrees off."""
    return make_scene("furnished", size=size, lights=lights, held_out=1, noise=0.01)


def measure(scene: Scene, options: dict[str, Any]) -> tuple[Looks, float, float]:
    """Looks of a fit, the seconds after the last, and all its seconds."""
    plain = Run.out_of_time
    began = time.perf_counter()
    looks = Looks(began)

    def watched(run: Run) -> bool:
        looks.look()
        return plain(run)

    Run.out_of_time = watched  # type: ignore[method-assign,assignment]
    try:
        decompose(scene, **options)
    finally:
        Run.out_of_time = plain  # type: ignore[method-assign]
    ended = time.perf_counter()
    return looks, ended - looks.last, ended - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=[128, 512, 1024])
    parser.add_argument("--lights", type=int, default=16)
    parser.add_argument("--only", help="configurations whose name holds this")
    parser.add_argument("--worst", type=int, default=1, help="gaps to show")
    options = parser.parse_args()
    decompose(noisy(16, 3), iterations=2)  # libraries load
    for size in options.sizes:
        scene = noisy(size, options.lights)
        for name, given in CONFIGURATIONS.items():
            if options.only and options.only not in name:
                continue
            looks, rest, whole = measure(scene, given)
            print(f"{size}² × {options.lights}, {name}: {whole:.1f} s, after the last {rest:.2f} s")
            for gap, before, after in sorted(looks.gaps, reverse=True)[: options.worst]:
                print(f"    {gap:6.2f} s from {before}\n             to {after}", flush=True)


if __name__ == "__main__":
    main()
