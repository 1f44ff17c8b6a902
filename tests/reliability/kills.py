"""SIGKILL at any time of a batch, and on from there: nothing lost, half written or done twice.

    python tests/reliability/kills.py [--kills 100] [--scenes 8] [--seed 0] [--json FILE]

Rounds of `pbrfit decompose SCENES --out OUT --jobs 2 --resume`: each begins with scenes of which
some have changed (all are new in the first), and is killed again and again until it has had its
share of kills; then it may end. Half of the kills come at random times, half just before a step
on disk (`dying.py`), to all processes at once or to the batch's own, whose workers are then
orphans. A worker is killed in the last run of a round, some of which begin with --overwrite.

After each kill every result must be whole and of the old or the new scene; a scene that had one
must have one, in place or set aside to be put back; what was finished must not be done again. At
the end of a round all results are bit for bit those of an undisturbed run and nothing else is left.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from batches import (
    DYING,
    Content,
    Mark,
    content,
    ended,
    environment,
    faults_of,
    make_versions,
    mark,
    of_session,
    put_version,
    seconds_until,
    started,
    statuses,
)

VERSIONS = 3
OPTIONS = ("--iterations", "150", "--jobs", "2", "--json", "--quiet")
MOST_STEPS = 40
"""On disk, of a process, after which one of dying.py may kill it."""

A_ROUND = 8
"""Kills, at most."""

ORPHANS_WITHIN = 5.0
"""Seconds after the batch's own process has died that its workers may have."""

MOST_RENAMES = 6
"""As above; two of them replace a result."""

MOST_OF_ONE = 10
"""As above, of a worker."""

WHO = ("group", "group", "batch")


@dataclass(frozen=True)
class Kill:
    """One of them, and what was there then."""

    round: int
    who: str
    at: str
    stage: str
    finished: int
    orphans: float | None


@dataclass
class Round:
    """Scenes, what they held before, and what was seen since."""

    number: int
    versions: dict[str, int]
    overwriting: bool
    marks: dict[str, Mark]
    finished: dict[str, Mark] = field(default_factory=dict)
    done: Counter[str] = field(default_factory=Counter)


