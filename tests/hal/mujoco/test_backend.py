"""The simulated robot beyond the contract: reproducible, honest sensors, faults with reasons, obstacles, delays."""

from __future__ import annotations

import hashlib
from typing import Any

import mujoco
import numpy as np
import pytest
from pydantic import ValidationError

from hal.contract import BackendError
from hal.lidar.config import only
from hal.mujoco.backend import MujocoBackend, Obstacle, Push, SimConfig
from hal.robots import describe
from hal.rotation import rotation_rpy
from hal.scenes import Scene
from hal.types import (
    NS,
    Extrinsics,
    GroundTruth,
    ImuSample,
    JointSample,
    LidarScan,
    ModeRequest,
    MountedLidar,
    Phase,
    PostureCommand,
    RobotState,
    Sample,
    VelocityCommand,
)
from tests.places import cases


def floor(slope: float = 0.0) -> Scene:
    """12 x 12 m, rising along x, with walls of 0.8 m around."""
    height = np.tile(slope * (np.arange(241) * 0.05 - 6.0), (241, 1)).astype(np.float32)
    wall = np.ones_like(height, bool)
    wall[6:-6, 6:-6] = False
    height[wall] += 0.8
    return Scene("floor", height, 0.05, (-6.0, -6.0), (-1.0, 0.0, 0.0), {})


class Robot:
    """A connected backend and its clock. Without LiDAR unless asked: most tests need none."""

    def __init__(self, scene: Scene | None = None, **options: Any) -> None:
        self.backend = MujocoBackend(scene or floor(), **{"lidars": (), **options})
        self.backend.connect()
        self.now = self.backend.start_time
        self.samples: list[Sample] = []

    def run(self, seconds: float, vx: float = 0.0, wz: float = 0.0, step: int = 5_000_000) -> list[Sample]:
        end = self.now + round(seconds * NS)
        new: list[Sample] = []
        self.backend.drive(VelocityCommand(self.now, vx, 0.0, wz))
        while self.now < end:
            self.now = min(self.now + step, end)
            new += self.backend.read(self.now)
        self.samples += new
        return new

    def tip_over(self, roll: float) -> None:
        """Lay the robot down from above with the trunk rolled [rad]."""
        sim = self.backend.simulation
        sim.data.qpos[2] += 0.25
        sim.data.qpos[3:7] = [np.cos(roll / 2), np.sin(roll / 2), 0.0, 0.0]
        sim.data.qvel[:] = 0.0
        mujoco.mj_forward(sim.model, sim.data)
        self.backend.placed()

    @property
    def phase(self) -> Phase:
        return self.backend.state().phase

    @property
    def cause(self) -> str:
        return self.backend.state().cause


def of(samples: list[Sample], kind: type) -> list[Any]:
    return [s for s in samples if isinstance(s, kind)]


def digest(samples: list[Sample]) -> str:
    """One hash over every bit of every sample."""
    h = hashlib.sha256()
    for sample in samples:
        h.update(type(sample).__name__.encode())
        for name in type(sample).__slots__:
            value = getattr(sample, name)
            h.update(value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode())
    return h.hexdigest()


# --- reproducible ---------------------------------------------------------------------------------------------------


def drive_around(seed: int, step: int) -> tuple[list[Sample], Robot]:
    r = Robot(
        lidars=only("xt16"), lidar_step=20, seed=seed, imu_delay=0.003, lidar_delay=0.02, friction_spread=0.1,
        pushes=(Push(1.0, (0.0, 60.0, 0.0)),),
    )  # fmt: skip
    for vx, wz in ((0.0, 0.0), (0.5, 0.0), (0.2, 0.5), (0.0, 0.0)):
        r.run(0.6, vx, wz, step)
    return r.samples, r


def test_the_same_seed_gives_the_same_bytes_however_reading_is_chunked() -> None:
    fine, _ = drive_around(3, 5_000_000)
    again, _ = drive_around(3, 5_000_000)
    coarse, _ = drive_around(3, 37_000_001)
    assert len(fine) > 500
    assert digest(fine) == digest(again)
    assert digest(fine) == digest(coarse)


def test_another_seed_gives_other_noise_and_another_friction() -> None:
    one, a = drive_around(3, 50_000_000)
    two, b = drive_around(4, 50_000_000)
    assert digest(one) != digest(two)
    assert a.backend.friction != b.backend.friction
    assert abs(a.backend.friction - 0.8) <= 0.1


