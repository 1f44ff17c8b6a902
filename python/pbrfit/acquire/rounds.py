"""Pictures asked for and reviewed in rounds, until each is accepted or left out.

The first round asks for every picture and judges each by itself against the photo; what is refused
is asked for again with another seed. Then those that were accepted are judged together, and the
ones that do not agree with the rest are asked for again, as long as there are attempts left.
Generators and the review always give the same for the same, so a run that was stopped comes to the
same attempts again and finds them in the journal.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

from pbrfit.acquire.generators import RETRY_STEP, Generated, Generator, Refused, Request
from pbrfit.acquire.journal import Entry, Journal
from pbrfit.acquire.photo import Photo
from pbrfit.acquire.review import Check, Reviewer
from pbrfit.io.color import Conversion

LINEAR = Conversion("srgb")
"""Gives the linear light of received pictures."""

REGENERATE = 2
"""How often a picture that the review refused is asked for again, with another seed each time."""


@dataclass(frozen=True, eq=False)
class Attempt:
    """One answer of the generator and what became of it."""

    entry: Entry
    checks: tuple[Check, ...] = ()
    """Of the picture by itself; empty without a review, or where there is no picture."""
    together: tuple[Check, ...] = ()
    """Of the picture beside the others, when it was last among those that were accepted."""
    reason: str = ""
    """Why it was refused; empty for one that was accepted."""


@dataclass(eq=False)
class Picture:
    """One lighting: the first request for it, and all attempts, the last of which counts."""

    request: Request
    attempts: list[Attempt] = field(default_factory=list)

    @property
    def accepted(self) -> bool:
        """Whether the last attempt was."""
        return not self.attempts[-1].reason

    @property
    def reason(self) -> str:
        """Why the last attempt was refused."""
        return self.attempts[-1].reason


Progress = Callable[[str, int, int], None]
"""Told what is done next, which picture that is, from 1 on, and how many there will be so far."""


@dataclass(eq=False)
class Rounds:
    """What the rounds need, and how many pictures were asked for."""

    photo: Photo
    generator: Generator
    journal: Journal
    reviewer: Reviewer | None
    regenerate: int
    progress: Progress
    asked: int = 0
    wanted: int = 0

    def make(self, requests: Iterable[Request]) -> list[Picture]:
        """Ask for all and review them.

        Raises InputError, OSError or MemoryError if the generator cannot go on. What had come is in
        the journal.
        """
        pictures = [Picture(request) for request in requests]
        self.wanted = len(pictures)
        for picture in pictures:
            self._until_accepted(picture)
        if self.reviewer is None:
            return pictures
        while accepted := [picture for picture in pictures if picture.accepted]:
            self._tell("reviewing together")
            entries = (picture.attempts[-1].entry for picture in accepted)
            verdicts = self.reviewer.together([LINEAR(self.journal.pixels(e)) for e in entries])
            for picture, verdict in zip(accepted, verdicts, strict=True):
                picture.attempts[-1] = replace(
                    picture.attempts[-1], together=verdict.checks, reason=verdict.reason
                )
            refused = [picture for picture in accepted if not picture.accepted]
            if not refused:
                break
            for picture in refused:
                self._until_accepted(picture)
        return pictures

    def _until_accepted(self, picture: Picture) -> None:
        """Attempts at one picture, while it is refused by the review and may be asked for again.

        What the generator itself refused would be refused again.
        """
        most = 1 + (self.regenerate if self.generator.retries else 0)
        for k in range(len(picture.attempts), most):
            picture.attempts.append(self._attempt(picture.request, k))
            if picture.accepted or picture.attempts[-1].entry.refused:
                return

    def _attempt(self, first: Request, k: int) -> Attempt:
        request = replace(first, seed=first.seed + k * RETRY_STEP)
        self.asked += 1
        entry = self.journal.find(request)
        if entry is None:
            self._tell(f"{request.name}, seed {request.seed}")
            answer: Generated | Refused
            try:
                answer = self.generator.generate(self.photo, request)
            except Refused as refusal:
                answer = refusal
            entry = self.journal.keep(request, answer)
        else:
            self._tell(f"{request.name}, in the journal")
        if entry.refused or self.reviewer is None:
            return Attempt(entry, reason=entry.refused)
        verdict = self.reviewer.picture(LINEAR(self.journal.pixels(entry)))
        return Attempt(entry, verdict.checks, reason=verdict.reason)

    def _tell(self, what: str) -> None:
        self.progress(what, self.asked, max(self.asked, self.wanted))
