"""Pages of the console in Debian's chromium: open one, wait for what it shows."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

LIMIT = 20.0
"""[s] until what must happen has happened, on a busy machine."""
CHROMIUM = "/usr/bin/chromium"
FLAT = ["--no-sandbox", "--disable-gpu"]
SOLID = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
"""With WebGL; without a graphics card each picture takes four times the processor, also of a page that has none."""


@contextmanager
def chromium() -> Iterator[Browser]:
    """It must be there: `apt-get install chromium`. It has no WebGL."""
    with sync_playwright() as play:
        found = play.chromium.launch(executable_path=CHROMIUM, args=FLAT)
        try:
            yield found
        finally:
            found.close()


def until(page: Page, expression: str, limit: float = LIMIT) -> Any:
    """The value of an expression once it is true. (The page's own policy forbids playwright's waiting for one.)"""
    end = time.monotonic() + limit
    while not (value := page.evaluate(expression)):
        assert time.monotonic() < end, f"{expression} never came true"
        page.wait_for_timeout(20)
    return value


def soon(page: Page, condition: Callable[[], bool]) -> None:
    """Wait for something outside the page."""
    end = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        page.wait_for_timeout(20)


def on_screen(page: Page, x: float, y: float) -> tuple[float, float]:
    """Where on the page a place on the ground is drawn [px], once the view rests."""
    script = """([x, y]) => {
        const { camera, ground, kind } = consoleView;
        if (kind === "3D") return camera.project([x, y, ground.height(x, y)]);
        const scale = camera.height / (2 * camera.distance * Math.tan(camera.fov / 2));
        return [camera.width / 2 + (x - camera.at[0]) * scale, camera.height / 2 - (y - camera.at[1]) * scale];
    }"""
    at, end = page.evaluate(script, [x, y]), time.monotonic() + LIMIT
    while True:
        page.wait_for_timeout(150)
        before, at = at, page.evaluate(script, [x, y])
        if before is not None and at == pytest.approx(before, abs=0.5):
            break
        assert time.monotonic() < end, "the view never rests"
    box = page.locator("#view canvas").bounding_box()
    assert at is not None
    assert box is not None
    return box["x"] + at[0], box["y"] + at[1]