def test_connecting_again_starts_over_identically() -> None:
    r = Robot(noise=True)
    first = r.run(0.5, vx=0.3)
    r.backend.close()
    r.backend.connect()
    r.now = 0
    assert digest(r.run(0.5, vx=0.3)) == digest(first)


# --- sensors --------------------------------------------------------------------------------------------------------


def test_rates_and_stamps() -> None:
    samples = Robot(lidars=only("xt16"), lidar_step=50).run(2.0)
    expected = {ImuSample: 401, JointSample: 101, GroundTruth: 101, LidarScan: 20}
    for kind, count in expected.items():
        stamps = np.array([s.stamp for s in of(samples, kind)])
        assert len(stamps) == count, kind.__name__
        assert len(set(np.diff(stamps))) == 1, kind.__name__
    assert 20 <= len(of(samples, RobotState)) <= 26


def test_state_is_told_at_once_when_it_changes() -> None:
    r = Robot()
    r.run(1.0)
    states = of(r.run(0.05, vx=0.3), RobotState)
    assert states[0].phase is Phase.MOVING
    assert states[0].stamp <= 1.015 * NS


def test_without_noise_the_imu_reads_gravity_and_the_joints_read_truth() -> None:
    r = Robot(noise=False)
    r.run(2.0)
    samples = r.run(0.5)
    imu = of(samples, ImuSample)
    np.testing.assert_allclose(np.mean([s.accel for s in imu], axis=0), [0, 0, 9.81], atol=0.12)
    np.testing.assert_allclose(of(samples, JointSample)[-1].position, r.backend.simulation.low_state().q)


def test_noise_has_the_stated_size() -> None:
    r = Robot(noise=True)
    r.run(2.0)
    imu = of(r.run(2.0), ImuSample)
    gyro, accel = (np.array([getattr(s, name) for s in imu]) for name in ("gyro", "accel"))
    assert 0.001 < gyro[:, 2].std() < 0.01
    assert 0.04 < accel[:, 1].std() < 0.2
    assert 0.0 < np.abs(gyro.mean(axis=0)).max() < 0.01


def test_the_gyro_integrates_to_the_true_turn() -> None:
    r = Robot(noise=False)
    r.run(1.0)
    samples = r.run(2.0, wz=0.6)
    turned = sum(s.gyro[2] for s in of(samples, ImuSample)) * 0.005
    truth = of(samples, GroundTruth)
    yaw = [2.0 * np.arctan2(t.orientation[2], t.orientation[3]) for t in (truth[0], truth[-1])]
    assert turned == pytest.approx(yaw[1] - yaw[0], abs=0.03)
    assert turned > 0.8


def test_true_velocity_is_that_of_the_true_position() -> None:
    r = Robot(floor(0.15), start=(-2.0, 0.0, 0.6))
    r.run(1.0, vx=0.4)
    truth = of(r.run(1.0, vx=0.4), GroundTruth)
    moved = np.linalg.norm(truth[-1].position - truth[0].position)
    speed = np.mean([np.linalg.norm(t.linear) for t in truth])
    assert moved == pytest.approx(speed * 1.0, rel=0.05)
    forward = np.mean([t.linear[0] for t in truth])
    assert forward > 0.9 * speed, "expressed in base_link"


def test_delays_hold_samples_back_but_not_their_stamps() -> None:
    r = Robot(lidars=only("xt16"), lidar_step=50, imu_delay=0.013, joint_delay=0.03, lidar_delay=0.05)
    seen = set()
    for _ in range(200):
        for sample in r.run(0.005):
            seen.add(type(sample))
            late = (r.now - sample.stamp) / NS
            if isinstance(sample, ImuSample):
                assert 0.013 <= late <= 0.0181
            elif isinstance(sample, JointSample):
                assert 0.030 <= late <= 0.0351
            elif isinstance(sample, LidarScan):
                assert 0.150 <= late <= 0.1551
    assert seen >= {ImuSample, JointSample, LidarScan}


def test_the_clock_may_start_anywhere() -> None:
    start = 1_700_000_000 * NS + 3
    samples = Robot(start_time=start, lidars=only("xt16"), lidar_step=50).run(0.5)
    assert of(samples, ImuSample)[0].stamp == start
    assert start <= of(samples, LidarScan)[0].stamp < start + NS // 10


