"""`python -m fuzz`: damage files, read them, and keep what went wrong.

A failed case is a folder: the files as read, and in `case.json` by what. `--replay` reads it again.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from pathlib import Path

from tqdm import tqdm

from fuzz import watch
from fuzz.cases import Plan, digest, place, plan
from fuzz.readers import READERS
from fuzz.seeds import Seed
from fuzz.worker import Tally, fast_folder

ALIKE = 3
"""Failed cases kept of those whose problem reads the same."""


def main() -> int:
    """Exit code: 0 if no case failed, 1 if some did."""
    options = _options()
    with fast_folder():
        return _fuzz(options) if options.replay is None else _replay(options.replay)


def _fuzz(options: argparse.Namespace) -> int:
    began = time.monotonic()
    names = options.readers or [reader.name for reader in READERS]
    chosen = [reader for reader in READERS if reader.name in names]
    shares = sum(reader.share for reader in chosen)
    plans = {
        reader.name: plan(reader, -(-options.cases * reader.share // shares), options.seed)
        for reader in chosen
    }
    total = sum(one.count for one in plans.values())
    kept: Counter[str] = Counter()
    failures: Counter[str] = Counter()
    with tqdm(total=total, unit=" cases", disable=None, smoothing=0) as bar:

        def failed(reader: str, number: int, problem: str) -> None:
            kind = problem.split(": ")[0]  # its first words, or the place in the code
            failures[reader] += 1
            kept[kind] += 1
            if kept[kind] <= ALIKE:
                folder = _keep(options.out, plans[reader], number, problem)
                tqdm.write(f"{folder}: {problem[:300]}", file=sys.stderr)

        tallies = watch.run(plans, options.jobs, failed, bar.update)
    _tell(tallies, failures, total, time.monotonic() - began)
    if failures:
        print(f"failed cases are in {options.out}; read one again with --replay FOLDER")
    return 1 if failures else 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__)
    parser.add_argument("--cases", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0, help="equal seeds make equal cases")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument(
        "--readers", nargs="+", choices=[reader.name for reader in READERS], help="only these"
    )
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"), help="for failed cases")
    parser.add_argument("--replay", type=Path, metavar="FOLDER", help="a failed case, once more")
    return parser.parse_args()


def _keep(out: Path, cases: Plan, number: int, problem: str) -> Path:
    case = cases.case(number)
    folder = out / f"{cases.reader}-{number}-{digest(case)}"
    place(case, folder / "files")
    told = {"reader": cases.reader, "seed": case.name, "target": case.target, "problem": problem}
    (folder / "case.json").write_text(json.dumps(told, indent=1), encoding="utf-8")
    return folder


def _replay(folder: Path) -> int:
    told = json.loads((folder / "case.json").read_text(encoding="utf-8"))
    files = {
        path.relative_to(folder / "files").as_posix(): path.read_bytes()
        for path in (folder / "files").rglob("*")
        if path.is_file()
    }
    case = Seed(told["seed"], told["target"], files)
    found: list[str] = []
    plans = {told["reader"]: Plan(told["reader"], (), (case,), 1, 0)}
    watch.run(plans, 1, lambda *answer: found.append(answer[2]), lambda _: None)
    print("\n".join(found) if found else "passes")
    return 1 if found else 0


def _tell(tallies: dict[str, Tally], failures: Counter[str], total: int, seconds: float) -> None:
    print(
        f"{'reader':10}{'cases':>9}{'answer':>9}{'refused':>9}{'failed':>8}"
        f"{'slowest':>10}{'most memory':>14}{'of its bound':>14}"
    )
    for name, tally in tallies.items():
        cases = tally.outcomes.total()
        answers = tally.outcomes["answer"]
        refused = tally.outcomes["refused"]
        print(
            f"{name:10}{cases:9}{answers:9}{refused:9}{failures[name]:8}"
            f"{tally.slowest:8.2f} s{tally.growth >> 20:10} MiB{tally.share_of_bound:13.0%}"
        )
    print(f"{total} cases, {failures.total()} failed, {seconds:.0f} s")


if __name__ == "__main__":
    sys.exit(main())
