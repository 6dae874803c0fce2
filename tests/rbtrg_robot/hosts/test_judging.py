"""`log test`: what a file says of a run holds or does not, and every refusal tells what to write instead."""

from __future__ import annotations

import json
import math
from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np

from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.log.read import CONFIG
from rbtrg_robot.log.write import LogWriter
from rbtrg_robot.wire.convert import odometry_msg, rpy_quaternion
from rbtrg_robot.wire.messages import encode, header
from tests.rbtrg_robot.conftest import Here

START = 1_700_000_000 * NS


def run(folder: Path) -> Path:
    """10 s at 0.5 m/s that tilt by up to 20 deg; odometry is degraded for the first 0.5 s; truth is 0.1 m to the side,
    and shorter by a tenth."""
    log = folder / "run.mcap"
    config = load(None, [], scene="flat")
    with LogWriter(log, {}, {CONFIG: config.to_yaml().encode()}) as writer:
        for k in range(101):
            now = START + k * NS // 10
            tilt = math.radians(20.0) * math.sin(math.pi * k / 100)
            turned = rpy_quaternion((0.0, tilt, 0.3))
            messages = [
                (t.ODOM, odometry_msg(now, (0.05 * k, 0.0, 0.3), turned, (0.5, 0.0, 0.0), (0.0, 0.0, 0.0))),
                (
                    t.TRUTH,
                    odometry_msg(now, (0.045 * k, 0.1, 0.3), turned, (0.5, 0.0, 0.0), (0.0, 0.0, 0.0)),
                ),
                (t.ODOM_HEALTH, msg.OdometryHealth(header(now, "odom"), "degraded" if k < 5 else "good")),
            ]
            if k == 50:
                x = np.array([0.0, 1.0, 1.0, 2.0])
                y = np.array([0.0, 0.0, 1.0, 1.0])
                messages.append(
                    (t.PLAN, msg.Plan(header(now, "map"), ok=True, x=x, y=y, z=x, yaw=x, speed=x))
                )
                short = np.array([0.0, 0.2, 0.0])
                messages.append(
                    (
                        t.PLAN,
                        msg.Plan(
                            header(now, "map"), ok=True, x=short, y=short, z=short, yaw=short, speed=short
                        ),
                    )
                )
            for topic, message in messages:
                writer.write(topic, encode(message), now, now, k + 1)
    return log


def judged(here: Here, file: Path, text: str, *more: str) -> list[dict]:
    file.write_text(text)
    done = here("log", "test", str(file), "--json", *more)
    assert done.returncode in (0, 3), done.stderr
    found: list[dict] = json.loads(done.stdout)
    assert (done.returncode == 0) == all(case["holds"] for case in found)
    return found


LINES = {
    "max tilt < 20.1": "20 deg at 5.0 s",
    "max tilt < 15": False,
    "tilt <= 15 after 8 s": "11.76 deg at 8.0 s",
    "min tilt >= 0": True,
    "mean speed == 0.5": True,
    "driven > 4.99 m": "5 m",
    "rpe < 0.12": "0.1 m",
    "rpe < 0.08": False,
    "ate < 0.2": True,
    "odometry.health == good": "degraded at 0.0 s (5 of 101)",
    "odometry.health == good after 0.5 s": "good at 10.0 s",
    "last odometry.health == good": True,
    "odometry.health != lost": True,
    "no plan longer than 1.35 x": "1.342 x at 5.0 s",
    "no plan longer than 1.3 x": "1.342 x at 5.0 s",
    "no plan longer than 3 m": True,
    "count plan == 2": True,
    "count /plan < 2": False,
    "plan.ok == true": True,
    "max plan.speed <= 2": True,
    "/odom.pose.pose.position.z == 0.3": True,
    "robot.estop == false": "nothing to judge: no value on /robot/state",
    "max goal.p_fail < 1": "nothing to judge: no value on /goal/status",
}


