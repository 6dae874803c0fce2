"""A backend of somebody else, by module and function or as an entry point of an installed package."""

from __future__ import annotations

import json
import shutil
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from hal.contract import BackendError
from hal.errors import OperatorError
from hal.types import Phase
from rbtrg_robot import topics as t
from rbtrg_robot.cli.stack import _check
from rbtrg_robot.config import ConfigError, load
from rbtrg_robot.hosts.robot import build
from rbtrg_robot.process.health import RATE_SHARE, expected_topics
from rbtrg_robot.processes import BY_NAME
from rbtrg_robot.stages.robot import STEP_PERIOD
from rbtrg_robot.stages.stage import Outputs
from rbtrg_robot.wire.messages import stamp_of
from tests.places import ROOT, extension
from tests.rbtrg_robot.process.command import SPARSE, command
from tools.bench.ports import free_port

CODE = '''
"""A robot that stands, and says what it was told."""

from hal.robots import describe
from hal.types import Phase, RobotState


class Standing:
    def __init__(self, config, clock):
        self.config, self.clock = config, clock
        self.capabilities = describe().capabilities("vmc")
        self.told, self.up, self.now = [], False, 0

    def connect(self):
        self.up = True

    def read(self, now):
        self.now = now
        return []

    def drive(self, command):
        self.told.append(command.vx)

    def posture(self, command):
        pass

    def request(self, mode):
        pass

    def state(self):
        return RobotState(self.now, Phase.READY if self.up else Phase.DISCONNECTED, "mine stands")

    def diagnostics(self):
        return {"mine": 1.0}

    def close(self, *, lie_down=True):
        self.up = False


def make(config, clock):
    return Standing(config, clock)


def nothing(config, clock):
    return "no backend"
'''


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """`own_backend.py` on the path, with the metadata of a package that has it for an entry point."""
    (tmp_path / "own_backend.py").write_text(CODE)
    (tmp_path / "mine.py").write_text(extension("mine", "extend/robots.md"))
    robot = shutil.copytree(ROOT / "hal/robots/jackal", tmp_path / "my_robot") / "robot.yaml"
    robot.write_text(robot.read_text().replace("name: jackal", "name: my_robot"))
    info = tmp_path / "own_backend-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: own-backend\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[rbtrg.backends]\nmine = own_backend:make\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    for name in ("own_backend", "mine"):
        sys.modules.pop(name, None)


@pytest.mark.parametrize("name", ["own_backend:make", "mine"])
def test_it_stands_behind_the_gate(module: Path, name: str) -> None:
    config = load(None, [f"backend={name}", "controller=vmc"])
    _check(config)
    stage = build(config)
    made = stage.backend
    assert type(made).__name__ == "Standing"
    assert made.config is config  # type: ignore[attr-defined]
    assert t.CLOCK not in stage.outputs, "its clock is the computer's"
    stage.warm_up()
    told = [m for topic, m in stage.tick(made.clock()) if topic is t.ROBOT_STATE]  # type: ignore[attr-defined]
    assert told[0].phase == Phase.READY.value
    assert told[0].cause.startswith("mine stands")
    stage.tick(made.clock() + STEP_PERIOD)  # type: ignore[attr-defined]
    assert made.told == [0.0, 0.0]  # type: ignore[attr-defined]
    stage.close()
    assert not made.up  # type: ignore[attr-defined]


def test_what_is_none_is_told_before_the_robot_moves(module: Path) -> None:
    with pytest.raises(ConfigError, match="driven by sim, unitree, not by other"):
        load(None, ["backend=other"])
    for name, words in (("own_backend:mak", "has no attribute 'mak'"), ("nowhere_at_all:make", "PYTHONPATH")):
        with pytest.raises(OperatorError, match=words):
            _check(load(None, [f"backend={name}"]))
    with pytest.raises(
        BackendError, match=r"own_backend:nothing made 'no backend', which is no hal\.contract"
    ):
        build(load(None, ["backend=own_backend:nothing"]))


def test_the_one_of_the_docs_delivers_what_the_stack_waits_for(module: Path) -> None:
    model = str(module / "my_robot")
    config = load(None, ["sim.lidar_step=16"], backend="mine:make", robot_model=model, scene="flat")
    now = 7 * 10**9
    stage = build(config, clock=lambda: now)  # type: ignore[arg-type]
    stage.warm_up()
    outputs: Outputs = []
    for _ in range(200):
        now += STEP_PERIOD
        outputs += stage.tick(now)
    stage.close()
    count = Counter(topic for topic, _ in outputs)
    lidars = [lidar.name for lidar in config.lidars]
    for topic in expected_topics([BY_NAME["robot"]], simulated=False, lidars=lidars):
        assert count[topic] >= RATE_SHARE * topic.rate, topic
    assert t.TRUTH not in count
    states = [message for topic, message in outputs if topic is t.ROBOT_STATE]
    assert states[-1].phase == Phase.READY.value
    assert 0 <= now - stamp_of(states[-1]) <= 10**8


@pytest.mark.timeout(360)
def test_the_one_of_the_docs_comes_up_and_drives_to_a_goal(
    module: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As its page says, in processes of their own."""
    monkeypatch.setenv("PYTHONPATH", str(module))
    mine = ("--robot-model", str(module / "my_robot"), "--backend", "mine:make", "--scene", "flat")
    few = ("--without", "console", "--without", "mission", "--no-record", *SPARSE)
    try:
        made = command(module, "up", "--detach", *mine, *few, "--port", str(free_port()), limit=240.0)
        assert made.returncode == 0, made.stderr
        status = json.loads(command(module, "status", "--json").stdout)
        assert {row["process"]: row["detail"] for row in status["processes"]}["camera"].startswith(
            "no camera"
        )
        told = {row["topic"]: row["ok"] for row in status["topics"]}
        assert told[t.HEAD_POINTS.name], "it carries none"
        driven = command(module, "goal", "0.6", "0.0", "--wait", limit=60.0)
        assert driven.stdout.splitlines()[-1] == "goal reached", driven.stderr
    finally:
        assert command(module, "down", limit=60.0).returncode == 0
