"""The safety gate: whatever comes in, what goes out is limited, dated and stoppable."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from hal.safety.gate import GateConfig, GateInputs, RefusalReason, SafetyGate, StopCause
from hal.safety.gate_types import MotionLimits
from hal.safety.geofence import Fence, Geofence, GeofenceError
from hal.safety.monitors import MOVES_UNTOLD, taken_out
from hal.safety.tilt import TiltFilter
from hal.types import FELT_EDGE, NS, Capabilities, ImuSample, Phase, RobotState, VelocityCommand

CAPS = Capabilities("test", max_vx=1.0, max_wz=1.0, max_accel=1.0, max_alpha=3.0)
MS = NS // 1000
TICK = 20 * MS


def well(now: int, **changes) -> GateInputs:
    """Inputs of a healthy robot at `now`."""
    inputs = GateInputs(
        state=RobotState(now, Phase.READY),
        tilt=0.05,
        limits=MotionLimits(now, 1.0, 1.0, 1.0, 1.0),
        stamps={"imu": now, "joints": now, "lidar": now},
    )
    return replace(inputs, **changes)


def run(gate: SafetyGate, start: int, seconds: float, vx: float = 0.5, wz: float = 0.0, **changes):
    """Command and drive at 50 Hz; the last output and the time after it."""
    out, now = VelocityCommand(start), start
    for _ in range(round(seconds / 0.02)):
        gate.command(VelocityCommand(now, vx=vx, wz=wz), now)
        out = gate.output(now, well(now, **changes))
        now += TICK
    return out, now


def test_a_fresh_command_is_slewed_up_and_passed():
    gate = SafetyGate(CAPS)
    speeds = []
    for k in range(40):
        gate.command(VelocityCommand(k * TICK, vx=0.5, wz=-0.6), k * TICK)
        out = gate.output(k * TICK, well(k * TICK))
        speeds.append(out.vx)
    assert speeds[0] == 0.0
    assert np.diff(speeds).max() == pytest.approx(1.0 * 0.02)
    assert (out.vx, out.wz, out.stamp) == (0.5, -0.6, 39 * TICK)
    assert gate.status().hold == ""


def test_silence_is_zero_at_the_deadline_after_a_short_ramp():
    gate = SafetyGate(CAPS)
    _, now = run(gate, 0, 1.0)
    last_command = now - TICK
    seen = {}
    for ms in range(10, 300, 10):
        out = gate.output(last_command + ms * MS, well(last_command + ms * MS))
        seen[ms] = out.vx
    assert seen[110] == 0.5
    assert 0.0 < seen[170] < 0.3
    assert seen[200] == 0.0
    assert all(v == 0.0 for ms, v in seen.items() if ms >= 200)
    assert gate.status().hold == "no fresh command"


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (VelocityCommand(NS, vx=math.nan), RefusalReason.NOT_FINITE),
        (VelocityCommand(NS, wz=math.inf), RefusalReason.NOT_FINITE),
        (VelocityCommand(NS, vx=1.01), RefusalReason.OVER_LIMIT),
        (VelocityCommand(NS, vx=-1.01), RefusalReason.OVER_LIMIT),
        (VelocityCommand(NS, wz=-1.5), RefusalReason.OVER_LIMIT),
        (VelocityCommand(NS, vy=0.1), RefusalReason.OVER_LIMIT),
        (VelocityCommand(NS, vx=0.1, frame="odom"), RefusalReason.WRONG_FRAME),
        (VelocityCommand(NS + 100 * MS, vx=0.1), RefusalReason.FROM_FUTURE),
        (VelocityCommand(NS - 200 * MS, vx=0.1), RefusalReason.TOO_OLD),
        (VelocityCommand(0, vx=0.1), RefusalReason.TOO_OLD),
    ],
)
def test_bad_commands_are_refused_counted_and_do_not_move(command: VelocityCommand, reason: RefusalReason):
    gate = SafetyGate(CAPS)
    for _ in range(3):
        refusal = gate.command(command, NS)
        assert refusal is not None
        assert refusal.reason is reason
        assert refusal.detail
    assert gate.status().refused == {reason.value: 3}
    assert gate.status().accepted == 0
    for k in range(10):
        assert gate.output(NS + k * TICK, well(NS + k * TICK)).vx == 0.0


def test_a_stamp_ahead_of_the_clock_does_not_prolong_a_command():
    gate = SafetyGate(CAPS)
    for now in range(0, NS, TICK):
        assert gate.command(VelocityCommand(now + 50 * MS, vx=0.5), now) is None
        gate.output(now, well(now))
    assert gate.output(now + 100 * MS, well(now + 100 * MS)).vx == 0.5
    assert gate.output(now + 200 * MS, well(now + 200 * MS)).vx == 0.0


def test_an_older_command_does_not_replace_a_newer_one():
    gate = SafetyGate(CAPS)
    assert gate.command(VelocityCommand(NS, vx=0.2), NS) is None
    refusal = gate.command(VelocityCommand(NS - 50 * MS, vx=0.9), NS)
    assert refusal is not None
    assert refusal.reason is RefusalReason.OUT_OF_ORDER


def test_stop_is_zero_at_once_and_holds_until_resume():
    gate = SafetyGate(CAPS)
    _, now = run(gate, 0, 1.0)
    gate.stop()
    assert gate.output(now, well(now)).vx == 0.0
    out, now = run(gate, now, 2.0)
    assert out.vx == 0.0
    status = gate.status()
    assert status.latched
    assert status.cause == "emergency stop"
    assert status.refused["stopped until resume"] == 100
    gate.resume()
    assert gate.output(now, well(now)).vx == 0.0, "an old command must not come back to life"
    out, _ = run(gate, now + TICK, 1.0)
    assert out.vx == 0.5


def test_forget_is_zero_until_the_next_fresh_command_without_a_latch():
    gate = SafetyGate(CAPS)
    _, now = run(gate, 0, 1.0)
    gate.forget()
    assert gate.output(now, well(now)).vx == 0.0
    assert not gate.status().latched
    out, _ = run(gate, now + TICK, 1.0)
    assert out.vx == 0.5


def test_the_first_cause_stays():
    gate = SafetyGate(CAPS)
    gate.stop(StopCause.ROBOT_FAULT, "fallen")
    gate.stop(StopCause.OPERATOR)
    assert gate.status().cause == "robot fault: fallen"


@pytest.mark.parametrize(
    ("changes", "cause"),
    [
        ({"tilt": 0.9}, "tilt: 52 deg, limit 40 deg"),
        ({"tilt": math.nan}, "tilt"),
        ({"state": RobotState(0, Phase.READY, battery=0.05)}, "battery low: 5 %, limit 10 %"),
        (
            {"state": RobotState(0, Phase.READY, motor_temperature=95.0)},
            "motor too hot: 95 deg C, limit 90 deg C",
        ),
        ({"state": RobotState(0, Phase.READY, battery=math.nan)}, "battery low"),
        ({"state": RobotState(0, Phase.READY, motor_temperature=math.nan)}, "motor too hot"),
        ({"state": RobotState(0, Phase.FAULT, "fallen")}, "robot fault: fallen"),
    ],
)
def test_conditions_an_operator_must_look_at_latch(changes, cause: str):
    gate = SafetyGate(CAPS)
    _, now = run(gate, 0, 1.0)
    if "state" in changes:
        changes = {"state": replace(changes["state"], stamp=now)}
    assert gate.output(now, well(now, **changes)).vx == 0.0
    out, now = run(gate, now + TICK, 1.0)
    assert out.vx == 0.0
    assert gate.status().cause.startswith(cause)
    gate.resume()
    out, now = run(gate, now, 1.0)
    assert out.vx == 0.5
    # A condition that persists latches again.
    if "state" in changes:
        changes = {"state": replace(changes["state"], stamp=now)}
    gate.output(now, well(now, **changes))
    gate.resume()
    assert gate.output(now, well(now, **changes)).vx == 0.0
    assert gate.status().latched


@pytest.mark.parametrize(("sensor", "limit"), [("state", 0.5), ("imu", 0.2), ("joints", 0.3), ("lidar", 1.0)])
def test_a_stale_sensor_holds_and_its_return_releases(sensor: str, limit: float):
    gate = SafetyGate(CAPS)
    _, now = run(gate, 0, 1.0)
    dead = now - TICK
    held = []
    for _ in range(round((limit + 0.3) / 0.02)):
        gate.command(VelocityCommand(now, vx=0.5), now)
        inputs = well(now)
        if sensor == "state":
            inputs = replace(inputs, state=RobotState(dead, Phase.READY))
        else:
            inputs = replace(inputs, stamps={**inputs.stamps, sensor: dead})
        held.append((now - dead, gate.output(now, inputs).vx))
        now += TICK
    assert all(vx == 0.5 for age, vx in held if age <= limit * NS)
    assert all(vx == 0.0 for age, vx in held if age > limit * NS)
    assert gate.status().hold.startswith(f"{sensor} is ")
    out, _ = run(gate, now, 1.0)
    assert out.vx == 0.5


def test_no_setting_takes_a_sensor_out_of_the_checks():
    one = GateConfig.model_validate({"sensor_timeout": {"lidar": 1.5}})
    none = GateConfig.model_validate({"sensor_timeout": {}})
    assert one.sensor_timeout.lidar == 1.5
    for params in (one, none):
        for sensor in ("state", "imu", "joints", "lidar"):
            gate = SafetyGate(CAPS, params)
            _, now = run(gate, 0, 1.0)
            now += 3 * NS
            inputs = well(now)
            if sensor == "state":
                inputs = replace(inputs, state=RobotState(now - 3 * NS, Phase.READY))
            else:
                inputs = replace(inputs, stamps={**inputs.stamps, sensor: now - 3 * NS})
            gate.command(VelocityCommand(now, vx=0.5), now)
            assert gate.output(now, inputs).vx == 0.0
            assert gate.status().hold == f"{sensor} is 3.0 s old"


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf, None])
@pytest.mark.parametrize("key", ["state", "imu", "joints", "lidar"])
def test_a_timeout_that_could_never_trip_is_refused(key: str, value: float | None):
    with pytest.raises(ValidationError):
        GateConfig.model_validate({"sensor_timeout": {key: value}})


@pytest.mark.parametrize("key", sorted(set(GateConfig.model_fields) - {"sensor_timeout"}))
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_no_threshold_is_infinite(key: str, value: float):
    with pytest.raises(ValidationError):
        GateConfig.model_validate({key: value})


@pytest.mark.parametrize(
    ("vx", "wz", "out"),
    [(0.5, 0.6, (0.2, 0.4)), (-0.5, -0.6, (-0.1, -0.3)), (0.1, -0.2, (0.1, -0.2)), (0.0, 0.6, (0.0, 0.4))],
)
def test_no_motion_is_faster_than_the_guard_allows(vx: float, wz: float, out: tuple[float, float]):
    gate = SafetyGate(CAPS)
    limits = MotionLimits(0, forward=0.2, backward=0.1, left=0.4, right=0.3)
    now = 0
    for _ in range(50):
        gate.command(VelocityCommand(now, vx=vx, wz=wz), now)
        driven = gate.output(now, well(now, limits=replace(limits, stamp=now)))
        now += TICK
    assert (driven.vx, driven.wz) == pytest.approx(out)
    assert gate.status().hold == ""


def test_what_the_guard_forbids_is_zero_at_once_and_the_gate_says_why():
    gate = SafetyGate(CAPS)
    _, now = run(gate, 0, 1.0)
    gate.command(VelocityCommand(now, vx=0.5), now)
    limits = MotionLimits(now, 0.0, 1.0, 1.0, 1.0, "a 0.45 m face 0.02 m ahead")
    assert gate.output(now, well(now, limits=limits)).vx == 0.0
    assert gate.status().hold == "guard: a 0.45 m face 0.02 m ahead"


def test_a_silent_guard_means_zero_after_a_third_of_a_second():
    gate = SafetyGate(CAPS)
    _, now = run(gate, 0, 1.0)
    last = MotionLimits(now - TICK, 1.0, 1.0, 1.0, 1.0)
    seen = {}
    for _ in range(20):
        gate.command(VelocityCommand(now, vx=0.5), now)
        seen[now - last.stamp] = gate.output(now, well(now, limits=last)).vx
        now += TICK
    assert {age for age, vx in seen.items() if vx == 0.5} == {age for age in seen if age <= 0.3 * NS}
    assert gate.status().hold.startswith("guard is 0.")


def test_limits_from_the_future_allow_nothing():
    gate = SafetyGate(CAPS)
    _, now = run(gate, 0, 1.0)
    later = MotionLimits(now + NS, 1.0, 1.0, 1.0, 1.0)
    out, _ = run(gate, now, 0.5, limits=later)
    assert out.vx == 0.0


def test_a_robot_that_can_strafe_does_not_while_the_guard_runs():
    caps = replace(CAPS, strafe=True, max_vy=0.5)
    for guarded, sideways in ((True, 0.0), (False, 0.3)):
        gate = SafetyGate(caps, guarded=guarded)
        for now in range(0, NS, TICK):
            gate.command(VelocityCommand(now, vx=0.2, vy=0.3), now)
            out = gate.output(now, well(now))
        assert (out.vx, out.vy) == (pytest.approx(0.2), sideways)


@pytest.mark.parametrize("value", [math.nan, -1.0, -math.inf])
def test_limits_that_make_no_sense_allow_nothing(value: float):
    gate = SafetyGate(CAPS)
    out, _ = run(gate, 0, 1.0, wz=0.5, limits=MotionLimits(0, value, value, value, value))
    assert (out.vx, out.wz) == (0.0, 0.0)


def test_a_robot_without_a_guard_must_be_told_so():
    out, _ = run(SafetyGate(CAPS), 0, 1.0, limits=None)
    assert out.vx == 0.0
    out, _ = run(SafetyGate(CAPS, guarded=False), 0, 1.0, limits=None)
    assert out.vx == 0.5


def test_the_operators_own_remote_takes_the_motion_until_resume():
    gate = SafetyGate(CAPS)
    _, now = run(gate, 0, 1.0)
    assert gate.output(now, well(now, state=RobotState(now, Phase.MOVING, remote=True))).vx == 0.0
    out, now = run(gate, now + TICK, 1.0)
    assert out.vx == 0.0
    assert gate.status().cause == "the operator's remote drives"
    gate.resume()
    out, _ = run(gate, now, 1.0)
    assert out.vx == 0.5


def test_what_was_never_seen_holds():
    gate = SafetyGate(CAPS)
    gate.command(VelocityCommand(0, vx=0.5), 0)
    cases = [
        (GateInputs(), "no robot state yet"),
        (well(0, stamps={"imu": 0, "joints": 0}), "no lidar yet"),
        (well(0, tilt=None), "no attitude yet"),
        (well(0, limits=None), "no guard yet"),
        (well(0, state=RobotState(0, Phase.SITTING)), "robot is sitting"),
        (well(0, stamps={"imu": 5 * NS, "joints": 0, "lidar": 0}), "imu is stamped"),
    ]
    for inputs, hold in cases:
        assert gate.output(0, inputs) == VelocityCommand(0)
        assert gate.status().hold.startswith(hold)


def test_a_command_that_moves_nothing_is_flagged_and_latches_in_the_end():
    gate = SafetyGate(CAPS)
    _, now = run(gate, 0, 1.0, velocity=(0.0, 0.0, 0.0))
    assert not gate.status().not_moving
    _, now = run(gate, now, 0.2, velocity=(0.02, 0.0, 0.0))
    assert gate.status().not_moving
    assert not gate.status().latched
    out, now = run(gate, now, 0.2, velocity=(0.4, 0.0, 0.0))
    assert not gate.status().not_moving
    out, now = run(gate, now, 11.9, velocity=(0.0, 0.0, 0.0))
    assert out.vx == 0.5
    out, now = run(gate, now, 0.2, velocity=(0.0, 0.0, 0.0))
    assert out.vx == 0.0
    assert gate.status().cause.startswith("commanded but not moving")


RESTS = GateConfig().braking_time + GateConfig().moving_stop
"""[s] from a command of zero to the latch of a robot that moves on."""


@pytest.mark.parametrize(
    "velocity", [(0.06, 0.0, 0.0), (-0.35, 0.0, 0.0), (0.0, 0.06, 0.0), (0.0, 0.0, 0.12)]
)
@pytest.mark.parametrize("witnesses", ["both", "odometry", "wheels"])
def test_moving_without_a_command_latches_after_the_braking_time(velocity, witnesses: str):
    told = {"velocity": None if witnesses == "wheels" else velocity}
    if witnesses != "odometry":
        told["wheels"] = (math.hypot(*velocity[:2]), velocity[2])
    gate = SafetyGate(CAPS)
    _, now = run(gate, 0, 1.0, velocity=(0.5, 0.0, 0.0))
    # Braking is not an offence.
    _, now = run(gate, now, RESTS - 0.1, vx=0.0, **told)
    assert not gate.status().latched
    _, now = run(gate, now, 0.2, vx=0.0, **told)
    assert gate.status().cause.startswith("moving but not commanded: it moves by 0.")
    gate.resume()
    run(gate, now, RESTS + 0.1, vx=0.0, **told)
    assert gate.status().latched, "it moves still"


@pytest.mark.parametrize(
    ("velocity", "wheels"),
    [
        ((0.04, 0.0, 0.0), (0.04, 0.0)),
        ((0.25, 0.0, 0.0), (0.0, 0.0)),  # odometry drifts, or is dragged by what moves around it
        ((0.0, 0.0, 0.3), (0.0, 0.01)),
        ((0.0, 0.0, 0.0), (0.8, 0.0)),  # wheels in the air
        ((math.nan, 0.0, 0.0), (0.0, 0.0)),
    ],
)
def test_what_one_witness_alone_tells_is_no_motion(velocity, wheels):
    gate = SafetyGate(CAPS)
    _, now = run(gate, 0, 1.0)
    run(gate, now, 5.0, vx=0.0, velocity=velocity, wheels=wheels)
    assert not gate.status().latched


def test_a_robot_that_slides_or_is_carried_off_latches():
    gate = SafetyGate(CAPS)
    _, now = run(gate, 0, 1.0)
    run(gate, now, 3.0, vx=0.0, velocity=(0.0, 0.4, 0.0), wheels=(0.0, 0.0))
    assert gate.status().cause.startswith("moving but not commanded")


def test_sway_is_no_motion():
    gate = SafetyGate(CAPS)
    _, now = run(gate, 0, 1.0)
    for k in range(200):
        v = 0.15 * math.sin(2 * math.pi * k / 20)
        _, now = run(gate, now, 0.02, vx=0.0, velocity=(0.0, v, v), wheels=(v, v))
    assert not gate.status().latched


@pytest.mark.parametrize(
    ("speed", "lean", "latched"),
    [(-0.2, 0.15, False), (0.2, -0.15, False), (0.2, 0.15, True), (-0.35, 0.15, True), (-0.2, 0.04, True)],
)
def test_down_a_slope_it_creeps_and_the_operator_reads_it(speed: float, lean: float, latched: bool):
    gate = SafetyGate(CAPS)
    _, now = run(gate, 0, 1.0)
    run(gate, now, 3.0, vx=0.0, velocity=(speed, 0.0, 0.0), wheels=(speed, 0.0), lean=(lean, 0.0))
    assert gate.status().latched == latched
    assert latched or gate.status().creeps == pytest.approx(abs(speed))


@pytest.mark.parametrize(
    "reason",
    [
        {"state": RobotState(0, Phase.STANDING)},
        {"state": RobotState(0, Phase.READY, f"{FELT_EDGE} ahead")},
    ],
)
def test_a_posture_or_a_reflex_explains_motion(reason):
    gate = SafetyGate(CAPS)
    _, now = run(gate, 0, 1.0)
    run(gate, now, 5.0, vx=0.0, velocity=(-0.2, 0.0, 0.0), wheels=(-0.2, 0.0), **reason)
    assert not gate.status().latched


def test_without_the_monitor_nothing_moves_untold():
    gate = SafetyGate(CAPS)
    with taken_out(MOVES_UNTOLD.name):
        run(gate, 0, 5.0, vx=0.0, velocity=(0.5, 0.0, 0.0), wheels=(0.5, 0.0))
    assert not gate.status().latched


def test_the_fence_stops_what_leads_out_and_lets_the_robot_turn_and_come_back():
    fence = Fence.of([(0, 0), (4, 0), (4, 4), (0, 4)])
    gate = SafetyGate(CAPS, geofence=fence)
    out, now = run(gate, 0, 1.0, pose=(2.0, 2.0, 0.0))
    assert out.vx == 0.5
    # Its front is 0.09 m inside: no faster than it gets there in the horizon.
    out, now = run(gate, now, 1.0, wz=0.3, pose=(3.5, 2.0, 0.0))
    front = 4.0 - 3.5 - GateConfig().fence_margin
    assert out.vx == pytest.approx(front / 0.8)
    assert gate.status().hold == ""
    out, now = run(gate, now, 1.0, wz=0.3, pose=(3.6, 2.0, 0.0))
    assert out.vx == 0.0
    assert out.wz == pytest.approx(0.3)
    assert gate.status().hold == "geofence: the edge of the allowed area"
    out, now = run(gate, now, 1.0, pose=(4.3, 2.0, 0.0))
    assert out.vx == 0.0
    out, now = run(gate, now, 1.0, pose=(4.3, 2.0, math.pi))
    assert out.vx == 0.5
    out, now = run(gate, now, 1.0, vx=-0.4, pose=(4.3, 2.0, 0.0))
    assert out.vx == -0.4
    out, now = run(gate, now, 0.1, pose=None)
    assert out.vx == 0.0
    out, now = run(gate, now, 1.0, pose=(2.0, 2.0, 0.0))
    assert out.vx == 0.5
    for broken in ((math.nan, 2.0, 0.0), (2.0, math.inf, 0.0), (2.0, 2.0, math.nan)):
        out, now = run(gate, now, 0.1, pose=broken)
        assert out.vx == 0.0, broken


@pytest.mark.parametrize(
    "bad", [[], [(0, 0), (1, 1)], [(0, 0), (1, 1), (2, 2)], [(0, 0), (1, 0), (1, math.nan)], [1, 2, 3]]
)
def test_a_fence_without_an_area_is_refused(bad):
    with pytest.raises(GeofenceError):
        Geofence.of(bad)


@pytest.mark.parametrize(
    "crossed",
    [
        [(0, 0), (4, 4), (4, 0), (0, 3)],  # a bow tie
        [(0, 0), (4, 0), (4, 4), (2, 0), (0, 4)],  # a corner on another side
        [(0, 0), (4, 0), (2, 0), (2, 4)],  # a side that doubles back
        [(0, 0), (4, 0), (4, 4), (2, 2), (0, 4), (0, 1), (2, 2), (0, 0.5)],  # a corner twice
    ],
)
def test_a_fence_whose_sides_meet_is_refused(crossed):
    with pytest.raises(GeofenceError, match="sides of the geofence cross"):
        Geofence.of(crossed)


def test_a_fence_may_be_closed_by_hand_and_may_have_corners_along_a_side():
    fence = Geofence.of([(0, 0), (2, 0), (4, 0), (4, 4), (4, 4), (0, 4), (0, 0)])
    assert len(fence.corners) == 5
    assert fence.outside(1.0, 2.0) == -1.0
    dented = Geofence.of([(0, 0), (4, 0), (4, 4), (2, 1), (0, 4)])
    assert dented.outside(2.0, 2.0) > 0.0


def test_the_fence_keeps_the_corners_of_the_body_in():
    gate = SafetyGate(CAPS, geofence=Fence.of([(-9, -9), (2, -9), (2, 9), (-9, 9)]))
    for heading in np.radians(np.arange(-80.0, 81.0, 5.0)):
        gate.forget()
        x, now = 1.0, 0
        for k in range(1, 1000):
            now = k * TICK
            gate.command(VelocityCommand(now, vx=0.2), now)
            x += 0.02 * math.cos(heading) * gate.output(now, well(now, pose=(x, 0.0, float(heading)))).vx
        corner = x + 0.35 * math.cos(heading) + 0.215 * abs(math.sin(heading))
        assert 1.5 < corner < 2.0, heading


@given(st.floats(-2, 6), st.floats(-2, 6))
def test_fence_distance_of_a_square_is_exact(x: float, y: float):
    d = Geofence.of([(0, 0), (4, 0), (4, 4), (0, 4)]).outside(x, y)
    dx, dy = max(-x, x - 4, 0.0), max(-y, y - 4, 0.0)
    inside = min(x, 4 - x, y, 4 - y)
    expected = -inside if inside > 0 else math.hypot(dx, dy)
    assert d == pytest.approx(expected, abs=1e-9)


def test_a_clock_that_goes_back_stops_the_robot():
    gate = SafetyGate(CAPS)
    run(gate, 100 * NS, 1.0)
    gate.output(5 * NS, well(5 * NS))
    for k in range(20):
        assert gate.output(5 * NS + k * TICK, well(5 * NS + k * TICK)).vx == 0.0


_number = st.one_of(st.floats(-2.0, 2.0), st.sampled_from([math.nan, math.inf, 0.0, 1.0, -1.0]))
_event = st.one_of(
    st.tuples(
        st.just("command"),
        _number,
        _number,
        _number,
        st.integers(-400, 200),
        st.sampled_from(["base_link", "map"]),
    ),
    st.tuples(st.just("output"), st.integers(0, 300)),
    st.tuples(st.just("sick"), st.sampled_from(["tilt", "imu", "phase", "battery", "none"])),
    st.tuples(st.just("stop")),
    st.tuples(st.just("resume")),
)


@given(st.lists(_event, max_size=60))
@settings(max_examples=300, deadline=None)
def test_whatever_the_sequence_the_gate_keeps_its_promises(events):
    gate, now = SafetyGate(CAPS), NS
    fresh_until, latched, sick = 0, False, "none"
    last = VelocityCommand(0)
    last_now = now
    for event in events:
        match event:
            case ("command", vx, vy, wz, age_ms, frame):
                command = VelocityCommand(now + age_ms * MS, vx, vy, wz, frame)
                if gate.command(command, now) is None:
                    assert not latched
                    assert abs(vy) <= 1e-6
                    assert frame == "base_link"
                    assert abs(vx) <= 1.0 + 1e-6
                    fresh_until = min(command.stamp, now) + 200 * MS
            case ("output", ms):
                now += ms * MS
                inputs = well(now)
                if sick == "tilt":
                    inputs = replace(inputs, tilt=1.2)
                elif sick == "imu":
                    inputs = replace(inputs, stamps={**inputs.stamps, "imu": now - NS})
                elif sick == "phase":
                    inputs = replace(inputs, state=RobotState(now, Phase.STANDING))
                elif sick == "battery":
                    inputs = replace(inputs, state=RobotState(now, Phase.READY, battery=0.01))
                out = gate.output(now, inputs)
                latched = latched or sick in ("tilt", "battery")
                assert abs(out.vx) <= 1.0
                assert out.vy == 0.0
                assert abs(out.wz) <= 1.0
                assert out.frame == "base_link"
                assert out.stamp == now
                if latched or sick != "none" or now >= fresh_until:
                    assert (out.vx, out.vy, out.wz) == (0.0, 0.0, 0.0)
                dt = min((now - last_now) / NS, 0.1)
                assert abs(out.vx) <= abs(last.vx) + CAPS.max_accel * dt + 1e-6
                assert abs(out.wz) <= abs(last.wz) + CAPS.max_alpha * dt + 1e-6
                assert gate.status().latched == latched
                last, last_now = out, now
            case ("sick", what):
                sick = what
            case ("stop",):
                gate.stop()
                latched, fresh_until = True, 0
            case ("resume",):
                gate.resume()
                latched, fresh_until = False, 0


def test_tilt_follows_the_gyro_at_once_and_forgets_its_bias():
    tilt = TiltFilter()
    angle, bias = 0.0, 0.02
    for k in range(1000):
        rate = 0.8 if 400 <= k < 500 else 0.0  # 0.4 rad about x in 0.5 s
        angle += rate * 0.005
        accel = 9.81 * np.array([0.0, math.sin(angle), math.cos(angle)])
        tilt.update(ImuSample(k * 5 * MS, np.array([rate + bias, 0.0, 0.0]), accel))
        if k == 399:
            assert tilt.tilt == pytest.approx(0.0, abs=0.05)
        if k == 510:
            assert tilt.tilt == pytest.approx(0.4, abs=0.06)
    assert tilt.tilt == pytest.approx(0.4, abs=0.05)


def test_tilt_is_not_fooled_by_braking_or_shocks_or_nan():
    tilt = TiltFilter()
    zero = np.zeros(3)
    for k in range(100):
        tilt.update(ImuSample(k * 5 * MS, zero, np.array([0.0, 0.0, 9.81])))
    for k in range(100, 160):
        tilt.update(ImuSample(k * 5 * MS, zero, np.array([-4.0, 0.0, 9.81])))
    assert tilt.tilt is not None
    assert tilt.tilt < 0.12
    tilt.update(ImuSample(161 * 5 * MS, zero, np.array([80.0, 0.0, 9.81])))
    tilt.update(ImuSample(162 * 5 * MS, np.full(3, math.nan), np.zeros(3)))
    assert tilt.tilt < 0.12
    assert TiltFilter().tilt is None


def test_the_tilt_filter_is_the_one_written_with_vectors() -> None:
    random = np.random.default_rng(4)
    tilt, up, last = TiltFilter(), None, 0
    for k in range(400):
        gyro, accel = random.normal(0.0, 1.0, 3), np.array([0.0, 0.0, 9.81]) + random.normal(0.0, 3.0, 3)
        if k % 17 == 0:
            accel[1] = np.nan
        found = tilt.update(ImuSample(k * NS // 200, gyro, accel))
        norm = np.linalg.norm(accel)
        if np.isfinite(norm):
            if up is None:
                up = accel / norm
            else:
                dt = (k * NS // 200 - last) / NS
                up = up - dt * np.cross(gyro, up)
                if 0.5 * 9.81 < norm < 1.5 * 9.81:
                    up = up + dt / 2.0 * (accel / norm - up)
                up = up / np.linalg.norm(up)
            last = k * NS // 200
        assert found == (
            None if up is None else pytest.approx(float(np.arccos(np.clip(up[2], -1, 1))), abs=1e-9)
        )