def test_each_line_is_judged_and_junit_tells_the_same(here: Here, tmp_path: Path) -> None:
    log = run(tmp_path)
    lines = "".join(f"  - {json.dumps(line)}\n" for line in LINES)
    xml = tmp_path / "out.xml"
    [case] = judged(here, tmp_path / "t.yaml", f"run: {log.name}\nassert:\n{lines}", "--junit", str(xml))
    verdicts = {one["text"]: one for one in case["verdicts"]}
    fails = {
        "odometry.health == good",
        "no plan longer than 1.3 x",
        "robot.estop == false",
        "max goal.p_fail < 1",
    }
    for line, expected in LINES.items():
        assert verdicts[line]["holds"] is (expected is not False and line not in fails), verdicts[line]
        if isinstance(expected, str):
            assert verdicts[line]["told"] == expected
    suite = Xml.parse(xml).getroot()[0]
    failed = {one.get("name") for one in suite if one.find("failure") is not None}
    assert failed == {line for line, one in verdicts.items() if not one["holds"]}
    assert (suite.get("tests"), suite.get("failures")) == (str(len(LINES)), str(len(failed)))


def test_a_file_that_is_wrong_is_refused_before_anything_runs(here: Here, tmp_path: Path) -> None:
    log = run(tmp_path)
    file = tmp_path / "t.yaml"
    ok = f"run: {log.name}\n"
    for text, words in {
        ok + "assert: ['max tlit < 3']": "there is no 'tlit'; quantities are tilt, speed",
        ok + "assert: [the robot is fine]": "is no expectation: write `max tilt < 25`",
        ok
        + "assert: ['odometry.healthy == good']": "there is no field 'healthy' in odometry; it has header, health",
        ok + "assert: ['max odometry.health < 3']": "is no number: compare it by == or !=",
        ok + "assert: ['pose.pose == 3']": "is no value but a group",
        ok + "assert: ['robot.estop == no']": "it is true or false",
        ok + "assert: ['max tilt < steep']": "'steep' is no number",
        ok + "assert: []": "assert: Tuple should have at least 1 item",
        ok
        + "asserts: [a]": "there is no key 'asserts'; a test has run, rerun, drive, set, sweep, against, assert",
        ok + "sweep: {seed: [1]}\nassert: ['max tilt < 3']": "change nothing without `rerun` or `drive`",
        ok
        + "rerun: odometry\nsweep: {odometry.engin: [a]}\nassert: ['max tilt < 3']": "no configuration key "
        "'odometry.engin'",
        ok + "rerun: elevation\nassert: ['max tilt < 3']": "which elevation needs",
        "assert: ['max tilt < 3']": "names no `run`",
        "run: nowhere.mcap\nassert: ['max tilt < 3']": "there is no",
        "drive: {scene: flat, goals: [moon]}\nassert: ['max tilt < 3']": "flat has no goal 'moon'; it has",
        "run: [": "is not YAML",
    }.items():
        file.write_text(text)
        done = here("log", "test", str(file))
        assert (done.returncode, words in done.stderr) == (1, True), (text, done.stderr)


def test_stages_are_run_again_with_every_setting(here: Here, tmp_path: Path) -> None:
    config = load(None, ["recorder.profile=full", "sim.lidar_step=8"], scene="flat")
    log = tmp_path / "stands.mcap"
    with Lockstep(config, Lockstep.open_log(config, log)) as stack:
        stack.wait_ready()
    text = (
        f"run: {log.name}\nrerun: odometry\nsweep: {{odometry.without: ['', lidar]}}\nset: {{seed: 1}}\n"
        "assert: [last odometry.health == good, max tilt < 3]\n"
    )
    kept = tmp_path / "kept"
    cases = judged(here, tmp_path / "t.yaml", text, "--logs", str(kept))
    assert [case["case"] for case in cases] == ["odometry.without=", "odometry.without=lidar"]
    assert [case["holds"] for case in cases] == [True, False]
    assert cases[1]["verdicts"][0]["told"].startswith("degraded at ")
    assert len(list(kept.glob("*.mcap"))) == 2
