"""Streams that are fresh and wrong: what repeats, what cannot be, what the others contradict. Each check is taken out
once, to see that it is the one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hal.lidar import LIDARS
from hal.rotation import rotation_vector
from hal.safety import monitors
from hal.safety.monitors import Monitor, taken_out
from hal.types import NS, GroundTruth, ImuSample, JointSample, LidarName, LidarScan, Sample
from mapping.odometry.agreement import Handedness, Scale
from mapping.odometry.health import Health
from mapping.odometry.repeats import Repeats
from tests.mapping.odometry.test_pipeline import Driven, error
from tools.synthetic import SyntheticRun, arena_run
from tools.synthetic_motion import Motion

AT = 3 * NS
"""The fault begins this long after the start [ns]; the robot drives by then."""


@pytest.fixture(scope="module")
def recorded() -> tuple[SyntheticRun, list[Sample]]:
    """Figure-eight, XT16 with every eighth firing."""
    run = replace(arena_run("xt16", duration=6.0, seed=4), lidar=LIDARS["xt16"].decimated(8))
    return run, [s for s in run.samples() if not isinstance(s, GroundTruth)]


def frozen(samples: list[Sample], kind: type[Sample], seconds: float) -> list[Sample]:
    """The last sample of a kind before the fault again and again, with stamps that go on."""
    start = samples[0].stamp + AT
    last = [s for s in samples if isinstance(s, kind) and s.stamp <= start][-1]
    during = (start, start + round(seconds * NS))
    return [
        replace(last, stamp=s.stamp) if isinstance(s, kind) and during[0] < s.stamp <= during[1] else s
        for s in samples
    ]


def lost_after(out: Driven, start: int) -> float:
    """Seconds from `start` [ns] to the first `lost`; infinite without one."""
    return min(((s.stamp - start) / NS for s in out.scans if s.health is Health.LOST), default=np.inf)


def test_a_sound_stream_never_repeats(recorded: tuple[SyntheticRun, list[Sample]]) -> None:
    _, samples = recorded
    counters = Driven(samples).odometry.counters
    assert not [name for name in counters if name.endswith("repeated")]


def test_empty_sweeps_are_alike_and_no_repetition() -> None:
    stream = Repeats(monitors.LIDAR_REPEATS, "main")
    full, empty = np.ones(3), np.empty(0)
    assert not any(stream.dead(payload) for payload in (empty, empty, empty, full, full, empty, full))
    assert [stream.dead(full) for _ in range(2)] == [False, True]


def test_a_buffer_that_is_played_again_is_dead_and_a_sweep_that_comes_twice_is_not_used_twice() -> None:
    sweeps = [np.full(3, float(k)) for k in range(8)]
    stream = Repeats(monitors.LIDAR_REPEATS, "main")
    assert not any(stream.dead(sweep) for sweep in sweeps)
    assert [stream.dead(sweep) for sweep in sweeps[3:]] == [False, True, True, True, True]
    assert not stream.dead(np.full(3, 99.0))
    twice = Repeats(monitors.LIDAR_REPEATS, "main")
    told = [(twice.dead(sweep), twice.again) for sweep in np.repeat(sweeps, 2, axis=0)]
    assert told == [(False, False), (False, True)] * 8
    short = Repeats(monitors.IMU_PART_REPEATS, "gyro", memory=1)
    assert not any(short.dead(sweep) for sweep in sweeps * 20), (
        "three axes may well say what they said before"
    )
    assert [short.dead(sweeps[7]) for _ in range(26)] == [False] * 24 + [True] * 2


def test_sweeps_that_are_played_again_move_no_pose(recorded: tuple[SyntheticRun, list[Sample]]) -> None:
    """The last half second of a driver's buffer, with other intensities, in which a file or a ring may hold them."""
    run, samples = recorded
    start = samples[0].stamp + AT
    ring = [s for s in samples if isinstance(s, LidarScan) and s.stamp <= start][-5:]
    played: list[Sample] = []
    for s in samples:
        if isinstance(s, LidarScan) and s.stamp > start:
            points = ring[0].points.copy()
            points["intensity"] += len(played) % 7
            ring, s = [*ring[1:], ring[0]], replace(s, points=points)
        played.append(s)
    out = Driven(played)
    assert lost_after(out, start) <= 0.45
    assert error(run, out.scans, 10, -1)[0] < 0.1, "by wheels and gyro alone"


