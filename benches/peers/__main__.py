"""`python -m peers`: the race, or with --scaling our own time over sizes."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from peers import machine, report, scaling
from peers.outcome import Outcome
from peers.race import Settings
from peers.roster import OURS, ROSTER

REPOSITORY = Path(__file__).resolve().parents[2]


def main() -> int:
    """Run what the options ask for."""
    options = _parser().parse_args()
    size = options.size or (64 if options.quick else 512)
    rounds = options.rounds or (3 if options.quick else 15)
    out = options.out or REPOSITORY / ("out" if options.quick else "docs") / "benchmarks"
    found = machine.Machine.find(options.machine, options.threads)
    if found.load is not None and found.load > machine.QUIET:
        print(
            f"load {found.load:.2f}: something else is at work, times will be off", file=sys.stderr
        )
    if options.scaling:
        sides, counts = scaling.QUICK if options.quick else scaling.FULL
        measured = scaling.measure(sides, counts, options.threads, rounds)
        report.write_scaling(measured, found, out)
        print(report.scaling_text(measured))
        return 0
    chosen = options.peers or [entry.name for entry in ROSTER]
    entries = [entry for entry in ROSTER if entry.name in (OURS, *chosen)]
    settings = Settings(size, options.pictures, options.threads, rounds)
    outcome = Outcome.of_race(entries, settings, found)
    report.write(outcome, out)
    print(report.text(outcome))
    return 0 if outcome.ours.times else 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m peers", description=__doc__)
    parser.add_argument("--size", type=_count, help="side of the pictures, pixels (512)")
    parser.add_argument("--pictures", type=_count, default=16, help="(16)")
    parser.add_argument("--threads", type=_count, default=2, help="of each peer (2)")
    parser.add_argument("--rounds", type=_count, help="timed evaluations of each peer (15)")
    parser.add_argument(
        "--peers",
        nargs="+",
        choices=[entry.name for entry in ROSTER],
        metavar="NAME",
        help="these only, beside ours: " + ", ".join(entry.name for entry in ROSTER),
    )
    parser.add_argument("--machine", type=Path, help="what the machine bench printed with --json")
    parser.add_argument("--out", type=Path, help="folder for results (docs/benchmarks)")
    parser.add_argument("--scaling", action="store_true", help="our own time over sizes instead")
    parser.add_argument("--quick", action="store_true", help="small and short, to out/benchmarks")
    return parser


def _count(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number from 1, found {text}")
    return number


if __name__ == "__main__":
    sys.exit(main())
