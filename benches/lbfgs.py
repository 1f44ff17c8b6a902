"""Our bounded L-BFGS beside scipy's: `make bench-lbfgs` writes docs/benchmarks/lbfgs.md.

Time and memory of an iteration by the number of unknowns, and the loss after as many iterations
from the same start. Time beside the evaluations is what a method spends on itself.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import optimize
from threadpoolctl import threadpool_limits

from pbrfit.fit.objective import Objective
from pbrfit.fit.settings import LBFGS_PAIRS
from pbrfit.fit.solvers import projected_lbfgs
from pbrfit.fit.solvers.projected_lbfgs import Bounds
from pbrfit.synthetic import make_scene
from pbrfit_evaluation.convergence.cases import Case, make
from pbrfit_evaluation.report.summary import machine

Array = NDArray[np.float64]

METHODS = ("scipy", "rust")
SCIPY_PAIRS = 10
CHECKPOINTS = (50, 150, 500)
LOWEST_ROUGHNESS = 0.1
"""As in the first stage of a fit."""

INTRODUCTION = """\
# The bounded L-BFGS beside scipy's

{machine}, {threads} threads. `make bench-lbfgs` writes this page;
`pbrfit.fit.solvers.projected_lbfgs` is what
is measured, with {pairs} pairs beside scipy's L-BFGS-B with {scipy_pairs}.

"""

TIMES = """\
## An iteration

Synthetic rooms, {rounds} turns of {iterations} iterations from the default start, medians. "Beside
evaluations" is what the method spends on itself, and its share of an iteration. Memory is what
minimising adds to the largest resident size of a process, an unknown.

"""

LOSSES = """\
## The loss after as many iterations

Geometric means of our loss as a share of scipy's over rooms of 64², seeds {seeds}, from the default
start, roughness from {lowest} on.