@pytest.mark.parametrize("part", ["gyro", "accelerometer"])
def test_a_dead_part_of_the_imu_is_lost(recorded: tuple[SyntheticRun, list[Sample]], part: str) -> None:
    _, samples = recorded
    start = samples[0].stamp + AT
    dead = {"gyro": {"gyro": np.zeros(3)}, "accelerometer": {"accel": np.array([0.3, 0.0, 9.8])}}[part]
    wrong = [replace(s, **dead) if isinstance(s, ImuSample) and s.stamp > start else s for s in samples]
    out = Driven(wrong)
    assert lost_after(out, start) <= 0.35
    reason = next(s.reason for s in out.scans if s.health is Health.LOST)
    assert reason.startswith(f"the {part} of the IMU repeats its value")
    with taken_out(monitors.IMU_PART_REPEATS.name):
        assert lost_after(Driven(wrong), start) > 0.45


def test_an_accelerometer_that_leads_from_the_wheels_does_not_carry_a_pose_that_no_scan_tells(
    recorded: tuple[SyntheticRun, list[Sample]],
) -> None:
    """It tells 5 m/s^2 ahead, which is no impossible direction of gravity. The wheels, too far off, are refused."""
    run, samples = recorded
    start = samples[0].stamp + AT
    wrong = [
        replace(s, accel=s.accel + np.array([5.0, 0.0, 0.0]))
        if isinstance(s, ImuSample) and s.stamp > start
        else s
        for s in samples
    ]
    out = Driven(wrong)
    assert max(error(run, out.scans, 10, k)[0] for k in range(len(out.scans))) < 0.6
    assert monitors.IMU_DISAGREES in monitors.raised("; ".join(s.reason for s in out.scans))
    with taken_out(monitors.IMU_DISAGREES.name):
        out = Driven(wrong)
        assert max(error(run, out.scans, 10, k)[0] for k in range(len(out.scans))) > 1.5


@pytest.mark.parametrize("unit", [0.65, pytest.param(1.45, marks=pytest.mark.campaign)])
def test_distances_in_another_unit_are_told(recorded: tuple[SyntheticRun, list[Sample]], unit: float) -> None:
    """The LiDAR's sweeps fit its own map, which is smaller or larger than the world."""
    motion = Motion(kind="straight", speed=0.5, start=(-2.5, 0.0, 0.0), pitch=0.0, roll=0.0, bob=0.0)
    run = replace(recorded[0], motion=motion, lidar=LIDARS["xt16"].decimated(16))

    def scaled(scan: LidarScan) -> LidarScan:
        points = scan.points.copy()
        for axis in "xyz":
            points[axis] *= unit
        return replace(scan, points=points)

    wrong = [
        scaled(s) if isinstance(s, LidarScan) else s for s in run.samples() if not isinstance(s, GroundTruth)
    ]
    out = Driven(wrong)
    good = [k for k, s in enumerate(out.scans) if s.health is Health.GOOD]
    assert max(error(run, out.scans, 0, k)[0] for k in good) < 0.35
    assert monitors.SCANS_SCALE in monitors.raised(out.scans[-1].reason)
    assert out.scans[-1].place_sigma > 0.5, "no goal is reached"
    with taken_out(monitors.SCANS_SCALE.name):
        out = Driven(wrong)
        assert error(run, out.scans, 0, -1)[0] > 0.5
        assert out.scans[-1].place_sigma < 0.1


def test_a_lidar_that_tells_left_for_right_is_lost_by_name(
    recorded: tuple[SyntheticRun, list[Sample]],
) -> None:
    def mirrored(scan: LidarScan) -> LidarScan:
        points = scan.points.copy()
        points["y"] *= -1.0
        return replace(scan, points=points)

    samples = recorded[1]
    wrong = [mirrored(s) if isinstance(s, LidarScan) else s for s in samples]
    told = [s.reason for s in Driven(wrong).scans if s.health is Health.LOST]
    assert told
    assert all("the main LiDAR tells left for right" in reason for reason in told)
    with taken_out(monitors.SCANS_MIRRORED.name):
        assert not any("left for right" in s.reason for s in Driven(wrong).scans)
    assert not any("left for right" in s.reason for s in Driven(samples).scans)


