"""How often the review of generated pictures finds deliberate damage, and refuses honest pictures.

A scene is rendered under many lights. One picture stands for the photograph, the others for what a
generator made of it. First all are honest. Then, set by set, five of them are damaged, and the same
review judges them: alone, then with all others. Nothing here draws or writes.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.acquire.review import Reviewer, Verdict
from pbrfit.synthetic import make_scene
from pbrfit_evaluation.review.damage import REPAINTS, Kind, damaged
from pbrfit_evaluation.review.pictures import Renderer, camera, relights

Array = NDArray[np.float64]

FIRST_SEED = 6000
"""Nothing was tuned on seeds from there on."""

LEAST_CAUGHT = 0.95
MOST_REFUSED = 0.05


@dataclass(frozen=True)
class Source:
    """Scenes of one kind by one renderer."""

    kind: str
    renderer: Renderer
    scenes: int

    @property
    def name(self) -> str:
        """For people and files."""
        return self.kind if self.renderer == "own" else f"{self.renderer}-{self.kind}"


@dataclass(frozen=True)
class Effort:
    """What is run.

    Attributes
    ----------
    size
        Of the pictures, in pixels.
    pictures
        A scene, besides the photograph.
    sets
        With damage, a scene: each has a shift, a warp, a swap and two repaints.
    """

    name: str
    size: int
    pictures: int
    sets: int
    sources: tuple[Source, ...]


FULL = Effort(
    "full",
    512,
    16,
    3,
    (
        Source("furnished", "cycles-full", 1),
        Source("furnished", "cycles", 4),
        Source("detailed", "cycles", 2),
        Source("furnished", "own", 3),
        Source("detailed", "own", 3),
        Source("textured", "own", 2),
        Source("room", "own", 1),
        Source("spheres", "own", 1),
    ),
)

QUICK = Effort("quick", 256, 8, 1, (Source("furnished", "own", 1), Source("textured", "own", 1)))


@dataclass(frozen=True)
class Task:
    """One scene."""

    kind: str
    renderer: Renderer
    seed: int
    size: int
    pictures: int
    sets: int
    cache: Path | None = field(default=None, repr=False)

    @property
    def source(self) -> str:
        """Name of the source it belongs to."""
        return Source(self.kind, self.renderer, 1).name

    @property
    def key(self) -> str:
        """Unique name, fit for a file."""
        return f"{self.source}.{self.seed}"


@dataclass(frozen=True)
class Judged:
    """One picture and what became of it.

    Attributes
    ----------
    damage
        What was done to it; "honest" nothing, "swap" is another room.
    among_damaged
        Whether other pictures of its set were damaged.
    refused
        Names of the checks it failed; empty if it was accepted.
    alone
        Whether it was refused against the photograph alone.
    amount
        Pixels of a shift or warp, share of the area of a repaint, 0 of others.
    values
        What each check found.
    """

    damage: str
    among_damaged: bool
    refused: tuple[str, ...]
    alone: bool
    amount: float
    values: dict[str, float]


def plan(effort: Effort, first_seed: int = FIRST_SEED, cache: Path | None = None) -> list[Task]:
    """All scenes."""
    return [
        Task(
            source.kind,
            source.renderer,
            first_seed + i,
            effort.size,
            effort.pictures,
            effort.sets,
            cache,
        )
        for source in effort.sources
        for i in range(source.scenes)
    ]


def work(task: Task, threads: int) -> dict[str, Any]:
    """Render, damage, review."""
    view = relights(
        task.kind,
        task.renderer,
        task.seed,
        size=task.size,
        count=task.pictures + 1,
        cache=task.cache,
        threads=threads,
    )
    pictures = [camera(picture) for picture in view.pictures]
    reviewer = Reviewer(pictures[0])
    found: list[dict[str, Any]] = []

    def judge(members: Sequence[Array], done: dict[int, tuple[str, float]]) -> None:
        for i, (alone, together) in enumerate(review(reviewer, members)):
            damage, amount = done.get(i, ("honest", 0.0))
            verdicts = [alone] if together is None else [alone, together]
            found.append(
                {
                    "damage": damage,
                    "among_damaged": bool(done),
                    "refused": [c.name for v in verdicts for c in v.checks if not c.passed],
                    "alone": not alone.accepted,
                    "amount": amount,
                    "values": {
                        prefix + check.name: check.value
                        for prefix, verdict in zip(("", "all "), verdicts, strict=False)
                        for check in verdict.checks
                    },
                }
            )

    judge(pictures[1:], {})
    for k in range(task.sets):
        # By source too: scenes of one seed would all be damaged alike.
        source = zlib.crc32(task.source.encode())
        rng = np.random.default_rng(np.random.SeedSequence([task.seed, source, k]))
        members = list(pictures[1:])
        repaints = [REPAINTS[(2 * k + j) % len(REPAINTS)] for j in range(2)]
        chosen = rng.choice(len(members), 5, replace=False)
        done: dict[int, tuple[str, float]] = {}
        damages: list[Kind] = ["shift", "warp", *repaints]
        for i, kind in zip(chosen, damages, strict=False):
            changed, amounts = damaged(view.pictures[i + 1], kind, view.segments, rng)
            members[i] = camera(changed)
            done[int(i)] = (kind, amounts.get("pixels", amounts.get("area", 0.0)))
        members[chosen[-1]] = _other_room(task, k)
        done[int(chosen[-1])] = ("swap", 0.0)
        judge(members, done)
    return {"judged": found}


def review(reviewer: Reviewer, pictures: Sequence[Array]) -> list[tuple[Verdict, Verdict | None]]:
    """Verdicts alone and, of those accepted, together: as a run of `pbrfit generate` does it."""
    alone = [reviewer.picture(picture) for picture in pictures]
    accepted = [i for i, verdict in enumerate(alone) if verdict.accepted]
    together = reviewer.together([pictures[i] for i in accepted])
    found = dict(zip(accepted, together, strict=True))
    return [(verdict, found.get(i)) for i, verdict in enumerate(alone)]


def _other_room(task: Task, k: int) -> Array:
    """A picture of another room, or of the same kind of scene by our own renderer."""
    seed = 100_000 + 10 * task.seed + k
    scene = make_scene(task.kind, size=task.size, lights=2, held_out=1, seed=seed)
    return camera(np.asarray(scene.images[0], np.float64))


def judged(values: Mapping[str, Any]) -> list[Judged]:
    """From what `work` returned."""
    return [Judged(**{**one, "refused": tuple(one["refused"])}) for one in values["judged"]]


@dataclass(frozen=True)
class Rate:
    """How many of some pictures were refused."""

    refused: int
    pictures: int

    @classmethod
    def of(cls, found: Iterable[Judged]) -> Rate:
        """Count."""
        every = [bool(one.refused) for one in found]
        return cls(sum(every), len(every))

    @property
    def share(self) -> float:
        """0 to 1; NaN of none."""
        return self.refused / self.pictures if self.pictures else float("nan")

    def interval(self) -> tuple[float, float]:
        """Of 95 %, by Wilson's score (1927): what share lies behind so few pictures."""
        if not self.pictures:
            return float("nan"), float("nan")
        z, n, p = 1.96, self.pictures, self.share
        middle = (p + z * z / (2 * n)) / (1 + z * z / n)
        half = z / (1 + z * z / n) * (p * (1 - p) / n + z * z / (4 * n * n)) ** 0.5
        return max(0.0, middle - half), min(1.0, middle + half)
