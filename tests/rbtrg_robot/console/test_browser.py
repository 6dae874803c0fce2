"""The page in a real browser (Debian's chromium), on a made-up stack: what people see, and above all that STOP
works."""

from __future__ import annotations

import io
import json
import math
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from axe_playwright_python.sync_playwright import Axe
from PIL import Image
from playwright.sync_api import Browser, BrowserContext, Page

from hal.camera import CameraFrame
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.camera import image_msg
from rbtrg_robot.log.read import CONFIG
from rbtrg_robot.log.write import LogWriter
from rbtrg_robot.processes import PROCESSES
from rbtrg_robot.wire.convert import odometry_msg, patch_msg, transform_msg
from rbtrg_robot.wire.messages import encode, header
from tests.rbtrg_robot.console.pages import CHROMIUM, LIMIT, SOLID, chromium, on_screen, soon, until
from tools.bench.console.stack import PACE_LENGTH, Console, Robot, grey, ground, report

JOB = 90.0
"""[s] for a process of low priority that imports the stages, or for what compiles kernels."""
DESK, PHONE = {"width": 1000, "height": 640}, {"width": 360, "height": 740}


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """It must be there: `apt-get install chromium`."""
    with chromium() as found:
        yield found


@pytest.fixture(scope="module")
def solid(browser: Browser) -> Iterator[Browser]:
    """One with WebGL."""
    found = browser.browser_type.launch(executable_path=CHROMIUM, args=SOLID)
    yield found
    found.close()


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("run")))
        made = Robot()
        yield made
        made.close()


@pytest.fixture(scope="module")
def console(robot: Robot, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Console]:
    made = Console(robot, tmp_path_factory.mktemp("console"))
    yield made
    made.close()


@pytest.fixture(scope="module")
def usual(browser: Browser) -> list[Page]:
    """The page that most tests visit: a process of its own for each takes three times the processor."""
    return []


@pytest.fixture
def visit(
    browser: Browser, console: Console, robot: Robot, usual: list[Page], request: pytest.FixtureRequest
) -> Iterator[Callable[..., Page]]:
    """A page as somebody sees it who opens it now, once it shows the robot: from above, for without a graphics card 3D
    takes ten times the processor."""
    robot.reset()
    contexts: list[BrowserContext] = []
    visited: list[Page] = []

    def enter(
        role: str = "operator", size: Any = DESK, *, wait: bool = True, flat: bool = True, **options: Any
    ) -> Page:
        plain = not visited and wait and flat and not options and (role, size) == ("operator", DESK)
        if plain and usual and not usual[0].is_closed():
            page = usual[0]
            context = page.context
        else:
            chosen: Browser = browser if flat else request.getfixturevalue("solid")
            context = chosen.new_context(viewport=size, reduced_motion="reduce", **options)
            context.set_default_timeout(1000 * LIMIT)
            page = context.new_page()
            if plain:
                usual[:] = [page]
            else:
                contexts.append(context)
        visited.append(page)
        address = console.address(role)
        if flat:
            context.request.get(address)  # with its answer comes the cookie
            address = address.partition("/enter")[0] + "/?flat"
        page.goto(address)
        if wait:
            until(
                page,
                "!!window.consoleView && consoleView.ground.tiles.size > 10 && document.body.dataset.fresh === 'live'",
            )
        return page

    yield enter
    for context in contexts:
        context.close()
    for page in usual:
        if page in visited and not page.is_closed():
            page.mouse.up()
            page.mouse.move(0, 0)
            page.keyboard.up("ArrowUp")
            for other in page.context.pages:
                if other is not page:
                    other.close()
            page.goto(console.address().partition("/enter")[0] + "/about")  # it leaves the robot alone
            page.context.clear_cookies()


# --- goals --------------------------------------------------------------------------------------------------


def test_a_goal_by_mouse_is_shown_before_it_is_sent(visit: Callable[..., Page], robot: Robot) -> None:
    page = visit(flat=False)
    page.click("#follow")  # a view that moves with the robot would move the ground under the mouse
    press, end = on_screen(page, 2.4, 0.6), on_screen(page, 2.4, 1.4)
    page.mouse.move(*press)
    page.mouse.down()
    page.mouse.move(*end, steps=4)
    page.mouse.up()
    page.wait_for_selector("#go:not([hidden])")
    assert "It would go" in page.inner_text("#answer")
    assert "Worst place" in page.inner_text("#answer")
    assert robot.goals == []
    assert float(page.input_value("#gyaw")) == pytest.approx(90.0, abs=12.0)
    yaw = page.evaluate("consoleView.world.goal.yaw")
    page.click("#go")
    soon(page, lambda: bool(robot.goals))
    goal = robot.goals[0]
    assert (goal.x, goal.y) == pytest.approx((2.4, 0.6), abs=0.1)
    assert goal.yaw == pytest.approx(yaw, abs=0.02)
    soon(page, lambda: robot.state == "reached")
    until(page, "document.querySelector('#why-still').textContent.includes('reached')")


def test_a_page_that_shifts_under_a_drag_does_not_turn_the_goal(visit: Callable[..., Page]) -> None:
    page = visit(size={"width": 800, "height": 600})
    page.click("#follow")
    press, end = on_screen(page, 1.6, 0.2), on_screen(page, 1.6, 1.0)
    page.mouse.move(*press)
    page.mouse.down()
    page.evaluate("document.querySelector('header').style.paddingTop = '90px'")
    page.mouse.move(*end, steps=4)
    page.mouse.up()
    page.wait_for_selector("#answer .verdict")
    assert float(page.input_value("#gx")) == pytest.approx(1.6, abs=0.1)
    assert float(page.input_value("#gyaw")) == pytest.approx(90.0, abs=12.0)


def test_a_goal_by_touch_on_a_phone(visit: Callable[..., Page], robot: Robot) -> None:
    page = visit(size=PHONE, has_touch=True, is_mobile=True)
    page.touchscreen.tap(*on_screen(page, 1.6, 0.2))
    page.locator("#go").tap()
    soon(page, lambda: bool(robot.goals))
    assert (robot.goals[0].x, robot.goals[0].y) == pytest.approx((1.6, 0.2), abs=0.15)
    assert not robot.goals[0].has_yaw
    soon(
        page, lambda: robot.state == "reached"
    )  # the goal is answered: nothing repeats it into the next test
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    small = page.evaluate(
        "[...document.querySelectorAll('button, select, input, summary')].filter(x => x.offsetParent && "
        "(x.getBoundingClientRect().height < 43.5 || x.getBoundingClientRect().width < 43.5)).map(x => x.id "
        "|| x.textContent)"
    )
    assert small == []


