"""Cases: which file in which folder, decided by reader, number and seed alone."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random

from fuzz.readers import Reader, damage_of
from fuzz.seeds import Seed


@dataclass(frozen=True)
class Plan:
    """All cases of a reader, of sound folders; those of files made to deceive (`crafted`) first."""

    reader: str
    sound: Sequence[Seed]
    crafted: Sequence[Seed]
    count: int
    seed: int

    def case(self, number: int) -> Seed:
        """The folder of a case, 0 <= number < count."""
        if number < len(self.crafted):
            return self.crafted[number]
        rng = Random(f"{self.seed} {self.reader} {number}")
        sound = rng.choice(self.sound)
        return sound.damaged(damage_of(sound)(rng, sound.data))


def plan(reader: Reader, count: int, seed: int) -> Plan:
    """Cases of a reader; at most half of them are crafted files, evenly chosen from all."""
    sound = tuple(reader.seeds())
    known: dict[str, Seed] = {}
    for one in sound:
        known.setdefault(Path(one.target).suffix, one)
    made = []
    for name, data in reader.crafted():
        base = known[reader.crafted_suffix or Path(sound[0].target).suffix]
        named = Seed(f"{base.name}: {name}", base.target, base.files)
        made.append(named.damaged(data))
    most = min(len(made), count // 2)
    chosen = [made[k * len(made) // most] for k in range(most)]
    return Plan(reader.name, sound, chosen, count, seed)


def place(case: Seed, folder: Path) -> Path:
    """Write the folder of a case; returns the damaged file."""
    for relative, data in case.files.items():
        path = folder / relative
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    return folder / case.target


def digest(case: Seed) -> str:
    """Short name of a case's content."""
    return hashlib.sha256(case.target.encode() + case.data).hexdigest()[:12]