def test_the_lidar_moves_with_the_robot_during_a_sweep() -> None:
    """The wall behind a driving robot recedes within one sweep."""
    r = Robot(lidars=only("xt16"), lidar_step=1, noise=False, start=(0.0, 0.0, 0.0))
    r.run(1.5, vx=1.0)
    scan = of(r.run(0.25, vx=1.0), LidarScan)[-1].points
    ring = scan[scan["ring"] == 8]
    # A sweep starts and ends at the sensor's +y, which is the robot's rear: that wall is seen twice, 0.1 s apart.
    rear = ring[(np.abs(ring["x"]) < 0.5) & (ring["y"] > 1.0)]
    first, last = rear[rear["time"] < 0.02], rear[rear["time"] > 0.08]
    gap = float(np.mean(last["time"]) - np.mean(first["time"]))
    assert gap > 0.08
    drift = float(np.mean(last["y"])) - float(np.mean(first["y"]))
    assert drift == pytest.approx(0.9 * gap, rel=0.25)


# --- obstacles, pushes, payload, friction ----------------------------------------------------------------------------


def points_in(
    scan: LidarScan, backend: MujocoBackend, low: tuple[float, ...], high: tuple[float, ...]
) -> int:
    """How many returns of a standing robot lie in a box of the world."""
    p = scan.points
    mount = backend.capabilities.lidars[0].mount
    c, s = np.cos(mount.rpy[2]), np.sin(mount.rpy[2])
    body = np.stack([c * p["x"] - s * p["y"], s * p["x"] + c * p["y"], p["z"]], axis=1) + mount.translation
    sim = backend.simulation
    world = body @ sim.rotation.T + sim.position
    return int(((world > low) & (world < high)).all(axis=1).sum())


def test_an_obstacle_is_seen_from_when_it_appears_until_it_goes() -> None:
    box = Obstacle((1.5, 0.0, 0.4), (0.4, 0.8, 0.8), appear=1.0, disappear=2.0)
    r = Robot(lidars=only("xt16"), lidar_step=10, obstacles=(box,))
    seen = []
    for _ in range(30):
        for scan in of(r.run(0.1), LidarScan):
            count = points_in(scan, r.backend, (1.25, -0.5, 0.1), (1.75, 0.5, 0.9))
            seen.append((scan.stamp / NS, count))
    assert all(n == 0 for t, n in seen if t < 0.85 or t > 2.05)
    assert all(n > 20 for t, n in seen if 1.05 < t < 1.85)


def test_a_moving_obstacle_moves_for_the_lidar_and_blocks_the_robot() -> None:
    box = Obstacle((0.3, 2.0, 0.4), (0.3, 0.6, 0.8), velocity=(0.0, -1.0), appear=0.5, disappear=2.5)
    r = Robot(lidars=only("xt16"), lidar_step=10, obstacles=(box,))
    r.run(2.4)
    scan = of(r.run(0.1), LidarScan)[-1]
    assert points_in(scan, r.backend, (0.1, -0.3, 0.1), (0.5, 0.5, 0.9)) > 20
    wall = Obstacle((0.2, 0.0, 0.4), (0.3, 2.0, 0.8))
    blocked = Robot(obstacles=(wall,))
    blocked.run(4.0, vx=0.4)
    assert blocked.backend.simulation.position[0] < -0.2


def test_a_payload_is_carried() -> None:
    r = Robot(payload=3.0)
    r.run(3.0, vx=0.5)
    assert r.phase is Phase.MOVING
    assert r.backend.simulation.position[0] > -0.2


@pytest.mark.parametrize("slope", [0.0, np.tan(np.radians(20.0))])
def test_zero_command_holds_the_robot_still(slope: float) -> None:
    r = Robot(floor(slope), start=(-1.0, 0.0, 0.5))
    r.run(1.0)
    r.run(1.0, vx=0.3)
    r.run(3.0)
    place = r.backend.simulation.position
    r.run(10.0, step=100_000_000)
    assert np.linalg.norm(r.backend.simulation.position - place) < 0.01


# --- modes and faults -------------------------------------------------------------------------------------------------


