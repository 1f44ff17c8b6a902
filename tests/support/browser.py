"""A headless browser for tests of pages; without one they skip.

It is looked for by the environment variable PBRFIT_CHROMIUM, then in the search path.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

NAMES = ("chromium", "chromium-browser", "google-chrome")

SOFTWARE_GL = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
"""WebGL without a graphics card."""


@dataclass
class Visit:
    """An open page, and all that went wrong on it so far, in words."""

    page: Page
    troubles: list[str] = field(default_factory=list)


def executable() -> str:
    """Path of a Chromium; skips the test where there is none, or nothing to drive it."""
    pytest.importorskip("playwright.sync_api")
    found = os.environ.get("PBRFIT_CHROMIUM") or next(filter(None, map(shutil.which, NAMES)), None)
    if found is None:
        pytest.skip(f"no browser: none of {', '.join(NAMES)}, and PBRFIT_CHROMIUM is not set")
    return found


def wait_until(page: Page, condition: str, arg: object = None) -> None:
    """Wait for a condition; Playwright's own wait evaluates text, which pages forbid."""
    end = time.monotonic() + 30
    while not page.evaluate(condition, arg):
        assert time.monotonic() < end, f"not within 30 s: {condition}"
        page.wait_for_timeout(20)


@contextmanager
def launched(*flags: str) -> Iterator[Browser]:
    """Give a browser; `flags` are Chromium's own."""
    path = executable()
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=path, args=["--no-sandbox", *SOFTWARE_GL, *flags]
        )
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def visit(browser: Browser, file: Path, width: int = 1280, height: int = 800) -> Iterator[Visit]:
    """Open a file as people do, by file://; collects console errors and requests to elsewhere."""
    page = browser.new_page(viewport={"width": width, "height": height})
    visited = Visit(page)
    troubles = visited.troubles
    page.on(
        "console",
        lambda m: (
            troubles.append(f"{m.type}: {m.text}") if m.type in ("error", "warning") else None
        ),
    )
    page.on("pageerror", lambda error: troubles.append(f"exception: {error}"))
    page.on("requestfailed", lambda request: troubles.append(f"failed: {request.url[:80]}"))
    address = file.resolve().as_uri()

    def watch(url: str) -> None:
        if not url.startswith(("data:", "blob:")) and url.partition("#")[0] != address:
            troubles.append(f"requested: {url[:80]}")

    page.on("request", lambda request: watch(request.url))
    try:
        page.goto(address)
        yield visited
    finally:
        page.close()