def test_a_place_where_no_route_leads_is_not_offered(visit: Callable[..., Page], robot: Robot) -> None:
    page = visit()
    page.fill("#gx", "5.1")
    page.fill("#gy", "1")
    page.click("#ask")
    until(page, "document.querySelector('#answer').textContent.includes('no route to the goal')")
    assert page.is_hidden("#go")
    page.fill("#gx", "99")
    page.click("#ask")
    until(page, "document.querySelector('#answer').textContent.includes('outside the allowed area')")
    assert robot.goals == []


def test_everything_by_keyboard_alone(visit: Callable[..., Page], robot: Robot) -> None:
    page = visit()
    page.focus("#gx")
    page.keyboard.type("1.5")
    page.keyboard.press("Tab")
    page.keyboard.type("0 ")  # a space is typed here, and stops nothing
    page.keyboard.press("Enter")
    page.wait_for_selector("#go:not([hidden])")
    assert robot.stops == 0
    page.focus("#go")
    page.keyboard.press("Enter")
    soon(page, lambda: bool(robot.goals))
    page.focus("nav [data-view=why]")
    page.keyboard.press("Enter")
    assert page.is_visible("#why")
    page.keyboard.press("Space")  # on a button that has the focus
    soon(page, lambda: bool(robot.cause))
    until(page, "document.querySelector('#stop-said').textContent.includes('confirmed by')")
    assert page.get_attribute("#live", "aria-live") == "assertive"
    until(page, "document.querySelector('#live').textContent.includes('Emergency stop')")


def test_why_names_what_is_worst(visit: Callable[..., Page]) -> None:
    page = visit()
    page.fill("#gx", "3")
    page.fill("#gy", "0")
    page.click("#ask")
    page.wait_for_selector("#go:not([hidden])")
    page.click("nav [data-view=why]")
    assert page.locator("#steps tbody tr").count() == 5
    assert page.inner_text("#steps tr.worst td:nth-child(4)") == "0.60"
    page.click("#steps tbody tr:nth-child(3) button")
    words = page.inner_text("#step")
    assert "Front to back\n12 cm" in words
    assert "Left to right\n6°" in words
    assert "The native cost alone would have gone 3.1 m" in page.inner_text("#why-sum")
    assert "all of it was seen" in page.inner_text("#why-sum")
    assert page.evaluate("consoleView.world.chosen") == 2


# --- help ---------------------------------------------------------------------------------------------------


def test_help_opens_the_page_of_each_view_and_of_a_refusal_from_this_computer(
    visit: Callable[..., Page], console: Console
) -> None:
    page = visit()
    asked: list[str] = []
    page.context.on("request", lambda request: asked.append(request.url))
    page.fill("#gx", "5.1")
    page.fill("#gy", "1")
    page.click("#ask")
    page.wait_for_selector("#answer a")
    links = [page.evaluate("document.querySelector('#answer a').href")]
    for view in VIEWS:
        page.click(f"nav [data-view={view}]")
        links.append(page.evaluate("document.querySelector('#help').href"))
    assert "/docs/" not in "".join(asked), "loaded before anybody asked for it"
    with page.context.expect_page() as opened:
        page.click("#help")
    manual = opened.value
    for link in links:
        manual.goto(link)
        assert manual.locator("h1").count() == 1
        if "#" in link:
            assert manual.locator(f"[id='{link.partition('#')[2]}']").count() == 1, link
    images = "[...document.images].every(i => i.complete && i.naturalWidth > 0)"
    until(manual, images)
    assert manual.locator("main table").count() > 0
    assert manual.evaluate("document.documentElement.scrollWidth <= innerWidth")
    refused = page.context.request.get(links[0].partition("/operate")[0] + "/reference/configuration.md")
    assert refused.status == 404
    assert "on the site only" in refused.text()
    base = console.address().partition("/enter")[0]
    assert [
        url for url in asked if not url.startswith((base, base.replace("http", "ws"), "data:", "blob:"))
    ] == []


# --- what people can see and reach -----------------------------------------------------------------------------

SIZES = {"desk": (1440, 900), "tablet": (1024, 768), "phone": (390, 844)}
VIEWS = ("drive", "missions", "why", "events", "health", "logs", "maps")
PICTURES = os.environ.get("RBTRG_PICTURES", "")
"""Folder where the views are kept as pictures, drawn as on a desk with a graphics card."""
ON_TOP = """name => { const at = document.querySelector(name), box = at.getBoundingClientRect();
    return [[.5, .5], [.1, .5], [.9, .5], [.5, .1], [.5, .9]].every(([a, b]) =>
        at.contains(document.elementFromPoint(box.x + a * box.width, box.y + b * box.height))); }"""
"""Whether nothing covers an element."""
CUT = """() => [...document.querySelectorAll('.scroll')]
    .filter(x => x.scrollWidth > x.clientWidth + 1).map(x => x.ariaLabel)"""
NARROW = """() => [...document.querySelectorAll('nav, nav > *')]
    .filter(x => x.scrollWidth > x.clientWidth).map(x => x.textContent)"""
"""Views whose names are cut."""
UNDER = """() => [...document.querySelectorAll('#measure, #legend, #hint')].filter(x => x.offsetHeight).filter(x => {
    const box = x.getBoundingClientRect(), at = document.elementsFromPoint(box.x + 3, box.bottom - 3);
    return at[0]?.closest('#verdict, .panels, #stopbar'); }).map(x => x.id)"""
"""What is written over the ground and lies under something."""
CONTRAST = """async () => {
    const { THEMES } = await import('/page/view/palette.js');
    const light = ([r, g, b]) => [r, g, b].map(v => v / 255)
        .map(v => v <= .03928 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4)
        .reduce((sum, v, k) => sum + v * [.2126, .7152, .0722][k], 0);
    const contrast = (a, b) => (Math.max(light(a), light(b)) + .05) / (Math.min(light(a), light(b)) + .05);
    const lines = ['route', 'preview', 'goal', 'home', 'worst', 'step', 'allowed', 'drawn'];
    const { ramp, shade, grid } = THEMES.light;
    return [...Object.values(THEMES).flatMap(theme => lines.map(name => contrast(theme[name], theme.casing))),
        ...ramp.map(ground => contrast(ground.map(v => v * shade[0]), grid[0]))];
}"""
"""Of every line to its casing, and of the grid to the darkest ground in sunlight."""


def full_status() -> bytes:
    """What the supervisor says of a whole stack."""
    row = {"state": "ready", "restarts": 12, "cpu": 123.0, "memory_mb": 1024.0, "heartbeat_age": 0.44}
    processes = [{"process": process.name, **row} for process in PROCESSES]
    topics = [
        {"topic": topic.name, "rate": topic.rate, "nominal": topic.rate, "age": 0.04, "ok": True}
        for topic in t.TOPICS
    ]
    robot = {
        "mode": "ready",
        "estop": False,
        "hold": "",
        "cause": "standing",
        "speed": 0.0,
        "realtime_factor": 1.0,
    }
    robot |= {"x": 0.0, "y": 0.0, "yaw": 0.0, "pose_age": 0.1}
    return json.dumps({"processes": processes, "topics": topics, "robot": robot}).encode()