def test_seated_start_waits_for_stand_and_gets_up_on_a_slope() -> None:
    r = Robot(floor(0.25), seated=True)
    r.run(1.0, vx=0.5)
    assert r.phase is Phase.SITTING
    r.backend.request(ModeRequest.STAND)
    r.run(0.1)
    assert r.phase is Phase.STANDING
    r.run(5.0)
    assert r.phase is Phase.READY
    assert r.backend.simulation.rotation[2, 2] > 0.97
    assert all(name.endswith("wheel") for name in r.backend.simulation.contacts().bodies)


def test_a_fall_is_a_fault_that_says_what_to_do() -> None:
    r = Robot()
    r.run(1.0)
    r.tip_over(np.pi / 2)
    r.run(1.0, vx=0.5)
    assert r.phase is Phase.FAULT
    assert "fallen" in r.cause
    assert "recover" in r.cause
    r.backend.request(ModeRequest.STAND)
    r.run(0.5)
    assert r.phase is Phase.FAULT
    assert "stand refused" in r.cause
    assert np.abs(r.backend.simulation.low_state().dq[12:]).max() < 0.5, "a fallen robot does not drive"


@pytest.mark.parametrize("roll", [90.0, pytest.param(-90.0, marks=pytest.mark.campaign), 180.0])
def test_recover_turns_a_fallen_robot_over_and_stands_it_up(roll: float) -> None:
    r = Robot()
    r.run(0.8)
    r.tip_over(np.radians(roll))
    r.run(1.5)
    assert r.phase is Phase.FAULT
    r.backend.request(ModeRequest.RECOVER)
    for _ in range(60):
        r.run(0.5)
        if r.phase in (Phase.READY, Phase.FAULT):
            break
    assert r.phase is Phase.READY, r.cause
    place = r.backend.simulation.position[:2]
    r.run(2.0, vx=0.4)
    assert np.linalg.norm(r.backend.simulation.position[:2] - place) > 0.4


@pytest.mark.parametrize("seed", [6, *(pytest.param(seed, marks=pytest.mark.campaign) for seed in (10, 16))])
def test_recover_gets_up_from_random_attitudes_on_a_slope_of_15_degrees(seed: int) -> None:
    n = 601
    height = np.tile(np.tan(np.radians(15.0)) * (np.arange(n) - 300) * 0.05, (n, 1)).astype(np.float32)
    scene = Scene("slope", height, 0.05, (-15.0, -15.0), (0.0, 0.0, 0.0), {})
    rng = np.random.default_rng(seed)
    place, quaternion = rng.uniform(-0.5, 0.5, 2), rng.normal(size=4)
    r = Robot(scene, noise=False)
    sim = r.backend.simulation
    sim.data.qpos[:2] = place
    sim.data.qpos[2] = sim.ground(*place) + 0.55
    sim.data.qpos[3:7] = quaternion / np.linalg.norm(quaternion)
    sim.data.qvel[:] = 0.0
    mujoco.mj_forward(sim.model, sim.data)
    r.backend.request(ModeRequest.DAMP)
    r.run(2.0)
    r.backend.request(ModeRequest.RECOVER)
    r.run(0.1)
    assert r.phase is Phase.STANDING
    for _ in range(70):
        r.run(0.5)
        if r.phase is not Phase.STANDING:
            break
    assert r.phase is Phase.READY, r.cause


def test_a_robot_that_cannot_turn_over_says_so() -> None:
    """Wedged between two walls on its back, it must give up and ask for help."""
    walls = (
        Obstacle((-1.0, 0.27, 0.4), (3.0, 0.1, 0.8), appear=1.0),
        Obstacle((-1.0, -0.27, 0.4), (3.0, 0.1, 0.8), appear=1.0),
        Obstacle((-1.0, 0.0, 0.42), (3.0, 0.5, 0.04), appear=2.5),
    )
    r = Robot(obstacles=walls)
    r.run(0.8)
    r.tip_over(np.pi)
    r.run(2.0)
    r.backend.request(ModeRequest.RECOVER)
    for _ in range(80):
        r.run(0.5)
        if r.phase is Phase.FAULT and "turn itself over" in r.cause:
            break
    assert r.phase is Phase.FAULT
    assert "by hand" in r.cause or "put it on its wheels" in r.cause


def test_damp_always_works_and_recover_leads_out_of_a_fault() -> None:
    r = Robot()
    r.run(1.0)
    r.backend.request(ModeRequest.DAMP)
    r.run(1.0)
    assert r.phase is Phase.DAMPED
    assert r.backend.simulation.position[2] < 0.3, "it sinks"
    r.backend.request(ModeRequest.RECOVER)
    r.run(5.0)
    assert r.phase is Phase.READY


