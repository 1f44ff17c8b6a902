"""What left-out pictures may say of a fit, for tests of all places that tell it."""

from __future__ import annotations

from dataclasses import replace

from pbrfit.result.held_out import Candidate, HeldOut

LAMP = "a lamp in each picture, linear values"
AROUND = "environment light, linear values, material prior"

EXPLAINED = HeldOut(
    error=0.0391,
    nearest_picture=0.0842,
    pictures=3,
    chosen=LAMP,
    candidates=(
        Candidate(AROUND, -6.01, 0.0374),
        Candidate(LAMP, -6.0, 0.0391),
        Candidate("a lamp in each picture, sRGB values", -4.2, 0.1234),
    ),
)
UNEXPLAINED = replace(EXPLAINED, error=0.12)

SENTENCE = "explains pictures it was not fitted to within 3.9 % (the nearest photograph: 8.4 %)"
EXCUSE = (
    "explains pictures it was not fitted to only within 12 %, no better than the nearest "
    "photograph (8.4 %)"
)
DECISION = f"chosen: {LAMP}; second: {AROUND}, 3.7 %"