def keep_picture(page: Page, name: str) -> None:
    """One view for the manual, in few colours: a picture of it takes 90 kB."""
    if not PICTURES:
        return
    drawn = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    few = drawn.quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=4, dither=Image.Dither.NONE)
    few.save(Path(PICTURES) / f"console_{name}.png", optimize=True)


@pytest.mark.parametrize("size", ["desk", "phone", pytest.param("tablet", marks=pytest.mark.campaign)])
def test_every_view_is_whole_and_can_be_read_and_reached(
    visit: Callable[..., Page], robot: Robot, console: Console, size: str
) -> None:
    kept = Path(console.config.log_dir).parent
    run = kept / "20260102-000000_a_scene_with_a_name_1234567"
    if not run.exists():
        write_run(run)
    files = {
        kept / "missions" / "evening_round.yaml": ROUND.encode(),
        kept / "maps" / "hall.npz": bytes(700_000),
    }
    for file, content in files.items():
        file.parent.mkdir(exist_ok=True)
        file.write_bytes(content)
    robot.status = full_status()
    with robot.lock:
        robot.events.happened(
            "process", "planner ended (signal SIGKILL); restarting in 0.5 s", msg.Event.ERROR
        )
        robot.events.happened(
            "touch", "touched something that no LiDAR sees", msg.Event.WARNING, at=(2.0, 1.0)
        )
    width, height = SIZES[size]
    phone: dict[str, Any] = {"has_touch": True, "is_mobile": True} if size == "phone" else {}
    page = visit(size={"width": width, "height": height}, flat=not PICTURES, **phone)
    page.evaluate(Axe().axe_script)
    page.fill("#gx", "4.3")
    page.fill("#gy", "0.5")
    page.click("#ask")
    page.wait_for_selector("#go:not([hidden])")
    for name in ("#go", "#answer .verdict", "#halt"):
        assert page.evaluate(ON_TOP, name), name
    go, halt, stick = (page.locator(name).bounding_box() for name in ("#go", "#halt", "#stick"))
    assert go is not None
    assert halt is not None
    assert stick is not None
    assert go["y"] + go["height"] <= halt["y"]
    if size == "desk":
        assert stick["y"] + stick["height"] < halt["y"], "hands are below the fold"
    if size == "phone":
        assert go["y"] > 0.6 * height, "no thumb reaches Go"
    for view in VIEWS:
        page.click(f"nav [data-view={view}]")
        if view == "health":
            until(page, "document.querySelectorAll('#processes tbody tr').length > 5")
        if view == "logs":
            page.locator("#runs button", has_text="Look").first.click()
            page.wait_for_selector("#run-card:not([hidden])")
            page.click("#photos summary")
            until(page, "document.querySelector('#photo-list img')?.naturalWidth === 320")
            assert page.locator("#photo-list li").count() == 2
        if view == "missions":
            page.locator("#mission-files button").click()
            page.wait_for_selector("#file-card:not([hidden])")
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.evaluate(CUT) == [], view
        assert page.evaluate(NARROW) == [], view
        assert page.evaluate(UNDER) == [], view
        assert page.evaluate(ON_TOP, "#halt"), view
        found = page.evaluate("axe.run({ exclude: ['#view'] })")["violations"]
        assert [(x["id"], [node["target"] for node in x["nodes"]]) for x in found] == [], view
        if PICTURES:
            until(page, "document.body.dataset.fresh === 'live'")
        keep_picture(page, f"{view}_{size}")
    assert min(page.evaluate(CONTRAST)) >= 7.0
    for file in files:
        file.unlink()  # other tests have their own
    page.click("nav [data-view=health]")
    page.goto(page.evaluate("document.querySelector('#help').href"))
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    keep_picture(page, f"help_{size}")


# --- stop ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("how", ["press", "Escape", "observer"])
def test_stop(visit: Callable[..., Page], robot: Robot, how: str) -> None:
    page = visit("observer" if how == "observer" else "operator")
    for view in VIEWS:
        page.click(f"nav [data-view={view}]")
        box = page.locator("#halt").bounding_box()
        assert box is not None
        assert box["height"] >= 72
        assert box["width"] >= 72
    if how == "Escape":
        page.keyboard.press("Escape")
    else:
        page.hover("#halt")
        page.mouse.down()  # the finger is still on it
    soon(page, lambda: bool(robot.cause))
    until(page, "document.querySelector('#stop-said').textContent.includes('confirmed by')")


def test_a_stop_is_told_once_released_here_and_the_goal_goes_on(
    visit: Callable[..., Page], robot: Robot
) -> None:
    page = visit()
    page.fill("#gx", "4.5")
    page.fill("#gy", "0.5")
    page.click("#ask")
    page.click("#go")
    until(page, "document.body.dataset.state === 'go'")
    robot.pace = 0.0
    page.keyboard.press("Escape")
    until(page, "document.querySelector('#said').textContent === 'Stopped'")
    seen = page.evaluate("[...document.body.children].map(x => x.matches('.hide') ? '' : x.innerText).join()")
    assert seen.count("console") == 1  # who stopped it is told once
    assert "rbtrg-robot" not in seen
    assert page.evaluate("getComputedStyle(document.body, '::after').borderTopColor") == "rgb(192, 24, 24)"
    page.click("#act-resume")
    until(page, "document.body.dataset.state === 'calm' && !document.querySelector('#stop-said').textContent")
    assert page.inner_text("#why-still") == "The goal to x 4.5 y 0.5 m was stopped."
    page.click("#act-continue")
    soon(page, lambda: len(robot.goals) == 2)
    assert (robot.goals[1].x, robot.goals[1].y, robot.goals[1].has_yaw) == (4.5, 0.5, False)
    page.click("nav [data-view=events]")
    until(page, "/^\\S+ goal/.test(document.querySelector('#event-list li')?.innerText)")
    said = page.locator("#event-list li").all_inner_texts()[:4]
    assert [words.split(" ", 1)[1].split(" ", 1)[0] for words in said] == [
        "goal",
        "e-stop",
        "goal",
        "e-stop:",
    ]
    page.click("#event-list li:nth-child(4) button")  # where it was stopped
    assert page.evaluate("consoleView.world.mark.x") == pytest.approx(robot.x, abs=0.1)