def test_sit_at_speed_brakes_first() -> None:
    r = Robot()
    r.run(2.0, vx=0.8)
    r.backend.request(ModeRequest.SIT)
    r.run(6.0, vx=0.8)
    assert r.phase is Phase.SITTING
    assert r.cause == "seated"
    assert r.backend.simulation.rotation[2, 2] > 0.95


def test_a_shove_that_throws_it_over_ends_in_a_fault() -> None:
    r = Robot(pushes=(Push(1.0, (0.0, 900.0, 300.0), 0.2),))
    r.run(3.0)
    assert r.phase is Phase.FAULT
    assert "fallen" in r.cause


def test_leaving_the_terrain_is_a_fault() -> None:
    cliff = Scene("cliff", np.zeros((61, 61), np.float32), 0.05, (-1.5, -1.5), (0.8, 0.0, 0.0), {})
    r = Robot(cliff)
    r.run(1.0)
    r.run(4.0, vx=1.0)
    assert r.phase is Phase.FAULT
    assert r.cause == "left the terrain of scene cliff; restart the simulation"


def test_at_a_cliff_it_says_why_it_does_not_go_on() -> None:
    x = np.broadcast_to(np.arange(121) * 0.05 - 3.0, (121, 121))
    r = Robot(
        Scene(
            "edge", np.where(x > 1.0, -0.5, 0.0).astype(np.float32), 0.05, (-3.0, -3.0), (0.6, 0.0, 0.0), {}
        )
    )
    r.run(1.0)
    r.run(5.0, vx=0.1)
    assert r.phase is Phase.MOVING
    assert r.cause.startswith("cliff: an edge ahead")
    r.run(1.0)
    assert (r.phase, r.cause[:5]) == (Phase.READY, "cliff"), "it stays drawn back"
    before = r.backend.simulation.position[0]
    r.run(2.0, vx=-0.2)
    assert r.cause == "driving"
    assert r.backend.simulation.position[0] < before - 0.25


def test_divergence_is_a_fault() -> None:
    r = Robot()
    r.run(1.0)
    r.backend.simulation.data.qvel[3] = np.nan
    r.run(0.1)
    assert r.phase is Phase.FAULT
    assert "diverged" in r.cause


# --- refusals ---------------------------------------------------------------------------------------------------------


def test_bad_use_is_refused_in_words() -> None:
    with pytest.raises(ValidationError, match="'xt16', 'vlp16', 'mid360' or 'l1'"):
        only("xt99")
    far = MujocoBackend(floor(), lidars=(), start=(99.0, 0.0, 0.0))
    with pytest.raises(BackendError, match="outside scene floor"):
        far.connect()
    r = Robot()
    with pytest.raises(BackendError, match="must be finite"):
        r.backend.drive(VelocityCommand(0, float("nan")))
    with pytest.raises(BackendError, match="clock jumped"):
        r.backend.read(10 * NS)


def test_options_come_from_plain_values_and_name_what_is_wrong() -> None:
    obstacles: Any = [{"centre": [1, 0, 0.2], "size": [0.2, 0.2, 0.4]}]
    config = SimConfig(payload=2, obstacles=obstacles)
    assert config.obstacles[0] == Obstacle((1.0, 0.0, 0.2), (0.2, 0.2, 0.4))
    for values, word in (
        ({"paylod": 2}, "paylod"),
        ({"timestep": 0.0}, "timestep"),
        ({"seed": 3}, "seed"),
        ({"pushes": [{"time": 1.0}]}, "force"),
    ):
        with pytest.raises(ValidationError, match=word):
            SimConfig.model_validate(values)


