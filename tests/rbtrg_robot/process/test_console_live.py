"""A whole stack and a real page: a goal pressed on the ground moves the robot, STOP makes it stand."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urljoin

import pytest
from playwright.sync_api import Page

from tests.rbtrg_robot.console.pages import chromium, on_screen, until
from tests.rbtrg_robot.process.command import SPARSE, command
from tools.bench.ports import free_port

pytestmark = pytest.mark.timeout(300)
NAME = "pressed"
LIMIT = 60.0
"""[s] on a busy machine."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The runtime folder of a stack. Nothing is left running."""
    tmp_path = tmp_path_factory.mktemp("run")
    words = ("--scene", "flat", "--port", str(free_port()), "--console-port", "0", "--no-record", *SPARSE)
    try:
        up = command(
            tmp_path,
            *("up", "--detach", "--robot", NAME, "--without", "mission", *words),
            *("--log-dir", str(tmp_path / "logs")),
        )
        assert up.returncode == 0, up.stderr
        assert re.search(r"^console: http://127\.0\.0\.1:\d+/enter\?token=\S+$", up.stdout, re.MULTILINE), (
            up.stdout
        )
        yield tmp_path
    finally:
        down = command(tmp_path, "down", "--robot", NAME)
        assert down.returncode == 0, down.stderr


@pytest.fixture
def address(folder: Path) -> str:
    """A fresh one."""
    said = command(folder, "console", "--robot", NAME)
    assert said.returncode == 0, said.stderr
    return said.stdout.strip()


def figure(page: Page, name: str) -> list[float]:
    """Numbers of a row that tells of the robot."""
    row = page.locator(f"#figures dt:text-is('{name}') + dd").inner_text()
    return [float(number) for number in re.findall(r"-?\d+(?:\.\d+)?", row)]


@pytest.mark.campaign
def test_a_press_on_the_ground_moves_the_robot_and_stop_makes_it_stand(address: str) -> None:
    with chromium() as browser:
        page = browser.new_page(viewport={"width": 800, "height": 600}, reduced_motion="reduce")
        page.context.request.get(address)
        # 3D without a graphics card takes the robot's share of the processor
        page.goto(urljoin(address, "/?flat"))
        until(
            page,
            "!!window.consoleView && consoleView.world.pose && consoleView.ground.tiles.size > 3 "
            "&& document.body.dataset.fresh === 'live' && document.querySelector('#lease').textContent === "
            "'you operate'",
            LIMIT,
        )
        page.click("#follow")  # the ground stays under the mouse
        page.click("#points")
        x, y, _ = figure(page, "Place")
        press = on_screen(page, x + 3.0, y)
        page.mouse.move(*press)
        page.mouse.down()
        page.mouse.move(press[0], press[1] - 60.0, steps=3)  # up is +y in the picture from above
        page.mouse.up()
        verdict = "document.querySelector('#answer .verdict.no, #go:not([hidden])')?.innerText"
        assert until(page, verdict, LIMIT) == "Go"
        assert float(page.input_value("#gx")) == pytest.approx(x + 3.0, abs=0.15)
        assert float(page.input_value("#gyaw")) == pytest.approx(90.0, abs=15.0)
        page.click("#go")
        until(page, f"consoleView.world.pose.x > {x + 0.15}", LIMIT)
        box = page.locator("#halt").bounding_box()
        assert box is not None
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        page.mouse.down()  # and not up: pressing is enough
        until(
            page,
            "document.querySelector('#stop-said').textContent === 'STOP confirmed by the robot'",
            LIMIT,
        )
        until(page, "document.querySelector('#figures').textContent.includes('Speed0.00 m/s')", LIMIT)
        before = figure(page, "Place")
        page.wait_for_timeout(500)
        assert figure(page, "Place") == pytest.approx(before, abs=0.03)
        assert before[0] < x + 2.5  # it did not come to its goal
        assert page.inner_text("#said") == "Stopped"
        assert page.inner_text("#why-still") == "emergency stop: console"
        page.click("#act-resume")
        page.click("#act-continue")
        until(page, f"consoleView.world.pose.x > {before[0] + 0.15}", LIMIT)