def test_stop_is_repeated_and_not_called_done_until_the_robot_says_so(
    visit: Callable[..., Page], robot: Robot
) -> None:
    page = visit()
    robot.deaf = True
    robot.cause, robot.latch = "another's stop", 77  # it may be released at any moment
    until(page, "document.querySelector('#live').textContent.includes('Emergency stop')")
    page.keyboard.press("Escape")
    until(page, "document.querySelector('#stop-said').textContent.includes('NOT CONFIRMED')")
    heard = robot.stops
    soon(page, lambda: robot.stops > heard + 3)
    robot.deaf = False
    until(page, "document.querySelector('#stop-said').textContent.includes('confirmed by')")


def test_stop_with_a_frozen_feed_and_what_is_old_is_grey_and_locked(
    visit: Callable[..., Page], robot: Robot
) -> None:
    page = visit()
    picture = page.locator("#view canvas").bounding_box()
    robot.frozen = True
    until(page, "document.body.dataset.fresh === 'stale'")
    assert page.is_disabled("#ask")
    assert "grayscale" in page.evaluate("getComputedStyle(document.querySelector('#view')).filter")
    until(page, "document.querySelector('#said').textContent.startsWith('The robot is silent')")
    assert "locked" in page.inner_text("#why-still")
    assert page.locator("#view canvas").bounding_box() == picture  # a warning moves nothing under a finger
    page.focus("#stick")
    page.keyboard.down("ArrowUp")
    page.wait_for_timeout(200)
    page.keyboard.up("ArrowUp")
    assert robot.driven == []
    page.keyboard.press("Escape")
    soon(page, lambda: robot.stops > 0)
    robot.frozen = False
    until(page, "document.querySelector('#stop-said').textContent.includes('confirmed by')")
    until(page, "document.body.dataset.fresh === 'live'")


def test_stop_from_a_page_that_draws_too_slowly(visit: Callable[..., Page], robot: Robot) -> None:
    page = visit()
    page.evaluate(
        "() => { const view = consoleView, end = performance.now() + 4000; view.ground.hit = view.ground.height;"
        "const busy = () => { const t = performance.now() + 250; while (performance.now() < t); if "
        "(performance.now() < end) setTimeout(busy, 0); }; busy(); }"
    )
    page.keyboard.press("Escape")
    soon(page, lambda: bool(robot.cause))
    until(page, "document.querySelector('#stop-said').textContent.includes('confirmed by')")


def test_a_server_that_is_gone_is_seen_and_comes_back(browser: Browser, robot: Robot, tmp_path: Path) -> None:
    robot.reset()
    first = Console(robot, tmp_path, "other")
    assert first.serve is not None
    port = int(first.serve.door.host.rpartition(":")[2])
    context = browser.new_context(viewport=DESK)
    try:
        page = context.new_page()
        page.goto(first.address())
        until(page, "!!window.consoleView && document.body.dataset.fresh === 'live'")
        page.keyboard.press("Escape")  # the stop of before, released from elsewhere
        until(page, "document.querySelector('#stop-said').textContent.includes('confirmed by')")
        robot.reset()
        first.close()
        until(page, "document.body.dataset.fresh === 'stale'")
        assert page.inner_text("#said").startswith("Link lost")
        assert page.inner_text("#phase") == ""  # nobody knows
        page.keyboard.press("Escape")
        until(
            page, "document.querySelector('#stop-said').textContent.includes('the console does not answer')"
        )
        assert robot.stops == 0
        # The cookie of before still counts, and the stop goes on.
        second = Console(robot, tmp_path, "other", port=port)
        try:
            soon(page, lambda: bool(robot.cause))
            until(page, "document.querySelector('#stop-said').textContent.includes('confirmed by')")
            until(page, "document.body.dataset.fresh === 'live'")
        finally:
            second.close()
    finally:
        context.close()


BREAKABLE = """(() => {
    const Real = WebSocket;
    let last;
    window.away = false;
    window.WebSocket = function (address) { return (last = window.away ? { readyState: 0 } : new Real(address)); };
    window.breakOff = () => { window.away = true; last.close(); };
    window.comeBack = () => { window.away = false; last.onclose({ code: 1006, reason: "" }); };
})();"""
"""A page whose connection breaks and comes back when it is told to."""
STOPPED = "document.querySelector('#stop-said').textContent.includes('confirmed by')"
NOT_CONFIRMED = "document.querySelector('#stop-said').textContent.includes('NOT CONFIRMED')"


@pytest.mark.parametrize("server", ["the same", "anew"])
def test_a_page_that_comes_back_takes_no_state_of_before_for_an_answer_to_its_stop(
    visit: Callable[..., Page], robot: Robot, server: str
) -> None:
    """The stop of before was confirmed and released; the next one is pressed during a break. `anew`: the console was
    started again, counts stops from 1 and takes this one before the page's connection is back.
    """
    page = visit(wait=False)
    page.add_init_script(BREAKABLE)
    page.reload()
    until(page, "document.body.dataset.fresh === 'live'")
    page.keyboard.press("Escape")
    until(page, STOPPED)
    robot.reset()
    robot.deaf = True
    until(page, "!document.querySelector('#live').textContent.includes('Emergency stop')")
    answer = '{"state": "sending", "words": "STOP sent, waiting for the robot", "press": 1}'
    page.route(
        "**/stop",
        lambda route: route.abort() if server == "the same" else route.fulfill(status=200, body=answer),
    )
    page.evaluate("breakOff()")
    page.keyboard.press("Escape")
    until(page, NOT_CONFIRMED)
    if server == "the same":
        page.evaluate("comeBack()")
        until(page, "document.body.dataset.fresh === 'live'")
        until(page, NOT_CONFIRMED)
    page.unroute("**/stop")
    robot.deaf = False
    if server == "anew":
        page.evaluate("comeBack()")
    soon(page, lambda: bool(robot.cause))
    until(page, STOPPED)


# --- who operates -------------------------------------------------------------------------------------------


def test_two_pages_and_one_operator(visit: Callable[..., Page], robot: Robot) -> None:
    first = visit()
    until(first, "document.querySelector('#lease').textContent === 'you operate'")
    second = visit()
    theirs = (
        "document.querySelector('#lease').textContent.endsWith(' operates') && "
        "document.querySelector('#ask').disabled"
    )
    until(second, theirs)
    press = "() => { const made = document.querySelector('#take'); made.click(); return made.textContent; }"
    assert second.evaluate(press).endswith("Really take over?")
    second.evaluate(press)
    until(first, theirs)
    first.keyboard.press("Escape")  # without the lease
    soon(first, lambda: bool(robot.cause))
    second.close()
    until(first, "document.querySelector('#lease').textContent === 'you operate'")


