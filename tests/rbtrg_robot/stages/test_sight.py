"""Heights of the ground reach a policy that asks for them by the bus, and what is not known is told."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from hal.lowlevel import Ground
from hal.mujoco.backend import MujocoBackend
from hal.robots import describe
from hal.safety.gate import SafetyGate
from hal.scenes import load_scene
from hal.types import NS
from mapping.elevation.exchange import PATCH_LAYERS, MapPatch
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.stages.robot import STEP_PERIOD, RobotStage
from rbtrg_robot.stages.sight import OLDEST_WINDOW, Sight
from rbtrg_robot.wire.convert import odometry_msg, patch_msg
from tests.hal.robots.go2w.locomotion.networks import linear
from tests.rbtrg_robot.hearsay import map_offset

PLACES = np.array([[0.0, 0.0], [0.5, 0.0], [0.0, 0.25], [1.0, -1.0]])
FLAT = np.array([0.0, 0.0, 0.0, 1.0])


def window(stamp: int, seen: float = 9.0) -> msg.GridMap:
    """4 x 4 m about the origin of `map` that rises by 0.2 along x and 0.1 along y; nobody saw it beyond x = `seen`."""
    x, y = np.meshgrid(np.arange(-40, 41) * 0.05, np.arange(-40, 41) * 0.05)
    layers = {name: np.zeros(x.shape, np.float32) for name in PATCH_LAYERS}
    layers["elevation"] = (0.2 * x + 0.1 * y).astype(np.float32)
    layers["elevation"][x > seen] = np.nan
    layers["trusted"] = (x <= seen).astype(np.float32)
    return patch_msg(MapPatch((-2.0, -2.0), 0.05, stamp, 0, layers))


def test_heights_are_those_of_the_map_under_the_turned_robot() -> None:
    sight = Sight(PLACES)
    sight.window(window(5 * NS))
    sight.status(msg.MapStatus(height_correction=0.02))
    x, y, yaw = 0.3, -0.4, math.radians(90)
    ground = sight.ground(5 * NS + NS // 10, (np.array([x, y, 0.7]), yaw))
    assert ground.lacks == ""
    for (ahead, left), above in zip(PLACES, ground.above, strict=True):
        px, py = x - left, y + ahead
        assert above == pytest.approx(0.72 - 0.2 * px - 0.1 * py, abs=0.01), (ahead, left)


@pytest.mark.parametrize(
    ("how", "why"),
    [
        ("never", "no map came yet"),
        ("lost", "the pose is not known"),
        ("old", f"older than {OLDEST_WINDOW} s"),
        ("early", f"older than {OLDEST_WINDOW} s"),
        ("moved", "no map came yet"),
        ("broken", "no map came yet"),
        ("unseen", "nobody saw most of it"),
        ("outside", "nobody saw most of it"),
    ],
)
def test_what_is_not_known_is_told(how: str, why: str) -> None:
    sight = Sight(PLACES)
    stamp = {"old": 4 * NS, "early": 6 * NS}.get(how, 5 * NS)
    if how != "never":
        sight.window(window(stamp, seen=-0.1 if how == "unseen" else 9.0))
    if how == "moved":
        sight.forget()
    if how == "broken":
        sight.window(msg.GridMap())
    place = np.array([30.0 if how == "outside" else 0.0, 0.0, 0.5])
    ground = sight.ground(5 * NS, None if how == "lost" else (place, 0.0))
    assert why in ground.lacks
    assert np.isnan(ground.above).sum() > len(PLACES) / 2


def test_a_policy_in_the_simulated_robot_sees_the_map_of_another_process(tmp_path: Path) -> None:
    """Heights, of the map alone, move a joint: the ground of the scene is flat."""
    heights = {
        "term": "heights", "x": [0.0, 0.5, 2], "y": [0.0, 0.0, 1], "unknown": 0.4, "offset": 0.4, "clip": [-0.3, 0.3]
    }  # fmt: skip
    description = {
        "stand": describe().pose.tolist(), "kp": 80.0, "kd": 3.0, "action": {"scale": 1.0, "clip": [-1.0, 1.0]},
        "network": "net.onnx", "observation": [heights],
    }  # fmt: skip
    (tmp_path / "policy.yaml").write_text(yaml.safe_dump(description))
    weight = linear(tmp_path / "net.onnx", 2)
    motor = int(np.argmax(np.abs(weight[0, :12])))
    backend = MujocoBackend(
        load_scene("flat"), controller="policy", policy_dir=str(tmp_path), lidars=(), seated=False
    )
    told: list[Ground] = []
    see = backend.controller.see  # type: ignore[attr-defined]
    backend.controller.see = lambda ground: (told.append(ground), see(ground))  # type: ignore[attr-defined]
    stage = RobotStage(backend, SafetyGate(backend.capabilities), simulated=True, watched=frozenset())
    assert {t.MAP_WINDOW, t.MAP_STATUS} <= set(stage.inputs)
    stage.warm_up()
    stage.on(t.TF_STATIC, map_offset())

    def run(ticks: int, now: int, maps: bool) -> int:
        for _ in range(ticks):
            now += STEP_PERIOD
            stage.on(t.POSE, odometry_msg(now, (0.0, 0.0, 0.5), FLAT, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
            if maps:
                stage.on(t.MAP_WINDOW, window(now))
            stage.tick(now)
        return now

    def moved() -> float:
        command = backend.controller._command  # type: ignore[attr-defined]
        return float(command.q[motor] - describe().pose[motor])

    now = run(20, 0, maps=False)
    assert told[-1].lacks == "no map came yet"
    assert moved() == pytest.approx(0.0, abs=1e-6), "unknown ground counts as declared: at the offset"
    assert "no map came yet; it counts as 0.4 m below" in backend.controller.warning()
    now = run(10, now, maps=True)
    assert told[-1].lacks == ""
    np.testing.assert_allclose(told[-1].above, [0.5, 0.4], atol=0.011)
    wanted = np.array([0.1, 0.0]) @ weight[:, motor]
    assert moved() == pytest.approx(wanted, abs=0.004)
    assert abs(wanted) > 0.01
    assert backend.controller.warning() == ""
    run(round((OLDEST_WINDOW + 0.1) * NS / STEP_PERIOD), now, maps=False)
    assert f"the map is older than {OLDEST_WINDOW} s" in backend.controller.warning()
    stage.close()


def test_a_blind_controller_does_not_ask_for_the_map() -> None:
    backend = MujocoBackend(load_scene("flat"), controller="vmc", lidars=(), seated=False)
    stage = RobotStage(backend, SafetyGate(backend.capabilities), simulated=True, watched=frozenset())
    assert t.MAP_WINDOW not in stage.inputs