@pytest.mark.parametrize("seed", cases(4, 2))
def test_any_sequence_of_requests_leaves_a_defined_state_with_a_reason(seed: int) -> None:
    """Requests, commands and shoves at random times: no exception, no NaN, always a phase and its cause."""
    rng = np.random.default_rng(seed)
    r = Robot(seated=bool(seed % 2))
    for _ in range(40):
        action = rng.integers(0, 10)
        if action < 6:
            r.backend.request(list(ModeRequest)[action])
        elif action == 6:
            force = rng.uniform(-300, 300, 2)
            r.backend.push((float(force[0]), float(force[1]), 0.0), 0.15)
        elif action == 7:
            r.backend.posture(PostureCommand(r.now, float(rng.uniform(0.2, 0.5)), *rng.uniform(-0.3, 0.3, 2)))
        samples = r.run(float(rng.uniform(0.02, 0.6)), *rng.uniform(-1, 1, 2))
        for sample in of(samples, JointSample):
            assert np.isfinite(sample.position).all()
        assert r.phase in Phase
        assert r.cause
    if r.phase in (Phase.READY, Phase.MOVING):
        assert r.backend.simulation.rotation[2, 2] > 0.5
    r.backend.request(ModeRequest.DAMP)
    r.run(0.1)
    assert r.phase is Phase.DAMPED, "damp works from everywhere"


def test_stop_from_full_speed_comes_to_rest_soon() -> None:
    r = Robot()
    r.run(2.5, vx=1.0)
    r.backend.request(ModeRequest.STOP)
    before = r.backend.simulation.position
    r.run(2.0, vx=1.0)
    assert r.phase is Phase.STOPPED
    assert np.linalg.norm(r.backend.simulation.position - before) < 0.5
    assert np.linalg.norm(r.backend.simulation.linear_velocity) < 0.05


def test_capabilities_tell_the_lidar_and_its_mount() -> None:
    mount = Extrinsics((0.1, 0.0, 0.2), (0.0, 0.1, 0.0))
    backend = MujocoBackend(floor(), lidars=only("mid360", mount))
    assert backend.capabilities.lidars == (MountedLidar("main", "mid360", mount),)


def test_what_hides_rays_is_the_body_of_the_robot_that_carries_the_lidar() -> None:
    """An L1 low in the front of a robot without a head sees the ground in front of it."""
    mount = Extrinsics((0.20, 0.0, 0.06), (0.0, 2.8782, 0.0))
    r = Robot(robot=describe("jackal"), controller="drive", lidars=only("l1", mount))
    points = next(s.points for s in r.run(0.3) if isinstance(s, LidarScan))
    seen = np.stack([points[axis] for axis in "xyz"], axis=1) @ rotation_rpy(*mount.rpy).T
    x, y, z = (seen + mount.translation).T
    assert np.count_nonzero((x > 0.5) & (x < 0.75) & (np.abs(y) < 0.3) & (z < 0.0)) > 60


def test_people_walk_past_and_step_aside_the_same_ones_for_a_seed() -> None:
    from hal.mujoco.people import LEAST_ROOM, People

    first, again, other = People(5, 3), People(5, 3), People(5, 4)
    nearest, places = np.inf, []
    for k in range(3000):
        robot = (0.002 * k, 0.0)
        boxes = first.at(0.01 * k, robot)
        assert boxes == again.at(0.01 * k, robot)
        assert boxes != other.at(0.01 * k, robot)
        places.append([box.centre[:2] for box in boxes])
        nearest = min(nearest, *(np.hypot(x - robot[0], y - robot[1]) for x, y in places[-1]))
    ways = np.linalg.norm(np.diff(np.array(places), axis=0), axis=2)
    assert nearest >= LEAST_ROOM - 1e-9
    assert nearest < 1.5
    assert (np.median(ways, axis=0) > 0.004).all()


def test_the_lidar_sees_people_and_solid_obstacles_but_no_clear_ones() -> None:
    obstacles = (
        Obstacle((1.0, 0.0, 0.5), (0.1, 0.6, 1.0), clear=True),
        Obstacle((-1.0, 2.0, 0.5), (0.6, 0.1, 1.0)),
    )
    found = []
    for people in (0, 8):
        r = Robot(lidars=only("xt16"), lidar_step=8, people=people, obstacles=obstacles)
        scans = of(r.run(0.4), LidarScan)

        def seen(low: tuple[float, ...], high: tuple[float, ...], r=r, scans=scans) -> int:
            return sum(points_in(scan, r.backend, low, high) for scan in scans)

        assert seen((-1.4, 1.9, 0.1), (-0.6, 2.1, 0.9)) > 20, "the solid one"
        found.append((seen((0.9, -0.4, 0.1), (1.1, 0.4, 0.9)), seen((-5.0, -5.0, 1.05), (5.0, 5.0, 1.8))))
    assert found[0] == (0, 0), (
        "nothing comes back from the clear one, and nothing else is as tall as a person"
    )
    assert found[1][1] > 20