def test_an_observer_looks_and_commands_nothing(visit: Callable[..., Page], robot: Robot) -> None:
    page = visit("observer")
    until(page, "document.querySelector('#lease').textContent.includes('observer')")
    assert page.is_disabled("#ask")
    words = page.evaluate(
        "() => new Promise(yes => { const s = new WebSocket(`ws://${location.host}/live`); s.binaryType = "
        "'arraybuffer';"
        "s.onopen = () => s.send(JSON.stringify({do: 'goal', x: 1, y: 0, n: 7}));"
        "s.onmessage = ({data}) => { const t = new TextDecoder().decode(data.slice(4)); if "
        "(t.includes('\"answer\"')) yes(t); } })"
    )
    assert "may look and stop" in words
    assert robot.goals == []


# --- by hand ------------------------------------------------------------------------------------------------


def test_the_stick_drives_while_it_is_held(visit: Callable[..., Page], robot: Robot) -> None:
    page = visit()
    page.evaluate("() => document.querySelector('#stick').scrollIntoView({ block: 'center' })")
    box = page.locator("#stick").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def hold() -> bool:
        """Press, and again where a busy machine let the picture grow old: then hands let go by themselves."""
        if "held" not in (page.get_attribute("#stick", "class") or ""):
            page.mouse.up()
            page.mouse.move(x, y)
            page.mouse.down()
            page.mouse.move(x, y - 40)
        return len(robot.driven) > 15

    soon(page, hold)
    until(page, "consoleView.world.arc && consoleView.world.arc.length === 9")
    until(page, "document.querySelector('#hand-said').textContent.includes('easy ground ahead')")
    page.mouse.up()
    soon(page, lambda: robot.driven[-1][1:] == (0.0, 0.0))
    page.wait_for_timeout(300)  # it is said twice, and may be heard once
    assert {round(v, 2) for _, v, _ in robot.driven} <= {0.0, 0.23}  # 40 of 52 px, at 0.3 of 1 m/s
    count = len(robot.driven)
    page.wait_for_timeout(300)
    assert len(robot.driven) == count


def test_a_gamepad_drives_while_its_enable_button_is_held(visit: Callable[..., Page], robot: Robot) -> None:
    page = visit()
    page.evaluate(
        """() => {
            const button = () => ({ pressed: false });
            window.pad = { connected: true, mapping: 'standard', axes: [0, -1],
                buttons: Array.from({ length: 8 }, button) };
            navigator.getGamepads = () => [window.pad];
        }"""
    )
    until(page, "document.querySelector('#pad').textContent.startsWith('Gamepad')")
    page.wait_for_timeout(150)
    assert robot.driven == []  # the stick alone drives nothing
    page.evaluate("() => { pad.buttons[4].pressed = true; }")
    soon(page, lambda: bool(robot.driven) and round(robot.driven[-1][1], 2) == 0.3)
    page.evaluate("() => { pad.buttons[5].pressed = true; }")
    soon(page, lambda: round(robot.driven[-1][1], 2) == 1.0)
    page.evaluate("() => { pad.connected = false; }")
    soon(page, lambda: robot.driven[-1][1:] == (0.0, 0.0))


@pytest.mark.parametrize("end", ["blur", "hidden", "key up", "closed"])
def test_hands_let_go(visit: Callable[..., Page], robot: Robot, end: str) -> None:
    page = visit()
    page.fill("#gx", "4.5")
    page.fill("#gy", "0")
    page.click("#ask")
    page.click("#go")
    soon(page, lambda: robot.state == "moving")

    def hold() -> bool:
        page.focus("#stick")
        page.keyboard.down("ArrowUp")
        return len(robot.driven) > 5

    soon(page, hold)
    if end == "key up":
        page.keyboard.up("ArrowUp")
    elif end == "closed":
        page.close()
    elif end == "blur":
        page.evaluate("() => window.dispatchEvent(new Event('blur'))")
    else:
        page.evaluate(
            "() => { Object.defineProperty(document, 'hidden', { value: true }); document.dispatchEvent(new "
            "Event('visibilitychange')); }"
        )
    clock = time.monotonic() + LIMIT
    while robot.driven[-1][1:] != (0.0, 0.0):
        assert time.monotonic() < clock
        robot.heard.clear()
        robot.heard.wait(0.1)
    assert robot.state == "paused"  # the goal goes on only when told to
    if end == "key up":
        until(page, "document.querySelector('#act-resume')?.textContent === 'Continue the goal'")
        page.click("#act-resume")
        soon(page, lambda: robot.state in ("moving", "reached"))


# --- missions -----------------------------------------------------------------------------------------------

ROUND = """
name: round
on_comms_loss: hold
comms_timeout: 2
steps:
  - goto: {x: 1.5, y: 0.5, yaw_deg: 90}
  - ask: {question: "Is the valve open?", choices: [yes, no]}
  - goto: {x: 2.5, y: -0.5}
  - wait: 1000
"""


def test_a_mission_is_seen_run_answered_and_ended_on_a_phone(
    visit: Callable[..., Page], robot: Robot, console: Console
) -> None:
    folder = Path(console.config.log_dir).parent / "missions"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "round.yaml").write_text(ROUND)
    (folder / "broken.yaml").write_text("steps: [fly]")
    page = visit(size=PHONE, flat=not PICTURES, has_touch=True, is_mobile=True)
    page.click("nav [data-view=missions]")
    until(page, "document.querySelectorAll('#mission-files tbody tr').length === 2")
    assert "broken.yaml: step 1" in page.inner_text("#mission-files tbody tr:nth-child(1)")
    page.click("#mission-files tbody tr:nth-child(2) button")
    until(page, "consoleView.world.mission && consoleView.world.mission.steps.length === 4")
    assert "stands without an operator in contact for 2 s" in page.inner_text("#file-facts")
    assert "goto 1.50 0.50 yaw 90 deg" in page.inner_text("#file-steps")
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    robot.pace = 0.0  # however long the page takes, it is not there before the pause
    page.click("#file-run")
    until(page, "document.querySelector('#mission-said').textContent.includes('step 1 of 4 (goto-1)')")
    soon(page, lambda: robot.state == "moving")  # the step begins with the robot's next word
    page.click("[data-mission=pause]")
    until(page, "document.querySelector('#mission-said').textContent.includes('paused')")
    soon(page, lambda: robot.state == "cancelled")
    robot.pace = PACE_LENGTH
    page.click("#act-goon")
    page.click("nav [data-view=drive]")
    until(page, "document.querySelector('#why-still').textContent === 'Is the valve open?'")
    assert (robot.x, robot.y) == pytest.approx((1.5, 0.5), abs=0.15)
    assert page.locator("nav .asks").inner_text() == "Missions"
    page.click("#act-answer")
    page.wait_for_selector("#choices button:nth-child(2)")
    assert page.evaluate(ON_TOP, "#choices"), "the answers are below the fold"
    keep_picture(page, "asks_phone")
    page.click("#choices button:nth-child(1)")
    until(page, "document.querySelector('#mission-steps').textContent.includes(\"answered 'yes'\")")
    page.click("[data-mission=skip]")
    until(page, "document.querySelector('#mission-said').textContent.includes('step 4 of 4')")
    assert robot.present > 0  # the page is the operator's presence: the mission does not hold
    page.click("[data-mission=stop]")
    page.click("[data-mission=stop]")
    until(page, "document.querySelector('#mission-said').textContent.includes('stopped by')")
    assert page.is_hidden("#mission-acts")


