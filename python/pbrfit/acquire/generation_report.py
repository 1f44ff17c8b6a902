"""What a run of `pbrfit generate` did: for programs `review.json`, for people `review.png`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from pbrfit.acquire.journal import FOLDER, Journal
from pbrfit.acquire.photo import Photo
from pbrfit.acquire.rounds import Attempt, Picture
from pbrfit.io.json_files import as_json
from pbrfit.result.sheet import OUTSIDE, Panel, sheet
from pbrfit.values.arrays import Codes, Floats

FILE, SHEET = "review.json", "review.png"

COLUMNS = 5
"""Pictures of a sheet side by side, so that two dozen of them are five rows."""

CAPTION_LENGTH_MAX = 32
"""Letters of a caption, whose middle is left out above it: all captions of a sheet are as small as
the longest one needs."""


@dataclass(frozen=True, eq=False)
class GenerationReport:
    """What a run did."""

    out: Path
    photo: Photo
    with_photo: bool
    """Whether it is a picture of the scene too."""
    settings: dict[str, Any]
    pictures: Sequence[Picture]
    """All that were asked for, with every attempt."""
    reviewed: bool
    fov: float
    """Horizontal field of view in degrees."""
    assumed: dict[str, str]
    """In words, what was found or decided."""
    maps: dict[str, dict[str, Any] | None]
    """How normals, segments and depth were made; None where there are none."""

    @property
    def accepted(self) -> list[Picture]:
        """Generated pictures that are in the scene."""
        return [picture for picture in self.pictures if picture.accepted]

    @property
    def left_out(self) -> list[Picture]:
        """Those that are not, after all attempts."""
        return [picture for picture in self.pictures if not picture.accepted]

    def as_json(self) -> dict[str, Any]:
        """Content of `review.json`; docs/tutorials/one-photograph.md describes it."""
        height, width = self.photo.size
        seconds = sum(record.get("seconds") or 0.0 for record in self._records())
        return {
            "version": version("pbrfit"),
            "photo": {
                "file": self.photo.path.name,
                "sha256": self.photo.sha256,
                "size": [width, height],
                "in_scene": self.with_photo,
            },
            "assumed": {**self.photo.assumed, **self.assumed},
            "fov": self.fov,
            "generator": self.settings,
            "reviewed": self.reviewed,
            "pictures": [_picture(picture) for picture in self.pictures],
            **self.maps,
            "totals": {
                "asked_for": len(self.pictures),
                "accepted": len(self.accepted),
                "left_out": len(self.left_out),
                "attempts": sum(len(picture.attempts) for picture in self.pictures),
                "seconds": round(seconds, 3),
                "usage": _summed(record.get("usage") for record in self._records()),
            },
        }

    def sheet(self, journal: Journal) -> Codes:
        """Draw `review.png`, (H, W, 3)."""
        shown = []
        for picture in self.pictures:
            for k, attempt in enumerate(picture.attempts):
                caption, reason = picture.request.name, attempt.reason
                if len(picture.attempts) > 1:
                    caption += f", seed {attempt.entry.request.seed}"
                if k + 1 < len(picture.attempts):
                    reason += f" (asked again, seed {picture.attempts[k + 1].entry.request.seed})"
                elif reason:
                    reason += " (left out)"
                pixels = np.full((*self.photo.size, 3), OUTSIDE)
                if not attempt.entry.refused:
                    pixels = journal.pixels(attempt.entry) / 255.0
                shown.append(Panel(caption, pixels, note=reason))
        title = (
            f"{self.photo.path.name}: {len(self.accepted)} of {len(self.pictures)} pictures by "
            f"{self.settings.get('generator', 'the generator')}"
        )
        if not self.reviewed:
            title += ", not reviewed"
        return contact_sheet(self.photo.srgb8() / 255.0, shown, title=title)

    def _records(self) -> list[dict[str, Any]]:
        return [attempt.entry.record for picture in self.pictures for attempt in picture.attempts]


def contact_sheet(photo: Floats, pictures: Sequence[Panel], *, title: str) -> Codes:
    """The photo, then accepted pictures, then a part of its own for those that were refused.

    All as they go to the screen; pictures that were refused have a note that says why. Returns
    (H, W, 3) uint8.
    """
    half = (CAPTION_LENGTH_MAX - 1) // 2  # the ends tell pictures apart; the seed is at one of them
    pictures = [
        replace(one, caption=f"{one.caption[:half]}…{one.caption[-half:]}")
        if len(one.caption) > CAPTION_LENGTH_MAX
        else one
        for one in pictures
    ]
    accepted = [Panel("the photo", photo), *(one for one in pictures if not one.note)]
    refused = [one for one in pictures if one.note]
    columns = min(COLUMNS, max(len(accepted), len(refused)))
    parts = []
    for panels, above in ((accepted, title), (refused, f"Refused: {len(refused)}")):
        filled = [*panels, *[None] * (-len(panels) % columns)]  # so that both are equally wide
        rows = [filled[i : i + columns] for i in range(0, len(filled), columns)]
        parts += [sheet(rows, title=above)] if panels else []
    return np.concatenate(parts)


def _picture(picture: Picture) -> dict[str, Any]:
    return {
        "name": picture.request.name,
        "prompt": picture.request.prompt,
        "negative": picture.request.negative,
        "accepted": picture.accepted,
        "reason": picture.reason,
        "file": f"images/{picture.request.name}.png" if picture.accepted else None,
        "attempts": [_attempt(attempt) for attempt in picture.attempts],
    }


def _attempt(attempt: Attempt) -> dict[str, Any]:
    entry = attempt.entry
    return {
        "seed": entry.request.seed,
        "received": None if entry.refused else f"{FOLDER}/{entry.stem}.png",
        "accepted": not attempt.reason,
        "reason": attempt.reason,
        "checks": as_json(attempt.checks),
        "together": as_json(attempt.together),
        "record": entry.record,
    }


def _summed(usages: Iterable[Any]) -> dict[str, Any] | None:
    """Sum of numbers of the same name, level by level; None if there are none."""
    total: dict[str, Any] = {}
    for usage in usages:
        for key, value in usage.items() if isinstance(usage, dict) else ():
            if isinstance(value, dict):
                total[key] = _summed([total.get(key), value])
            elif isinstance(value, (int, float)) and not isinstance(value, bool):
                total[key] = total.get(key, 0) + value
    return total or None