def test_scans_that_once_turned_as_the_gyro_did_are_not_asked_again() -> None:
    """Nor are turns that only one of the two tells a mirror: people who walk past, a turntable."""
    side = Handedness()

    def turn(gyro: float, scans: float, times: int, name: LidarName = "main") -> str:
        yaw = 0.0
        for _ in range(times):
            yaw += scans
            c, s = np.cos(yaw), np.sin(yaw)
            pose = np.eye(4)
            pose[:2, :2] = [[c, -s], [s, c]]
            side.add(name, pose, gyro)
        side.forget()
        return side.words

    assert not turn(0.05, 0.0, 20)
    assert not turn(0.0, -0.05, 20)
    assert not turn(-0.05, -0.05, 20)
    assert not turn(0.05, -0.05, 20)
    assert "the head LiDAR" in turn(0.05, -0.05, 20, "head")
    side = Handedness()
    assert not turn(0.15, -0.5, 20), "it was found elsewhere"
    side = Handedness()
    for _ in range(20):
        assert not turn(0.05, -0.05, 1), "a scan that fits after a gap tells no turn"


def test_wheels_that_all_spin_at_a_face_tell_no_unit() -> None:
    scale, here = Scale(), np.eye(4)
    for _ in range(50):
        scale.add(here, here, np.full(4, 0.05))
    assert not scale.words
    there, back = np.eye(4), np.eye(4)
    there[0, 3] = 0.02
    for _ in range(10):  # to and fro
        scale.add(back, there, np.full(4, 0.04))
        scale.add(there, back, np.full(4, -0.04))
    assert scale.words
    assert scale.unsure == pytest.approx(0.4, abs=0.05)
    for _ in range(24):
        scale.add(back, there, np.full(4, 0.02))
        assert scale.words
    for _ in range(24):
        scale.add(back, there, np.full(4, 0.02))
    assert not scale.words


@pytest.mark.parametrize(
    ("kind", "row", "seconds"),
    [(LidarScan, monitors.LIDAR_REPEATS, 0.45), (ImuSample, monitors.IMU_REPEATS, 0.25)],
)
def test_a_stream_that_repeats_is_lost_and_comes_back(
    recorded: tuple[SyntheticRun, list[Sample]], kind: type[Sample], row: Monitor, seconds: float
) -> None:
    run, samples = recorded
    start = samples[0].stamp + AT
    out = Driven(frozen(samples, kind, 1.0))
    assert lost_after(out, start) <= seconds
    lost = [s for s in out.scans if s.health is Health.LOST and s.stamp < start + NS]
    assert all(row in monitors.raised(s.reason) for s in lost)
    assert out.scans[-1].health is Health.GOOD
    assert error(run, out.scans, 10, -1)[0] < 0.05
    with taken_out(row.name, monitors.IMU_PART_REPEATS.name):
        assert lost_after(Driven(frozen(samples, kind, 1.0)), start) > 0.9