def test_steps_of_a_mission_are_moved_by_hand_and_saved(
    visit: Callable[..., Page], robot: Robot, console: Console
) -> None:
    folder = Path(console.config.log_dir).parent / "missions"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "moves.yaml").write_text(
        "steps: [{goto: {x: 1, y: 0.4, yaw_deg: 90}}, stand, {goto: {x: 2, y: -0.5}}]"
    )
    page = visit()
    page.click("nav [data-view=missions]")
    page.locator("#mission-files tr", has_text="moves.yaml").locator("button").click()
    page.wait_for_selector("#file-card:not([hidden])")
    assert page.inner_text("#file-facts").startswith("without an operator in contact it does what")
    assert page.is_hidden("#file-form")

    def drag(start: tuple[float, float], end: tuple[float, float]) -> None:
        page.mouse.move(*on_screen(page, *start))
        page.mouse.down()
        page.mouse.move(*on_screen(page, *end), steps=4)
        page.mouse.up()

    drag((1.0, 0.4), (1.4, 0.9))
    drag((2.0, -0.5), (2.3, 0.2))
    assert page.inner_text("#file-moved").startswith("2 moved")
    assert not page.evaluate("consoleView.world.goal"), "a step is moved, and no goal is meant"
    page.keyboard.press("Control+z")
    assert page.inner_text("#file-moved").startswith("1 moved")
    assert page.evaluate("consoleView.world.mission.steps[2].x") == 2.0
    page.fill("#file-as", "moves")
    page.click("#file-form [type=submit]")
    until(
        page,
        "document.querySelector('#file-moved').textContent === 'Not saved: moves.yaml exists; choose another name'",
    )
    page.click("#file-run")
    soon(page, lambda: bool(robot.goals))
    assert (robot.goals[0].x, robot.goals[0].y) == pytest.approx((1.4, 0.9), abs=0.1)
    assert robot.goals[0].yaw == pytest.approx(math.pi / 2)
    page.locator("#mission-files tr", has_text="moves.yaml").locator("button").click()
    page.wait_for_selector("#file-card:not([hidden])")
    drag((2.0, -0.5), (2.4, -0.6))
    page.click("#file-form [type=submit]")
    until(page, "document.querySelector('#file-moved').textContent.startsWith('saved as ')")
    saved = yaml.safe_load((folder / "moves-moved.yaml").read_text())["steps"]
    assert saved[0] == {"goto": {"x": 1.0, "y": 0.4, "yaw_deg": 90.0}}
    assert (saved[2]["goto"]["x"], saved[2]["goto"]["y"]) == pytest.approx((2.4, -0.6), abs=0.1)


def test_a_page_that_nobody_looks_at_is_no_contact(visit: Callable[..., Page], robot: Robot) -> None:
    page = visit()
    soon(page, lambda: robot.present > 1)
    page.evaluate("() => Object.defineProperty(document, 'hidden', { value: true })")
    until(page, "document.querySelector('#lease').textContent === 'you operate'")
    page.wait_for_timeout(600)  # one that was under way
    before = robot.present
    page.wait_for_timeout(1500)
    assert robot.present == before


# --- drawn on the ground ----------------------------------------------------------------------------------------


def test_places_that_are_drawn_are_driven_and_an_area_is_saved_and_explored(
    visit: Callable[..., Page], robot: Robot, console: Console
) -> None:
    page = visit()
    assert page.evaluate("consoleView.world.fence[0].corners.length") >= 3
    page.click("#follow")
    page.click("#draw summary")
    page.click("#draw-way")
    assert page.is_disabled("#draw-go")
    for x, y in ((1.0, 0.4), (1.5, -0.6)):
        page.mouse.click(*on_screen(page, x, y))
    page.mouse.move(*on_screen(page, 1.6, 0.2))
    page.mouse.down()
    page.mouse.move(*on_screen(page, 1.6, 1.0), steps=4)
    page.mouse.up()
    assert page.inner_text("#draw-hint") == "3 places"
    page.keyboard.press("Control+z")
    page.click("#draw-undo")
    assert page.inner_text("#draw-hint") == "1 place"
    page.mouse.click(*on_screen(page, 1.5, -0.6))
    assert robot.goals == []
    page.click("#draw-go")
    soon(page, lambda: len(robot.goals) == 2)
    places = [(goal.x, goal.y) for goal in robot.goals]
    assert places == [pytest.approx((1.0, 0.4), abs=0.1), pytest.approx((1.5, -0.6), abs=0.1)]
    assert page.evaluate("consoleView.world.drawn") is None
    soon(page, lambda: robot.state == "reached")
    page.click("#follow")  # what was sent off is followed again
    page.click("#draw-area")
    for x, y in ((0.5, -0.5), (2.5, -0.5), (2.5, 1.0)):
        page.mouse.click(*on_screen(page, x, y))
    page.fill("#area-name", "ramp")
    page.click("#area-save")
    until(page, "document.querySelector('#draw-said').textContent.includes('3 corners in')")
    saved = Path(console.config.log_dir).parent / "areas" / "ramp.yaml"
    corners = yaml.safe_load(saved.read_text())
    assert [tuple(corner) for corner in corners] == [
        pytest.approx(corner, abs=0.1) for corner in ((0.5, -0.5), (2.5, -0.5), (2.5, 1.0))
    ]
    page.click("#area-out")
    until(page, "consoleView.world.fence.at(-1).keep_out")
    until(page, "document.querySelector('#draw-hint').textContent.includes('Tap its corners')")
    page.click("#draw-way")
    page.mouse.click(*on_screen(page, 2.2, -0.2))
    assert "inside of the keep-out area ramp" in page.inner_text("#draw-said")
    page.click("#draw-area")
    for x, y in ((-0.5, -1.0), (3.0, -1.0), (3.0, 1.5), (-0.5, 1.5)):
        page.mouse.click(*on_screen(page, x, y))
    page.click("#area-in")
    until(page, "consoleView.world.fence.length === 3 && !consoleView.world.fence.at(-1).keep_out")
    page.click("#fence-undo")
    until(page, "consoleView.world.fence.length === 2")
    page.click("#fence-list button")
    until(page, "consoleView.world.fence.length === 1")
    page.click("#fence-undo")
    until(page, "consoleView.world.fence.at(-1).name === 'ramp'")
    for step in ("explore", "cover"):
        page.click("#area-list button")
        page.click(f"#draw-{step}")
        until(page, f"consoleView.world.mission?.steps[0].step === '{step}'")
        robot.reset()  # the next mission is not refused for this one


