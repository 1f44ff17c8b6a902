"""How often the review of generated pictures finds deliberate damage, and refuses honest pictures.

A scene is rendered under many lights. One picture stands for the photograph, the others for what a
generator made of it. First all are honest. Then, set by set, five of them are damaged, and the same
review judges them: alone, then with all others.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pbrfit.acquire.review import Reviewer, Verdict
from pbrfit.synthetic import make_scene
from pbrfit_evaluation import cycles
from pbrfit_evaluation.arrays import Array
from pbrfit_evaluation.jobs import Values
from pbrfit_evaluation.review.pictures import REPAINTS, Kind, Renderer, camera, damaged, relights
from pbrfit_evaluation.suite import Options


@dataclass(frozen=True)
class Task:
    """One scene."""

    kind: str
    renderer: Renderer
    seed: int
    size: int
    pictures: int
    sets: int

    @property
    def source(self) -> str:
        """Kind and renderer, for people and files."""
        return self.kind if self.renderer == "own" else f"{self.renderer}-{self.kind}"

    @property
    def key(self) -> str:
        """Unique name, fit for a file."""
        return f"{self.source}.{self.seed}"


def work(task: Task, threads: int) -> Values:
    """Render, damage, review.

    Returns
    -------
    `judged`, of each picture: its `damage` ("honest" is none, "swap" another room); whether it is
    `among_damaged`; names of the checks that `refused` it; whether it was refused against the
    photograph `alone`; and the `amount` of damage (pixels of a shift or warp, share of the area of
    a repaint, else 0).
    """
    view = relights(
        task.kind,
        task.renderer,
        task.seed,
        size=task.size,
        count=task.pictures + 1,
        threads=threads,
    )
    pictures = [camera(picture) for picture in view.images]
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
            changed, amounts = damaged(view.images[i + 1], kind, view.segments, rng)
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


def cases(options: Options) -> list[Task]:
    """All scenes; those by Cycles where it is there."""
    return [
        Task(kind, renderer, seed, options.size, options.pictures, options.sets)
        for kind, renderer, scenes in options.sources
        if renderer == "own" or not cycles.why_not()
        for seed in range(options.first_seed, options.first_seed + scenes)
    ]
