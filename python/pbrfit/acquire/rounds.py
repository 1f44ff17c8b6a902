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


def make_pictures(
    requests: Iterable[Request],
    photo: Photo,
    generator: Generator,
    journal: Journal,
    reviewer: Reviewer | None,
    regenerate: int,
    progress: Progress,
) -> list[Picture]:
    """Ask for all and review them.

    Raises InputError, OSError or MemoryError if the generator cannot go on. What had come is in the
    journal.
    """
    pictures = [Picture(request) for request in requests]

    def tell(what: str, begun: int) -> None:
        asked = begun + sum(len(picture.attempts) for picture in pictures)
        progress(what, asked, max(asked, len(pictures)))

    def attempt(request: Request) -> Attempt:
        entry = journal.find(request)
        if entry is None:
            tell(f"{request.name}, seed {request.seed}", 1)
            answer: Generated | Refused
            try:
                answer = generator.generate(photo, request)
            except Refused as refusal:
                answer = refusal
            entry = journal.keep(request, answer)
        else:
            tell(f"{request.name}, in the journal", 1)
        if entry.refused or reviewer is None:
            return Attempt(entry, reason=entry.refused)
        verdict = reviewer.picture(LINEAR(journal.pixels(entry)))
        return Attempt(entry, verdict.checks, reason=verdict.reason)

    refused = pictures
    while refused:
        for picture in refused:
            for k in range(len(picture.attempts), 1 + (regenerate if generator.retries else 0)):
                seed = picture.request.seed + k * RETRY_STEP
                picture.attempts.append(attempt(replace(picture.request, seed=seed)))
                # What the generator itself refused would be refused again.
                if picture.accepted or picture.attempts[-1].entry.refused:
                    break
        accepted = [picture for picture in pictures if picture.accepted]
        if reviewer is None or not accepted:
            break
        tell("reviewing together", 0)
        entries = (picture.attempts[-1].entry for picture in accepted)
        verdicts = reviewer.together([LINEAR(journal.pixels(entry)) for entry in entries])
        for picture, verdict in zip(accepted, verdicts, strict=True):
            picture.attempts[-1] = replace(
                picture.attempts[-1], together=verdict.checks, reason=verdict.reason
            )
        refused = [picture for picture in accepted if not picture.accepted]
    return pictures