# --- maps ---------------------------------------------------------------------------------------------------


def test_a_map_is_saved_and_loaded_and_the_robot_is_told_where_it_stands(
    visit: Callable[..., Page], robot: Robot
) -> None:
    page = visit()
    page.click("nav [data-view=maps]")
    page.fill("#map-name", "here")
    page.click("#save-map button")
    until(page, "document.querySelector('#map-said').textContent.includes('known cells in here.npz')")
    load = "#map-list tbody tr:first-child button"
    page.click(load)
    assert page.inner_text(load).endswith("Really load it?")
    page.click(load)
    # The first map that is read compiles kernels where nobody has before: half a minute on a busy machine.
    until(page, "document.querySelector('#map-said').textContent.includes('the map was loaded')", JOB)
    assert robot.prior.startswith("sha256:")
    robot.alike = [1.0, 0.5, 0.0, -1.5, 2.0, math.pi / 2]  # the places that look alike are offered
    until(page, "consoleView.world.candidates?.length === 2")
    assert page.inner_text("#location") == "ambiguous in here.npz"
    page.click("#candidates button:nth-child(2)")
    assert [page.input_value(f"#{name}") for name in ("px", "py", "pyaw")] == ["-1.50", "2.00", "90"]
    page.click("#place-set")
    until(page, "consoleView.world.candidates.length === 0 && Math.abs(consoleView.world.pose.y - 2) < 0.1")
    page.click("#place-mode")
    page.mouse.move(*on_screen(page, 2.0, 0.6))
    page.mouse.down()
    page.mouse.move(*on_screen(page, 2.0, 1.4), steps=4)
    page.mouse.up()
    until(page, "consoleView.world.place")
    assert float(page.input_value("#pyaw")) == pytest.approx(90.0, abs=12.0)
    assert page.is_hidden("#drive")  # no goal
    page.fill("#pyaw", "90")
    page.click("#place-set")
    until(page, "document.querySelector('#place-said').textContent.includes('stands there now')")
    until(
        page,
        "Math.abs(consoleView.world.pose.x - 2) < 0.1 && Math.abs(consoleView.world.pose.yaw - Math.PI / 2) < 0.05",
    )
    robot.state, robot.goal = "moving", msg.GoalRequest(id="g", x=4.0)
    until(page, "consoleView.world.goal")
    page.click("#place-set")
    until(
        page,
        "document.querySelector('#place-said').textContent.includes('while the robot stands and has no goal')",
    )


# --- logs ---------------------------------------------------------------------------------------------------


def write_run(folder: Path) -> None:
    """Ten seconds of a robot that stands elsewhere, stopped."""
    folder.mkdir(parents=True)
    stack = load(None, [], scene="flat")
    config, camera = stack.to_yaml(), stack.camera.mounted()
    assert camera is not None
    (folder / "config.yaml").write_text(config)
    still = (0.0, 0.0, 0.0, 1.0)
    frames = msg.TFMessage(transforms=[transform_msg(1, "map", "odom", np.zeros(3), still)])
    with LogWriter(folder / "log_0.mcap", {}, {CONFIG: config.encode()}) as log:
        for k in range(100):
            now = (k + 1) * 10**8
            said: list[tuple[t.Topic, Any]] = [
                (t.CLOCK, msg.Clock(clock=header(now, "").stamp)),
                (t.ODOM, odometry_msg(now, (3.3, 0.4, 0.45), still, (0.0,) * 3, np.zeros(3))),
                (t.ROBOT_STATE, msg.RobotState(header=header(now, ""), phase="stopped", estop=True)),
            ]
            if k == 0:
                said += [(t.TF_STATIC, frames), (t.MAP_STATUS, msg.MapStatus(epoch=1))]
            if k % 10 == 1:
                said.append((t.MAP_UPDATE, patch_msg(ground())))
            if k % 50 == 7:
                said.append((t.PHOTO, image_msg(camera, CameraFrame(now, grey()))))
            for topic, message in said:
                log.write(topic, encode(message), now, now, k + 1)


@pytest.mark.campaign
def test_a_run_is_replayed_beside_the_robot_and_run_again(
    visit: Callable[..., Page], robot: Robot, console: Console
) -> None:
    write_run(Path(console.config.log_dir).parent / "20260101-000000_flat_1")
    page = visit()
    page.click("nav [data-view=logs]")
    page.click("#runs tbody tr:first-child button")
    page.wait_for_selector("#run-card:not([hidden])")
    page.click("#replay-form button")
    until(page, "consoleView.world.pose && Math.abs(consoleView.world.pose.x - 3.3) < 0.01")
    until(page, "consoleView.ground.tiles.size > 10")
    assert page.is_visible("#replaybar")
    assert page.inner_text("#lease") == "replay"
    assert page.inner_text("#hint") == "A replay takes no goals."
    assert page.is_disabled("#ask")
    assert page.inner_text("#live") == ""  # the stop of the log is not the robot's
    robot.deaf = True
    page.keyboard.press("Escape")
    soon(page, lambda: robot.stops > 3)
    until(page, "document.querySelector('#stop-said').textContent.includes('NOT CONFIRMED')")
    robot.deaf = False
    until(page, "document.querySelector('#stop-said').textContent.includes('confirmed by')")
    page.click("#replay-pause")
    until(page, "document.querySelector('#replay-said').textContent.includes('paused at')")
    assert page.inner_text("#replay-pause") == "Go on"
    page.click("#replay-pause")
    until(page, "document.querySelector('#replay-pause').textContent === 'Pause'")
    until(page, "!document.querySelector('#replay-said').textContent.includes('paused')")
    robot.present = 0
    page.click("#replay-end")
    until(page, "consoleView.world.pose && Math.abs(consoleView.world.pose.x) < 0.01")
    until(page, "document.querySelector('#lease').textContent === 'you operate'")
    assert page.is_hidden("#replaybar")
    page.click("#again summary")
    page.fill("#again-stages", "mission")
    page.fill("#again-sets", "navigator.nonsense=1")
    page.click("#again-go")
    until(page, "document.querySelector('#job').textContent.includes('there is no configuration key')", JOB)
    page.fill("#again-sets", "navigator.goal_tolerance=0.3")
    page.click("#again-go")
    until(page, "document.querySelector('#job').textContent.includes('_again1: ')", JOB)
    assert "poses at most 0.000 m apart" in page.inner_text("#job")
    until(page, "document.querySelector('#runs').textContent.includes('_again1')")