class Test:
    """Rounds on one output."""

    def __init__(self, folder: Path, scenes: int, seed: int) -> None:
        self.folder, self.chance = folder, random.Random(seed)
        self.scenes, self.out = folder / "scenes", folder / "out"
        self.names = [f"scene {number}" for number in range(scenes)]
        self.temporary = folder / "tmp"
        self.temporary.mkdir()
        self.faults: list[str] = []
        self.kills: list[Kill] = []
        self.again = self.left = self.completed = 0
        self.had: set[str] = set()
        self._made = make_versions(folder / "versions", scenes, VERSIONS)
        undisturbed = folder / "undisturbed"
        began = time.monotonic()
        code, _, errors = ended(["decompose", folder / "versions", "--out", undisturbed, *OPTIONS])
        assert code == 0, errors
        self.seconds = (time.monotonic() - began) / VERSIONS
        self.expected: dict[str, list[Content]] = {
            name: [content(undisturbed / path.name) for path in row]
            for name, row in zip(self.names, self._made, strict=True)
        }
        self.versions = dict.fromkeys(self.names, -1)

    def change(self, names: Sequence[str]) -> None:
        """Give these scenes their next version."""
        for name in names:
            self.versions[name] = (self.versions[name] + 1) % VERSIONS
            row = self._made[self.names.index(name)]
            put_version(self.scenes / name, row[self.versions[name]])

    def round(self, number: int, kills: int) -> None:
        """Kill it so many times, then let it end."""
        some = self.chance.sample(self.names, self.chance.randint(1, len(self.names)))
        changed = self.names if number == 0 else some
        previous = dict(self.versions)
        self.change(changed)
        self.allowed = {
            name: {self.expected[name][v] for v in (previous[name], self.versions[name]) if v >= 0}
            for name in self.names
        }
        now = Round(number, dict(self.versions), number % 3 == 2, self._marks())
        first = True
        for _ in range(kills):
            self._killed(now, overwriting=now.overwriting and first)
            first = False
            if len(now.finished) == len(self.names) and self.chance.random() < 0.5:
                break
        self._complete(now)

    def _arguments(self, overwriting: bool) -> list[object]:
        how = "--overwrite" if overwriting else "--resume"
        return ["decompose", self.scenes, "--out", self.out, *OPTIONS, how]

    def _killed(self, now: Round, *, overwriting: bool = False, ending: bool = False) -> None:
        who = "worker" if ending else self.chance.choice(WHO)
        kind, most = self.chance.choice([("", MOST_STEPS), ("os.rename", MOST_RENAMES)])
        step = self.chance.randint(1, most) if self.chance.random() < 0.5 else 0
        if ending:
            step = self.chance.randint(1, MOST_OF_ONE)  # there is not much left to do
        at = self.chance.uniform(0, 1.1 * self.seconds)
        once = self.folder / "died"
        once.unlink(missing_ok=True)
        told = self.folder / "told.jsonl"
        with told.open("w") as stdout, (self.folder / "errors").open("w") as stderr:
            batch = started(
                self._arguments(overwriting),
                program=[DYING],
                stdout=stdout,
                stderr=stderr,
                env=environment(
                    self.temporary,
                    DIE_AT=step,
                    DIE_WHO=who,
                    DIE_KIND=kind,
                    DIE_UNDER=self.out,
                    DIE_ONCE=once,
                ),
            )
            if not step:
                try:
                    batch.wait(at)
                except subprocess.TimeoutExpired:
                    if who == "group":
                        os.killpg(batch.pid, signal.SIGKILL)
                    else:
                        batch.kill()
            code = batch.wait(300)
        stage = self._stage() if code == -signal.SIGKILL else "ended before"
        if who == "batch" and self.chance.random() < 0.5:
            orphans = 0.0  # the next one begins beside them
        else:
            orphans = seconds_until(lambda: not of_session(batch.pid))
            if orphans > ORPHANS_WITHIN:
                self.faults.append(f"workers lived on for {orphans:.1f} s")
        if who == "worker":
            stage = "a worker died" if once.exists() else stage
        if code not in (0, -signal.SIGKILL):
            self.faults.append(f"exit code {code}: {(self.folder / 'errors').read_text()}")
        self._look(now, told.read_text(), overwriting=overwriting)
        died = stage != "ended before"
        if died:
            how = f"{'rename' if kind else 'step'} {step}" if step else f"{at:.2f} s"
            known = orphans if who == "batch" and orphans else None
            self.kills.append(Kill(now.number, who, how, stage, len(now.finished), known))

    def _stage(self) -> str:
        place = self.out / ".pbrfit"
        found = {"before the lock"}
        try:
            if (place / "lock").exists():
                found.add("no scene begun")
            for folder in place.iterdir() if place.is_dir() else ():
                if folder.name.endswith("-old"):
                    for old in folder.iterdir():
                        there = (self.out / old.name).exists()
                        found.add("old result set aside" if not there else "new result in place")
                elif folder.is_dir():
                    files = {path.name for path in folder.iterdir()}
                    whole = "result.json" in files
                    found.add("writing" if files and not whole else "whole" if whole else "fitting")
        except OSError:
            pass  # orphans are at work on it
        order = ("old result set aside", "new result in place", "whole", "writing", "fitting")
        return next((stage for stage in (*order, "no scene begun") if stage in found), min(found))

    def _marks(self) -> dict[str, Mark]:
        found = {}
        for name in self.names:
            try:
                found[name] = mark(self.out / name)
            except OSError:
                continue
        return found

    def _look(self, now: Round, told: str, *, overwriting: bool) -> None:
        """All that must hold at any time."""
        for name in self.names:
            place = self.out / name
            aside = [p for p in (self.out / ".pbrfit").glob(f"*-old/{name}") if p.is_dir()]
            if place.exists():
                if of := faults_of(place):
                    self.faults += of
                    continue
                if content(place) not in self.allowed[name]:
                    self.faults.append(f"{name}: neither the old result nor the new one")
                self.had.add(name)
            elif name in self.had and all(faults_of(one) for one in aside) and not place.exists():
                self.faults.append(f"{name}: its result is lost")
        for name, found in self._marks().items():
            if content(self.out / name) != self.expected[name][now.versions[name]]:
                continue
            if name in now.finished and now.finished[name] != found:
                self.again += 1
                self.faults.append(f"{name}: done again")
            if found != now.marks.get(name) or not overwriting:
                now.finished[name] = found
        for name, status in statuses(told):
            now.done[name] += status == "done"
            if status == "failed":
                self.faults.append(f"{name}: failed: {told}")
            if now.done[name] > 1:
                self.faults.append(f"{name}: told to be done {now.done[name]} times")

    def _complete(self, now: Round) -> None:
        self._killed(now, ending=True)
        for name in self.names:
            place = self.out / name
            if not place.exists() or content(place) != self.expected[name][now.versions[name]]:
                self.faults.append(f"{name}: other bits than those of an undisturbed run")
        left = {path.name for path in self.out.iterdir()} ^ set(self.names)
        left |= {path.name for path in self.temporary.iterdir()}
        self.left += len(left)
        self.faults += [f"left behind: {name}" for name in sorted(left)]
        _, told, _ = ended(self._arguments(False), env=environment(self.temporary))
        if sorted(statuses(told)) != [(name, "kept") for name in sorted(self.names)]:
            self.faults.append(f"done again: {told}")
        self.completed += 1


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--scenes", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="kills-"))
    test = Test(folder, options.scenes, options.seed)
    print(f"{options.scenes} scenes take {test.seconds:.1f} s undisturbed")
    number = 0
    while len(test.kills) < options.kills and not test.faults:
        before = len(test.kills)
        test.round(number, min(test.chance.randint(1, A_ROUND), options.kills - before))
        for kill in test.kills[before:]:
            print(
                f"round {kill.round}  {kill.who:7} {kill.at:>9}  {kill.stage:24} "
                f"{kill.finished} of {options.scenes} finished"
            )
        sys.stdout.flush()
        number += 1
    print(f"{len(test.kills)} kills in {test.completed} rounds")
    for what, counted in (
        ("of", Counter(kill.who for kill in test.kills)),
        ("while", Counter(kill.stage for kill in test.kills)),
    ):
        print(f"{what}: " + ", ".join(f"{n} {name}" for name, n in counted.most_common()))
    waits = [kill.orphans for kill in test.kills if kill.orphans is not None]
    if waits:
        print(f"orphans lived for {max(waits):.2f} s at most ({len(waits)} times)")
    print(f"{test.again} done again, {test.left} left behind")
    for fault in test.faults:
        print(f"FAULT: {fault}")
    if options.json:
        options.json.write_text(json.dumps([asdict(kill) for kill in test.kills], indent=1))
    if not test.faults:
        shutil.rmtree(folder)
    return bool(test.faults)


if __name__ == "__main__":
    sys.exit(main())
