"""`python -m peers`: the race, and our own time over numbers of pictures and pixels."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from pbrfit_evaluation.report import markdown
from peers import kernel, machine, report
from peers.outcome import Outcome
from peers.race import Settings, race
from peers.roster import OURS, ROSTER


def main() -> int:
    """Run what the options ask for."""
    options = _parser().parse_args()
    size = options.size or (64 if options.quick else 512)
    rounds = options.rounds or (3 if options.quick else 15)
    threads = tuple(sorted(set(options.threads)))
    found = machine.Machine.find(options.machine, threads)
    if found.load is not None and found.load > machine.QUIET:
        print(
            f"load {found.load:.2f}: something else is at work, times will be off", file=sys.stderr
        )
    chosen = options.peers or [entry.name for entry in ROSTER]
    entries = [entry for entry in ROSTER if entry.name in (OURS, *chosen)]
    settings = Settings(size, options.pictures, threads, rounds)
    outcome = Outcome(settings, found, tuple(race(entries, settings)))
    points = kernel.measure(kernel.points(threads, quick=options.quick), rounds)
    for title, table in report.tables(outcome, points).items():
        print(f"{title}\n\n{markdown(table)}")
    if options.docs is not None:
        report.record(outcome, points, options.docs)
    return 0 if all(outcome.of(OURS, count).times for count in threads) else 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m peers", description=__doc__)
    parser.add_argument("--size", type=_count, help="side of the pictures, pixels (512)")
    parser.add_argument("--pictures", type=_count, default=16, help="(16)")
    parser.add_argument(
        "--threads", type=_count, nargs="+", default=[1, 2], help="of each peer, all in turn (1 2)"
    )
    parser.add_argument("--rounds", type=_count, help="turns of each peer (15)")
    parser.add_argument(
        "--peers",
        nargs="+",
        choices=[entry.name for entry in ROSTER],
        metavar="NAME",
        help="these only, beside ours: " + ", ".join(entry.name for entry in ROSTER),
    )
    parser.add_argument("--machine", type=Path, help="what the machine bench printed with --json")
    parser.add_argument("--docs", type=Path, help="documentation whose tables to fill")
    parser.add_argument("--quick", action="store_true", help="small and short")
    return parser


def _count(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number from 1, found {text}")
    return number


if __name__ == "__main__":
    sys.exit(main())