# --- the picture --------------------------------------------------------------------------------------------


def test_a_lost_context_comes_back(visit: Callable[..., Page]) -> None:
    page = visit(flat=False)
    assert page.evaluate("consoleView.kind") == "3D"
    page.evaluate(
        "() => { const gl = document.querySelector('#view canvas').getContext('webgl2'); window.lost = "
        "gl.getExtension('WEBGL_lose_context'); lost.loseContext(); }"
    )
    until(page, "document.querySelector('#hint').textContent.includes('made again')")
    page.evaluate("() => lost.restoreContext()")
    until(page, "document.querySelector('#hint').textContent.includes('Tap the ground')")
    until(page, SEEN)


SEEN = """(() => {
  consoleView.show();
  const canvas = document.querySelector('#view canvas'), copy = document.createElement('canvas');
  copy.width = 80; copy.height = 50;
  const context = copy.getContext('2d');
  return new Promise(yes => requestAnimationFrame(() => {  // right behind the one that draws
    context.drawImage(canvas, 0, 0, 80, 50);
    yes(new Set(new Uint32Array(context.getImageData(0, 0, 80, 50).data.buffer)).size > 60);
  }));
})()"""
"""Many colours: terrain is drawn, and not one colour."""


@pytest.mark.campaign
def test_a_context_that_stays_lost_and_a_browser_without_webgl_show_the_ground_from_above(
    visit: Callable[..., Page], robot: Robot
) -> None:
    page = visit(flat=False)
    page.evaluate(
        "() => document.querySelector('#view "
        "canvas').getContext('webgl2').getExtension('WEBGL_lose_context').loseContext()"
    )
    until(page, "consoleView.kind === '2D'")
    page.close()
    page = visit()
    until(page, "document.querySelector('#lease').textContent === 'you operate'")
    assert page.evaluate("consoleView.kind") == "2D"
    until(page, SEEN)
    box = page.locator("#view canvas").bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + box["width"] / 2 + 60, box["y"] + box["height"] / 2)
    page.wait_for_selector("#go:not([hidden])")
    assert float(page.input_value("#gx")) > 0.3
    assert abs(float(page.input_value("#gy"))) < 0.05


def test_the_ground_tells_its_age_where_it_is_asked_for(visit: Callable[..., Page], robot: Robot) -> None:
    page = visit(flat=False)
    assert np.isnan(page.evaluate("consoleView.ground.cell(1, 0).age"))
    page.select_option("#layer", label="Age")
    until(page, "consoleView.ground.cell(1, 0).age < 100")
    assert "grey: not known when" in page.inner_text("#legend")
    page.select_option("#layer", label="Trust")
    assert "orange: assumed, nobody saw it" in page.inner_text("#legend")
    until(page, SEEN)


def test_the_body_on_the_arc_is_scored_as_the_planner_scores_it(visit: Callable[..., Page]) -> None:
    from planning.risk.body import BodyModel, pose_features

    page = visit()
    poses = np.array([[1.0, 0.0, 0.0], [2.1, 0.3, 0.2], [3.0, 0.9, 1.0], [4.0, -1.0, 0.5], [1.0, -2.1, 0.7]])
    body = BodyModel()
    features = pose_features(ground().grid(filled=True), poses, body)
    want = np.minimum(features / body.scales, 3.0)[:, :3].sum(axis=1)
    got = page.evaluate("poses => poses.map(p => consoleView.ground.body(...p, 0.7, 0.43))", poses.tolist())
    assert got == pytest.approx(want.tolist(), abs=0.06)
    assert want.max() > 0.3


PIXEL = """([x, y]) => [...document.querySelector('#video-picture').getContext('2d').getImageData(x, y, 1, 1).data]"""


@pytest.mark.parametrize("size", [DESK, pytest.param(PHONE, marks=pytest.mark.campaign)])
def test_the_camera_is_shown_with_the_route_in_it_and_kept_as_a_photo(
    visit: Callable[..., Page], robot: Robot, size: Any
) -> None:
    page = visit(size=size)
    page.wait_for_timeout(100)
    assert robot.filmed == 0, "nobody looks"
    page.keyboard.press("v")
    page.wait_for_selector("#video:not([hidden])")
    soon(page, lambda: robot.filmed > 0)
    until(page, "document.querySelector('#video-said').textContent.includes('ms old')")
    assert page.evaluate(PIXEL, [10, 10])[:3] == pytest.approx([90, 90, 90], abs=4)
    age = float(page.inner_text("#video-said").split(" ms")[0])
    assert 0.0 <= age < 1000.0 * LIMIT
    robot.bus.publish(t.ROUTE_REPORT, ahead(), 1)
    # Straight ahead the route runs up the middle of the picture, to below its horizon.
    until(page, f"({PIXEL})([160, 180])[2] > 150")
    with page.expect_download() as kept:
        page.click("#photo")
    assert kept.value.suggested_filename.endswith(".jpg")
    assert Path(kept.value.path()).read_bytes().startswith(b"\xff\xd8")
    soon(page, lambda: robot.photos > 0)
    page.keyboard.press("v")
    until(page, "document.body.dataset.video === 'behind'")
    for name in ("#halt", "#video-mode"):  # nothing lies over them
        assert page.evaluate(
            "name => { const at = document.querySelector(name); at.scrollIntoView({ inline: 'center' });"
            " const box = at.getBoundingClientRect();"
            " return at.contains(document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2)); }",
            name,
        )
    page.keyboard.press("v")
    page.wait_for_selector("#video", state="hidden")
    before = robot.filmed
    page.wait_for_timeout(1500)
    assert robot.filmed <= before + 1, "nobody looks any more"


def test_a_way_that_is_likely_to_fail_is_gone_only_when_that_was_accepted_twice(
    visit: Callable[..., Page], robot: Robot
) -> None:
    page = visit()
    page.fill("#gx", "4.8")
    page.fill("#gy", "0")
    page.click("#ask")
    page.wait_for_selector("#accept:not([hidden])")
    assert page.is_hidden("#go")
    answer = page.inner_text("#answer")
    assert "It may well fail" in answer
    assert "70 % to arrive; worst: up a 0.16 m face at x 2.0 y 0.0" in answer
    page.click("#accept")
    assert page.inner_text("#accept") == "It may fall. Really?"
    assert robot.goals == []
    page.click("#accept")
    soon(page, lambda: bool(robot.goals))
    assert robot.goals[0].accept_risk


def ahead() -> msg.RouteReport:
    """The route that is driven: straight ahead."""
    found = report(msg.RouteQuestion(goal_x=4.0))
    found.question = False
    return found
