"""`log step`: a re-run stands between two messages, is led from the page, and tells what a stage knows at that
instant."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.hosts.offline import rerun
from rbtrg_robot.hosts.stepping import StepError, Stepper
from rbtrg_robot.log.read import read_run
from rbtrg_robot.topics import Topic
from tests.rbtrg_robot.console.pages import LIMIT, chromium, on_screen, until

STAGES = ["odometry", "elevation", "planner"]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot that has begun to drive; sweeps, no map."""
    config = load(None, ["recorder.profile=standard", "sim.lidar_step=8"], scene="flat")
    log = tmp_path_factory.mktemp("run") / "log_0.mcap"
    with Lockstep(config, Lockstep.open_log(config, log)) as stack:
        stack.wait_ready()
        stack.send_goal(2.0, 0.5)
        stack.run(1.5)
    return log


def test_a_rerun_that_is_led_does_what_one_that_runs_through_does(run: Path, tmp_path: Path) -> None:
    made: dict[Topic, list[bytes]] = {}
    config = load(None, ["sim.lidar_step=8"], scene="flat")
    stepper = Stepper(run, STAGES, config, lambda topic, data, *_: made.setdefault(topic, []).append(data))
    try:
        assert stepper.wait(60.0)
        assert (stepper.seconds, made) == (0.0, {})
        stepper.step("message")
        assert stepper.wait(LIMIT)
        assert sum(map(len, made.values())) == 1
        for _ in range(3):
            stepper.step("scan")
            assert stepper.wait(LIMIT)
        assert len(made[t.ODOM]) == 3
        stepper.seek(2.0)
        assert stepper.wait(LIMIT)
        assert 1.9 < stepper.seconds <= 2.0
        made.clear()
        stepper.seek(1.0)
        with pytest.raises(StepError, match="it runs: pause it first"):
            stepper.look("elevation")
        assert stepper.wait(60.0)
        assert 0.9 < stepper.seconds <= 1.0
        assert stepper.round == 2
        stepper.seek(math.inf)
        assert stepper.wait(60.0)
        assert stepper.ended
        assert not stepper.wrong
    finally:
        stepper.close()
    rerun(run, STAGES, tmp_path / "through.mcap")
    through = [e.data for e in read_run(tmp_path / "through.mcap") if e.topic == t.MAP_UPDATE.name]
    assert through == made[t.MAP_UPDATE]


def test_a_stage_tells_what_it_knows_and_why_not_there(run: Path) -> None:
    stepper = Stepper(run, STAGES, load(None, ["sim.lidar_step=8"], scene="flat"), lambda *_: None)
    try:
        stepper.seek(stepper.length - 0.1)
        assert stepper.wait(60.0)
        cell = dict(stepper.look("elevation", (1.5, 0.0))["place"])
        assert cell["trusted"] == "yes"
        assert cell["source"] in ("LiDAR", "bridged")
        assert abs(float(cell["elevation"].split()[0])) < 0.05
        told = stepper.look("odometry")
        assert "angular_velocity: x " in dict(told["inputs"])[t.IMU.name]
        assert "health good" in dict(told["outputs"])[t.ODOM_HEALTH.name]
        assert any("monitor" in name or "health" in name for name, _ in told["inside"])
        planner = stepper.look("planner", (1.5, 0.0))["place"]
        prices = [words for name, words in planner if name.startswith("edge to")]
        assert prices
        assert all("price" in words and "native risk" in words for words in prices)
        assert any(name.startswith("frontier") for name, _ in planner)
        assert stepper.why((2.0, 0.5), (0.0, 0.0, 0.0)).ok
        refused = stepper.why((2.0, 0.5), (30.0, 0.0, 0.0))
        assert (refused.ok, bool(refused.detail)) == (False, True)
        with pytest.raises(StepError, match="tracker is not run again here"):
            stepper.look("tracker")
    finally:
        stepper.close()


@pytest.fixture
def address(run: Path, tmp_path: Path) -> Iterator[str]:
    """Of the command, which ends with Ctrl-C and leaves nothing behind."""
    environment = {**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)}
    command = [sys.executable, "-m", "rbtrg_robot.cli", "log", "step", str(run)]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        line = child.stdout.readline()
        assert "odometry, elevation, planner; open http" in line
        yield line.partition("open ")[2].strip()
        child.send_signal(signal.SIGINT)
        assert child.wait(30.0) == 0
    assert not [path for path in tmp_path.rglob("*") if path.is_file() and "step_" in path.name]


def test_a_page_leads_it_and_asks_why_not_there(address: str) -> None:
    with chromium() as browser:
        page = browser.new_page(viewport={"width": 1000, "height": 640}, reduced_motion="reduce")
        page.goto(address)
        page.goto(
            address.partition("/enter")[0] + "/?flat"
        )  # 3D without a graphics card takes most of the time
        until(page, "document.querySelector('#lead-said')?.textContent.startsWith('0.000 s of')", 60.0)
        page.click("#lead-message")
        until(page, "document.querySelector('#lead-said').textContent.includes('after /')")
        page.fill("#lead-to", "2.5")
        page.click("#lead-form button")
        said = "document.querySelector('#lead-said').textContent"
        until(page, f"parseFloat({said}) > 2.4 && !{said}.includes('running')", 60.0)
        until(page, "document.querySelector('#lead-inside').textContent.includes('malformed')", 60.0)
        until(page, "consoleView.ground.tiles.size > 10 && document.body.dataset.fresh === 'live'")
        page.select_option("#lead-stage", "planner")
        page.click("#follow")
        page.mouse.click(*on_screen(page, 1.5, 0.0))
        until(page, "/^(A way|Not there)/.test(document.querySelector('#lead-why').textContent)", 60.0)
        assert page.inner_text("#lead-why").startswith("A way leads ")
        until(page, "document.querySelector('#lead-place').textContent.includes('price')", 60.0)
        assert page.is_hidden("#stopbar")
        assert page.evaluate("fetch('/about').then((x) => x.json()).then((x) => x.step)") == STAGES
