"""Named steps of long work, told as records of a logger: who wants to show them listens."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager

log = logging.getLogger("pbrfit.steps")
"""A record as a step begins, whose `seconds` is None, and one as it ends."""


@contextmanager
def step(name: str) -> Iterator[None]:
    """Tell that the block begins, and what it took."""
    began = time.perf_counter()
    log.info(name, extra={"seconds": None})
    yield
    log.info(name, extra={"seconds": time.perf_counter() - began})