"""


@dataclasses.dataclass
class Trace:
    """A minimisation: losses by iteration, evaluations, seconds and those spent in evaluations."""

    losses: list[float]
    evaluations: int = 0
    seconds: float = 0.0
    evaluating: float = 0.0

    def loss(self, iteration: int) -> float:
        """After so many iterations, or the last."""
        return self.losses[min(iteration, len(self.losses)) - 1]


def trace(method: str, objective: Objective, iterations: int, threads: int) -> Trace:
    """Minimise from the default start."""
    found = Trace([])

    def fun(x: Array) -> tuple[float, Array]:
        began = time.perf_counter()
        value = objective.value_and_grad(x)
        found.evaluating += time.perf_counter() - began
        found.evaluations += 1
        return value

    minimise = _scipy if method == "scipy" else _ours
    x0 = objective.start()
    began = time.perf_counter()
    minimise(fun, x0, objective, iterations, threads, found.losses)
    found.seconds = time.perf_counter() - began
    return found


Function = Callable[[Array], tuple[float, Array]]


def _ours(
    fun: Function, x0: Array, of: Objective, iterations: int, threads: int, losses: list[float]
) -> None:
    maps, roughness = (of.layout.maps, 0.0, 1.0), (of.roughness, LOWEST_ROUGHNESS, 1.0)
    projected_lbfgs.minimize(
        fun,
        x0,
        Bounds.of_slices(of.size, maps, roughness),
        iterations=iterations,
        threads=threads,
        callback=lambda state: losses.append(state.fun),
    )


def _scipy(
    fun: Function, x0: Array, of: Objective, iterations: int, _threads: int, losses: list[float]
) -> None:
    lower, upper = of.bounds.T.copy()
    lower[of.roughness] = LOWEST_ROUGHNESS
    with threadpool_limits(1, user_api="blas"):
        optimize.minimize(
            fun,
            x0,
            jac=True,
            method="L-BFGS-B",
            bounds=optimize.Bounds(lower, upper),
            callback=lambda intermediate_result: losses.append(float(intermediate_result.fun)),
            options={
                "maxiter": iterations,
                "maxfun": 10**9,
                "maxcor": SCIPY_PAIRS,
                "ftol": 0.0,
                "gtol": 0.0,
            },
        )


def memory(method: str, size: int, pictures: int) -> float:
    """Bytes an unknown that minimising adds, measured in a process of its own."""
    command = [sys.executable, __file__, "--memory-of", method]
    command += ["--sizes", str(size), "--pictures", str(pictures)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return float(done.stdout)


def added_memory(method: str, objective: Objective, threads: int) -> float:
    """Of this process: the peak of minimising above what is held before, an unknown. Linux only."""
    objective.value_and_grad(objective.start())
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # the peak starts anew
    before = _kibibytes("VmRSS")
    trace(method, objective, 2 * LBFGS_PAIRS, threads)
    return 1024 * (_kibibytes("VmHWM") - before) / objective.size


def _kibibytes(name: str) -> int:
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith(f"{name}:"):
            return int(line.split()[1])
    raise OSError(f"/proc/self/status: expected {name}, found none")


def times(
    sizes: Sequence[int], pictures: Sequence[int], iterations: int, rounds: int, threads: int
) -> str:
    """Markdown."""
    lines = [
        "| pictures | unknowns | method | an iteration, ms | beside evaluations, ms | share | "
        "B an unknown |",
        "|---|---|---|---|---|---|---|",
    ]
    for size in sizes:
        for count in pictures:
            objective = room(size, count, threads)
            found: dict[str, list[Trace]] = {method: [] for method in METHODS}
            for _ in range(rounds):
                for method in METHODS:
                    found[method].append(trace(method, objective, iterations, threads))
            for method, traces in found.items():
                whole = 1e3 * statistics.median(t.seconds for t in traces) / iterations
                own = statistics.median(t.seconds - t.evaluating for t in traces)
                own *= 1e3 / iterations
                added = memory(method, size, count)
                lines.append(
                    f"| {count} of {size}² | {objective.size:,} | {method} | {whole:.3g} | "
                    f"{own:.3g} | {100 * own / whole:.0f} % | {added:.0f} |"
                )
    return "\n".join(lines) + "\n\n"


def losses(seeds: Sequence[int], threads: int) -> str:
    """Markdown."""
    after = " | ".join(f"after {k}" for k in CHECKPOINTS)
    lines = [
        f"| scenes | {after} | largest | evaluations, scipy | ours | s, scipy | ours |",
        "|" + "---|" * (len(CHECKPOINTS) + 6),
    ]
    for kind, noise in (("no noise", 0.0), ("noise 1 %", 0.01)):
        pairs = []
        for seed in seeds:
            scene = make(Case(kind, 64, noise, "typical"), seed)
            objective = Objective(scene, threads=threads)
            of = [trace(method, objective, CHECKPOINTS[-1], threads) for method in METHODS]
            pairs.append(of)
        ratios = [[ours.loss(k) / theirs.loss(k) for theirs, ours in pairs] for k in CHECKPOINTS]
        cells = [f"{math.exp(statistics.fmean(map(math.log, of))):.3f}" for of in ratios]
        cells.append(f"{max(map(max, ratios)):.2f}")
        cells += [f"{statistics.fmean(p[i].evaluations for p in pairs):.0f}" for i in (0, 1)]
        cells += [f"{statistics.median(p[i].seconds for p in pairs):.2g}" for i in (0, 1)]
        lines.append(f"| {kind} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def room(size: int, pictures: int, threads: int) -> Objective:
    """Of a synthetic room."""
    scene = make_scene("room", size=size, lights=pictures, held_out=1, seed=2000)
    return Objective(scene, threads=threads)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description="Compare our bounded L-BFGS with scipy's.")
    parser.add_argument("--out", type=Path, help="page to write (default: standard output)")
    parser.add_argument("--sizes", type=int, nargs="+", default=[16, 32, 64, 128, 256, 512])
    parser.add_argument("--pictures", type=int, nargs="+", default=[4, 16])
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(2000, 2006)))
    parser.add_argument("--iterations", type=int, default=30)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--memory-of", choices=METHODS, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.memory_of is not None:
        objective = room(options.sizes[0], options.pictures[0], options.threads)
        print(added_memory(options.memory_of, objective, options.threads))
        return
    heading = INTRODUCTION.format(
        machine=machine()["processor"],
        threads=options.threads,
        pairs=LBFGS_PAIRS,
        scipy_pairs=SCIPY_PAIRS,
    )
    text = heading + TIMES.format(rounds=options.rounds, iterations=options.iterations)
    text += times(
        options.sizes, options.pictures, options.iterations, options.rounds, options.threads
    )
    seeds = f"{min(options.seeds)} to {max(options.seeds)}"
    text += LOSSES.format(seeds=seeds, lowest=LOWEST_ROUGHNESS)
    text += losses(options.seeds, options.threads)
    if options.out is None:
        print(text, end="")
    else:
        options.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
