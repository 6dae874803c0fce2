"""Every field that safety depends on has two ends, and each keeps the robot safe."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel

from hal.safety.gate import GateConfig, GateInputs, SafetyGate
from hal.safety.gate_types import MotionLimits
from hal.safety.geofence import Fence
from hal.types import NS, Capabilities, Phase, RobotState, VelocityCommand
from hal.unitree.api import Sport
from hal.unitree.config import UnitreeConfig
from mapping.odometry.health import Health, HealthConfig, HealthMonitor, Verdict
from mapping.odometry.registration.engines import Match
from rbtrg_robot import topics as t
from rbtrg_robot.config import ConfigError, StackConfig, load
from rbtrg_robot.stage_config import FreshnessConfig, GuardConfig
from rbtrg_robot.stages import tracker
from tests.hal.unitree.robot import Faults
from tests.hal.unitree.world import World
from tests.rbtrg_robot.hearsay import map_offset
from tests.rbtrg_robot.stages.test_tracker import Inputs

ROOTS: dict[str, type[BaseModel]] = {
    "gate": GateConfig,
    "guard": GuardConfig,
    "freshness": FreshnessConfig,
    "odometry.health": HealthConfig,
    "unitree": UnitreeConfig,
}
NO_LIMITS = {"unitree.domain"}
"""A name, no threshold."""
TICK = NS // 50
MOST = 1.0
"""[m/s] of the robot that is tried."""
SEES, BRAKES = 0.17, 3.0
"""[s] from the sweep to the brakes; [m/s^2] of the simulated robot."""


def numbers(model: type[BaseModel], path: str) -> dict[str, tuple[float, float, float]]:
    """Path -> default, least, most of each number below a model; infinite where there is no bound."""
    out: dict[str, tuple[float, float, float]] = {}
    for name, field in model.model_fields.items():
        here = f"{path}.{name}"
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            out |= numbers(field.annotation, here)
        elif field.annotation in (int, float):
            low = max(
                (m.ge if isinstance(m, Ge) else m.gt for m in field.metadata if isinstance(m, Ge | Gt)),
                default=-math.inf,
            )
            high = min(
                (m.le if isinstance(m, Le) else m.lt for m in field.metadata if isinstance(m, Le | Lt)),
                default=math.inf,
            )
            out[here] = (field.get_default(), float(low), float(high))
    return out


FIELDS = {path: found for root, model in ROOTS.items() for path, found in numbers(model, root).items()}
FIELDS |= {"body.length": (0.7, 0.7, 1.5), "body.width": (0.43, 0.43, 1.0)}  # by the robot
FIELDS |= {"gate.fence_margin": (0.41, 0.35, 2.0)}
ENDS = [
    (path, end) for path, (_, low, high) in FIELDS.items() if path not in NO_LIMITS for end in (low, high)
]


def accepted(path: str, value: float) -> StackConfig | None:
    """The configuration with this one field; None where it is refused."""
    try:
        return load(None, [f"{path}={value!r}"], scene="flat")
    except ConfigError:
        return None


@pytest.mark.parametrize("path", sorted(set(FIELDS) - NO_LIMITS))
def test_a_field_has_two_ends_and_nothing_beyond_them_is_accepted(path: str) -> None:
    default, low, high = FIELDS[path]
    assert math.isfinite(low), "no lower bound"
    assert math.isfinite(high), "no upper bound"
    assert low <= default <= high
    step = 1 if isinstance(default, int) else 1e-3
    for beyond in (low - step, high + step, -1e9, 1e9):
        assert accepted(path, beyond) is None
    named = "body" if path.startswith("body") else re.escape(path)
    with pytest.raises(ConfigError, match=named):
        load(None, [f"{path}=.nan"])


def gate_stops(config: StackConfig) -> None:
    """Whatever ends, the robot stands half a metre further, and what is latched is latched."""
    caps = Capabilities("test", max_vx=MOST, max_wz=1.0, max_accel=1.0, max_alpha=3.0)

    def well(now: int) -> GateInputs:
        stamps = {"imu": now, "joints": now, "lidar": now}
        limits = MotionLimits(now, MOST, MOST, 1.0, 1.0)
        return GateInputs(
            RobotState(now, Phase.READY), 0.05, pose=(0.0, 0.0, 0.0), limits=limits, stamps=stamps
        )

    def drive(ends: str, seconds: float, vx: float = MOST) -> tuple[SafetyGate, float]:
        """Way [m] after everything of one kind ended."""
        gate, now, way = SafetyGate(caps, config.gate), 10 * NS, 0.0
        for _ in range(150):
            now += TICK
            gate.command(VelocityCommand(now, vx=vx), now)
            gate.output(now, well(now))
        died = now
        for _ in range(round(50 * seconds)):
            now += TICK
            inputs, stamp = well(now), now
            if ends == "command":
                stamp = died
            elif ends == "future":
                stamp = now + NS // 4
            elif ends == "guard":
                inputs = replace(inputs, limits=replace(inputs.limits, stamp=died))
            elif ends == "state":
                inputs = replace(inputs, state=RobotState(died, Phase.READY))
            elif ends in ("imu", "joints", "lidar"):
                inputs = replace(inputs, stamps={**inputs.stamps, ends: died})
            elif ends == "tilt":
                inputs = replace(inputs, tilt=1.21)
            elif ends == "battery":
                inputs = replace(inputs, state=RobotState(now, Phase.READY, battery=0.04))
            elif ends == "heat":
                inputs = replace(inputs, state=RobotState(now, Phase.READY, motor_temperature=121.0))
            elif ends == "untold":
                stamp, inputs = died, replace(inputs, velocity=(0.11, 0.0, 0.0), wheels=(0.11, 0.0))
            elif ends == "stuck":
                inputs = replace(inputs, velocity=(0.0, 0.0, 0.0))
            gate.command(VelocityCommand(stamp, vx=vx), now)
            way += gate.output(now, inputs).vx / 50
            if gate.latched and ends in ("untold", "stuck"):
                break
        return gate, way

    for ends in ("command", "future", "guard", "imu", "joints"):
        assert drive(ends, 3.0)[1] <= 0.5 * MOST + 0.03, ends
    for ends in ("state", "lidar"):
        assert drive(ends, 3.0)[1] <= 1.5 * MOST + 0.03, ends
    for ends in ("tilt", "battery", "heat"):
        gate, way = drive(ends, 1.0)
        assert gate.latched, ends
        assert way == 0.0
    assert drive("untold", 4.0)[0].latched
    assert drive("stuck", 31.0, vx=0.5)[0].latched


def fence_holds(config: StackConfig) -> None:
    """A robot that brakes with 1.5 m/s^2, 0.1 s late, keeps its front inside, and comes near the fence."""
    caps = Capabilities("test", max_vx=MOST, max_wz=1.0, max_accel=1.0, max_alpha=3.0)
    gate = SafetyGate(caps, config.gate, Fence.of([(-5, -5), (5, -5), (5, 5), (-5, 5)]), guarded=False)
    x, v, now, asked = 0.0, 0.0, NS, [0.0] * 5
    for _ in range(1500):
        now += TICK
        gate.command(VelocityCommand(now, vx=MOST), now)
        inputs = GateInputs(
            RobotState(now, Phase.READY),
            0.0,
            pose=(x, 0.0, 0.0),
            stamps={"imu": now, "joints": now, "lidar": now},
        )
        asked = [*asked[1:], gate.output(now, inputs).vx]
        v = max(asked[0], v - 1.5 / 50)
        x += v / 50
    assert x + 0.35 <= 5.0
    assert x > 2.5


def guard_stops(config: StackConfig) -> None:
    """From what the guard allows before a wall, and from the fastest where it sees none, the robot stops before it."""
    p = config.guard
    for free in (0.05, 0.2, 0.5, 1.0, 2.4):
        left = max(0.0, free - p.margin)
        v = p.deceleration * (math.sqrt(p.reaction**2 + 2.0 * left / p.deceleration) - p.reaction)
        assert SEES * v + v * v / (2.0 * BRAKES) <= free
    v = config.capabilities().max_vx
    assert SEES * v + v * v / (2.0 * BRAKES) <= 2.4
    assert p.window_timeout <= 1.0
    assert p.pose_timeout <= 0.5


def tracker_holds(config: StackConfig) -> None:
    """What is old by 3.1 s, or a pose by 0.6 s, is not driven on; a healthy stack is."""
    world = Inputs()
    world.stage = tracker.build(config)
    world.stage.on(t.TF_STATIC, map_offset())
    world.run(0.1)
    world.path("goal/1")
    assert max(world.run(1.0)) > 0.3
    for topic, late in ((t.POSE, 0.6), (t.ODOM, 2.1), (t.MAP_STATUS, 3.1), (t.GOAL_STATUS, 3.1)):
        world.late = {topic: late}
        world.run(3.2)
        assert set(world.run(0.2)) == {0.0}
        world.late = {}
        assert max(world.run(1.0)) > 0.1


def robot_obeys(config: StackConfig) -> None:
    """The driver starts with a healthy robot, stops it when LowState ends, and is not fooled by one that ignores Move
    or StopMove."""
    world = World(Faults(), options=config.unitree_options())
    world.backend.connect()
    world.until(Phase.READY, 10.0)
    world.run(1.0, vx=0.3)
    assert 0.05 < world.body.v < 1.5
    world.faults.low_silent = True
    world.run(1.1, vx=0.3)
    assert world.phase is Phase.DISCONNECTED
    assert abs(world.body.v) < 0.05
    rolling = World(Faults(rolls=True), options=config.unitree_options())
    rolling.backend.connect()
    rolling.until(Phase.READY, 10.0)
    rolling.run(1.0, vx=0.3)
    for _ in range(8):
        if Sport.DAMP not in rolling.apis():
            rolling.run(1.0)
    assert Sport.DAMP in rolling.apis()


def odometry_judges(config: StackConfig) -> None:
    """Lost ends every goal: at the speed of the robot it comes after 5 m without a usable scan, or with a metre of
    doubt. What fits nowhere, jumps, or holds hardly a point is not used; what fits is, and is no reason for it."""
    second, here, sure = NS, np.eye(4), 1e-6 * np.eye(6)

    def judged(**how: Any) -> Verdict:
        monitor = HealthMonitor(config.odometry.health)
        monitor.start(second)
        well = Match(here, 1000, 1.0, 1000, 1.0, 0.001, np.diag([0.3, 0.3, 0.4, 1.0, 1.0, 1.0]))
        return monitor.judge(second + NS // 10, replace(well, **how), here, sure, 200, 0.02)

    def without(after: float, sigma: float = 0.0) -> Health:
        monitor = HealthMonitor(config.odometry.health)
        monitor.start(second)
        return monitor.without_match(second + round(after * NS), sigma, "no scan")[0]

    assert judged().use
    assert judged().health is not Health.LOST
    jumped = here.copy()
    jumped[0, 3] = 5.1
    for how in ({"overlap": 0.04, "on_planes": 10}, {"inliers": 0.25}, {"points": 9}, {"pose": jumped}):
        assert not judged(**how).use, how
    assert without(0.1) is not Health.LOST
    assert without(5.0 / MOST + 0.1) is Health.LOST
    assert without(0.1, sigma=1.01) is Health.LOST


@pytest.mark.parametrize(("path", "end"), ENDS, ids=lambda x: f"{x:g}" if isinstance(x, float) else x)
def test_each_end_keeps_the_robot_safe(path: str, end: float) -> None:
    value = int(end) if isinstance(FIELDS[path][0], int) else end
    config = accepted(path, value)
    if config is None:
        assert path in ("guard.reaction", "guard.deceleration"), (
            "with the other one as it is, it is refused for the speed"
        )
        return
    group = path.split(".")[0]
    if group == "gate":
        gate_stops(config)
        fence_holds(config)
    elif group == "guard":
        guard_stops(config)
    elif group == "freshness":
        tracker_holds(config)
    elif group == "unitree":
        robot_obeys(config)
        guard_stops(load(None, [f"{path}={value!r}", "backend=unitree"]))
    elif group == "odometry":
        odometry_judges(config)
    else:
        assert config.body.length >= 0.70
        assert config.body.width >= 0.43


def test_the_simulated_robot_may_do_without_the_guard() -> None:
    assert "guard" in load(None, ["without=[guard]"]).without