def test_joints_that_repeat_are_told_and_not_believed(recorded: tuple[SyntheticRun, list[Sample]]) -> None:
    run, samples = recorded
    start = samples[0].stamp + AT
    out = Driven(frozen(samples, JointSample, 1.5))
    during = [s for s in out.scans if start + NS // 4 < s.stamp < start + 3 * NS // 2]
    assert all(s.health is Health.DEGRADED for s in during)
    assert all(monitors.JOINTS_REPEAT in monitors.raised(s.reason) for s in during)
    assert error(run, out.scans, 10, -1)[0] < 0.03
    with taken_out(monitors.JOINTS_REPEAT.name):
        out = Driven(frozen(samples, JointSample, 1.5))
    assert not any(monitors.JOINTS_REPEAT in monitors.raised(s.reason) for s in out.scans)
    assert Health.GOOD in {s.health for s in out.scans if start + NS // 4 < s.stamp < start + 3 * NS // 2}


def test_an_impossible_speed_is_lost_at_once_and_does_not_carry_the_pose(
    recorded: tuple[SyntheticRun, list[Sample]],
) -> None:
    run, samples = recorded
    start = samples[0].stamp + AT
    shoved = [
        replace(s, accel=s.accel + np.array([120.0, 0.0, 0.0]))
        if isinstance(s, ImuSample) and start < s.stamp <= start + NS // 10
        else s
        for s in samples
    ]
    out = Driven(shoved)
    assert lost_after(out, start) <= 0.2
    lost = [s for s in out.scans if s.health is Health.LOST]
    assert monitors.IMPOSSIBLE_SPEED in monitors.raised(lost[0].reason)
    assert max(np.linalg.norm(s.linear) for s in out.scans) < 2.0
    assert out.scans[-1].health is Health.GOOD
    assert error(run, out.scans, 10, -1)[0] < 0.05
    with taken_out(monitors.IMPOSSIBLE_SPEED.name, monitors.IMU_DISAGREES.name):
        assert max(np.linalg.norm(s.linear) for s in Driven(shoved).scans) > 4.0


def spun(samples: list[Sample], wheels: slice) -> list[Sample]:
    """For two seconds `wheels` turn faster by 0.7 m/s."""
    start = samples[0].stamp + AT
    out = []
    for s in samples:
        if isinstance(s, JointSample) and start < s.stamp <= start + 2 * NS:
            rate = s.velocity.copy()
            rate[12:][wheels] += 8.0
            s = replace(s, velocity=rate)
        out.append(s)
    return out


def test_wheels_that_spin_are_told_within_a_second(recorded: tuple[SyntheticRun, list[Sample]]) -> None:
    run, samples = recorded
    start = samples[0].stamp + AT
    out = Driven(spun(samples, slice(None)))
    told = [s.stamp for s in out.scans if monitors.SCANS_DISAGREE in monitors.raised(s.reason)]
    assert start < told[0] <= start + 1.0 * NS
    assert {s.health for s in out.scans if s.stamp in told} == {Health.DEGRADED}
    assert error(run, out.scans, 10, -1)[0] < 0.03
    with taken_out(monitors.SCANS_DISAGREE.name, monitors.SCANS_SCALE.name):
        assert {s.health for s in Driven(spun(samples, slice(None))).scans if s.stamp in told} == {
            Health.GOOD
        }


def test_wheels_of_which_one_does_not_spin_agree_with_the_scans(
    recorded: tuple[SyntheticRun, list[Sample]],
) -> None:
    """As at a face that is climbed: three spin, the fourth rolls with the robot."""
    run, samples = recorded
    out = Driven(spun(samples, slice(1, None)))
    assert not any(monitors.SCANS_DISAGREE in monitors.raised(s.reason) for s in out.scans)
    assert error(run, out.scans, 10, -1)[0] < 0.03


def standing(run: SyntheticRun, seconds: float, change: Callable[[float], float]) -> list[Sample]:
    """A robot whose wheels and gyro stand, and what it sees from `change(t)` [m] further ahead, `t` [s] after the
    start."""
    still = replace(run, motion=Motion(kind="standstill"), duration=seconds)
    proprioception = [s for s in still.samples() if isinstance(s, ImuSample | JointSample)]
    x, y, yaw = still.motion.start
    out: list[Sample] = [*proprioception]
    ahead = np.array([np.cos(yaw), np.sin(yaw)])
    for k in range(round(seconds * 10) - 1):
        there = np.array([x, y]) + change(0.1 * k) * ahead
        motion = Motion(kind="standstill", start=(float(there[0]), float(there[1]), yaw))
        stamp = still.start_stamp + k * NS // 10
        seen = replace(still, motion=motion, start_stamp=stamp, duration=0.12)
        out += [s for s in seen.samples() if isinstance(s, LidarScan)][:1]
    return sorted(out, key=lambda s: s.stamp + (NS // 10 if isinstance(s, LidarScan) else 0))


def test_a_robot_whose_floor_moves_is_noticed(recorded: tuple[SyntheticRun, list[Sample]]) -> None:
    """Wheels and gyro stand still; after two seconds all that the LiDAR sees goes by at 0.25 m/s."""
    run, _ = recorded
    samples = standing(run, 6.0, lambda t: 0.25 * max(t - 2.0, 0.0))
    start = samples[0].stamp + 2 * NS
    out = Driven(samples)
    told = [s.stamp for s in out.scans if monitors.MOVED_WHILE_STILL in monitors.raised(s.reason)]
    assert told
    assert told[0] < start + 2 * NS
    assert {s.health for s in out.scans if s.stamp in told} == {Health.DEGRADED}
    moved = float(np.linalg.norm((out.scans[-1].position - out.scans[0].position)[:2]))
    assert moved == pytest.approx(
        0.25 * (out.scans[-1].stamp - start) / NS, abs=0.1
    )  # not held where it is not
    with taken_out(monitors.MOVED_WHILE_STILL.name):
        held = Driven(samples)
    assert np.linalg.norm((held.scans[-1].position - held.scans[0].position)[:2]) < 0.02


def test_a_gyro_that_drifts_does_not_turn_a_robot_that_stands(
    recorded: tuple[SyntheticRun, list[Sample]],
) -> None:
    """Its bias walks by 0.3 deg/s within a minute, on ground where no scan tells the heading."""
    run, _ = recorded
    still = replace(run, motion=Motion(kind="standstill"), duration=30.0, lidar=LIDARS["xt16"].decimated(24))
    samples = []
    for s in still.samples():
        if isinstance(s, ImuSample):
            t = (s.stamp - still.start_stamp) / NS
            s = replace(s, gyro=s.gyro + np.array([0.0, 0.0, np.radians(0.3) * t / 60.0]))
        elif isinstance(s, LidarScan):
            s = LidarScan(s.stamp, s.points[s.points["z"] < -0.45])
        if not isinstance(s, GroundTruth):
            samples.append(s)
    out = Driven(samples)
    turned = rotation_vector(_turn(out, -1).T @ _turn(out, 0))
    assert np.degrees(np.abs(turned[2])) < 0.3
    assert np.linalg.norm((out.scans[-1].position - out.scans[0].position)[:2]) < 0.01


@pytest.mark.parametrize(
    ("turned", "follows"),
    [
        pytest.param(lambda t: 0.018 * max(t - 3.0, 0.0), True, id="tyres give way"),
        pytest.param(lambda t: 1.2 if t % 4.0 > 2.5 else 0.0, False, id="people walk past"),
    ],
)
def test_scans_turn_a_robot_that_stands_as_slowly_as_tyres_give_way(
    recorded: tuple[SyntheticRun, list[Sample]], turned: Callable[[float], float], follows: bool
) -> None:
    """Wheels and gyro stand still, what the LiDAR sees turns by `turned(t)` [deg], `t` [s] after the start."""
    run, _ = recorded
    still = replace(run, motion=Motion(kind="standstill"), duration=18.0, lidar=LIDARS["xt16"].decimated(24))
    samples: list[Sample] = []
    for s in still.samples():
        if isinstance(s, LidarScan):
            angle = np.radians(turned((s.stamp - still.start_stamp) / NS))
            points = s.points.copy()
            points["x"] = np.cos(angle) * s.points["x"] + np.sin(angle) * s.points["y"]
            points["y"] = np.cos(angle) * s.points["y"] - np.sin(angle) * s.points["x"]
            s = replace(s, points=points)
        if not isinstance(s, GroundTruth):
            samples.append(s)
    out = Driven(samples)
    yaw = [np.degrees(rotation_vector(_turn(out, 0).T @ _turn(out, k))[2]) for k in range(len(out.scans))]
    if follows:
        assert yaw[-1] == pytest.approx(turned(18.0), abs=0.06)
    else:
        assert np.abs(yaw).max() < 0.1


def _turn(out: Driven, k: int) -> np.ndarray:
    from hal.rotation import rotation

    return rotation(out.scans[k].orientation)
