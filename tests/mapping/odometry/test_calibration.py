"""Clock of each LiDAR: found, corrected up to a bound, told. Mounts that are off are told, right ones on any ground are
not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from hal.lidar import LIDARS
from hal.robots.go2w.facts import L1_MOUNT, XT16_MOUNT
from hal.rotation import rotation_rpy, rotation_vector, rpy_of
from hal.types import NS, Extrinsics, GroundTruth, LidarName, LidarScan, Sample
from mapping.odometry.alignment import KEPT_WEIGHT, GyroFit, LeastSquares
from mapping.odometry.calibration import Calibration
from mapping.odometry.health import Health
from mapping.odometry.pipeline import LidarInertialOdometry, OdometryConfig
from mapping.odometry.types import ScanOdometry
from tests.mapping.odometry.test_intake import feed
from tests.mapping.odometry.test_lidars import in_order
from tools.synthetic import arena_run

Vector = tuple[float, float, float]


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    """Figure-eight with a pitching trunk, both LiDARs."""
    run = replace(arena_run("xt16", duration=7.0, seed=4), lidar=LIDARS["xt16"].decimated(4))
    out = [s for s in run.samples() if not isinstance(s, GroundTruth)]
    head = replace(run, lidar=LIDARS["l1"], seed=5)
    return in_order(out + [replace(s, name="head") for s in head.samples() if isinstance(s, LidarScan)])


def driven(samples: list[Sample], main: float, head: float, max_offset: float = 0.05) -> list[ScanOdometry]:
    """The stamps of each LiDAR lie this long [s] before the truth."""
    late = {"main": round(main * NS), "head": round(head * NS)}
    odometry = LidarInertialOdometry(
        OdometryConfig(max_time_offset=max_offset), {"main": XT16_MOUNT, "head": L1_MOUNT}
    )
    return feed(
        odometry,
        [replace(s, stamp=s.stamp - late[s.name]) if isinstance(s, LidarScan) else s for s in samples],
    )


def offsets(scan: ScanOdometry) -> dict[str, float]:
    return {lidar.name: 1e3 * lidar.offset for lidar in scan.lidars}


def test_right_clocks_are_left_alone(samples: list[Sample]) -> None:
    scans = driven(samples, 0.0, 0.0)
    assert offsets(scans[-1]) == pytest.approx({"main": 0.0, "head": 0.0}, abs=1.0)
    assert all(lidar.applied == 0.0 for scan in scans for lidar in scan.lidars)
    assert not any(scan.fault for scan in scans)
    without = driven(samples, 0.0, 0.0, max_offset=0.0)
    assert all((a.position == b.position).all() for a, b in zip(scans, without, strict=True))


@pytest.mark.parametrize(("main", "head"), [(0.03, -0.02), (-0.01, 0.0)])
def test_offsets_are_found_and_corrected(samples: list[Sample], main: float, head: float) -> None:
    scans = driven(samples, main, head)
    last = {lidar.name: lidar for lidar in scans[-1].lidars}
    assert last["main"].offset == pytest.approx(main, abs=0.001)
    assert last["main"].applied == pytest.approx(main, abs=0.0015)
    assert last["head"].offset == pytest.approx(head, abs=0.003)
    assert last["head"].applied == pytest.approx(head, abs=0.005)
    assert not scans[-1].fault
    stamp = scans[-1].stamp % (NS // 10)
    assert min(stamp, NS // 10 - stamp) < 2_000_000, "the pose has the stamp of the true end of the sweep"


def test_a_lidar_joins_the_main_one_while_nothing_speaks_against_clock_and_mount(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calibration = Calibration({"main": XT16_MOUNT, "head": L1_MOUNT}, 0.05)
    assert calibration.joins("head"), "nothing is known yet"

    def found(name: LidarName, offset: float, sigma: float) -> None:
        x, s = (v.copy() for v in calibration._known[name])
        x[0], s[0] = offset, sigma
        calibration._known[name] = x, s

    for name in ("main", "head"):
        for offset, sigma, joins in (
            (0.004, 0.0005, True),
            (0.02, 0.02, True),
            (-0.02, 0.005, False),
            (0.0, 0.001, True),
        ):
            found(name, offset, sigma)
            assert calibration.joins("head") is joins
    calibration.shift["main"] = 20_000_000
    found("main", 0.02, 0.001)
    assert calibration.joins("head"), "the main one's clock is corrected"
    calibration.shift["head"] = 20_000_000
    found("head", 0.02, 0.001)
    assert not calibration.joins("head"), "its own was"
    calibration.shift["head"] = 0
    found("head", 0.0, 0.001)
    monkeypatch.setattr(calibration, "_ground_fault", lambda name: {"z": 0.02} if name == "head" else {})
    assert not calibration.joins("head")


def test_an_offset_beyond_the_bound_is_a_fault_and_never_good_while_the_robot_turns(
    samples: list[Sample],
) -> None:
    scans = driven(samples, 0.08, 0.0)
    told = [k for k, scan in enumerate(scans) if "stamps of the main LiDAR" in scan.fault]
    assert told
    assert told[0] < 40
    assert scans[-1].fault.startswith("the stamps of the main LiDAR are -")
    assert scans[-1].fault.endswith("beyond the 50 ms that are corrected: set its time_offset")
    for scan in scans[told[0] :]:
        assert scan.lidars[0].applied == 0.05
        assert scan.health is not Health.GOOD or np.linalg.norm(scan.angular) < 0.1


def test_a_second_run_finds_the_same(samples: list[Sample]) -> None:
    one, two = driven(samples[:2000], 0.02, 0.01), driven(samples[:2000], 0.02, 0.01)
    assert [offsets(s) for s in one] == [offsets(s) for s in two]
    assert all((a.position == b.position).all() for a, b in zip(one, two, strict=True))


def test_turn_of_the_mount_and_offset_are_told_apart_by_the_gyro() -> None:
    """Motion about changing axes, exact but for noise; registration through a mount turned by `e`, stamps `offset`
    late."""
    random = np.random.default_rng(1)
    e, offset, dt = np.array([0.01, -0.02, 0.015]), 0.012, 0.1

    def body(t: float) -> np.ndarray:
        return rotation_rpy(0.1 * np.sin(5.0 * t), 0.15 * np.sin(4.0 * t + 1.0), 0.8 * np.sin(0.9 * t))

    fit, wrong = GyroFit(), rotation_rpy(*e)
    for k in range(1, 200):
        before, now = body((k - 1) * dt), body(k * dt)
        noise = rotation_rpy(*(3e-4 * random.standard_normal(3)))
        # the middle of a sweep tells where it lies: the rate there is its mean rate
        middle = body(k * dt + offset - 0.5 * dt) @ body((k - 0.5) * dt).T @ now
        pose = np.eye(4)
        pose[:3, :3] = middle @ wrong.T @ noise
        fit.add(k * NS // 10, before.T @ now, dt, pose, 9e-8 * np.eye(3), 0.0)
    x, sigma = fit.solve()
    assert x[0] == pytest.approx(offset, abs=3.0 * sigma[0] + 2e-4)
    assert x[1:] == pytest.approx(rotation_vector(wrong), abs=3e-3)
    assert sigma.max() < 3e-3


def test_one_registration_that_lies_askew_moves_no_stamp() -> None:
    """The first nose-down looks of a robot that stood in a lane: rate [rad/s] of the gyro, pitch of registration beside
    it [rad]."""
    found = Calibration({"main": XT16_MOUNT}, 0.05)
    engine = SimpleNamespace(scans=30)
    covariance = np.diag([9e-4, 9e-4, 9e-4, 2.5e-5, 1.7e-6, 7e-7])
    gyro = 0.0
    for k, (rate, off) in enumerate([(0.0, 0.0), (0.06, 0.0), (0.34, 0.018), (0.58, 0.003), (0.67, 0.004)]):
        before, now, pose = (np.eye(4) for _ in range(3))
        before[:3, :3] = rotation_rpy(0.0, gyro, 0.0)
        gyro += 0.1 * rate
        now[:3, :3] = rotation_rpy(0.0, gyro, 0.0)
        pose[:3, :3] = rotation_rpy(0.0, gyro + off, 0.0)
        stamp = k * NS // 10
        found.registered(stamp, before, now, stamp - NS // 10, pose, covariance, engine)  # type: ignore[arg-type]
    assert found.shift["main"] == 0
    assert found.clock_fault() == ""


@pytest.mark.parametrize(("offset", "corrected"), [(3.2, False), (4.5, False), (-5.5, True)])
def test_a_clock_is_corrected_only_where_more_than_the_error_of_the_method_is_left(
    offset: float, corrected: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Noise explains 0.6 ms. Right clocks of simulated physics were found 3.2 and 4.5 ms off in one lane."""
    solved = np.array([1e-3 * offset, 0.0, 0.0, 0.0]), np.array([6e-4, 1e-3, 1e-3, 1e-3])
    monkeypatch.setattr(GyroFit, "solve", lambda _: solved)
    found, here = Calibration({"main": XT16_MOUNT}, 0.05), np.eye(4)
    faded: list[float] = []
    engine = SimpleNamespace(scans=30, planes=SimpleNamespace(fade=faded.append))
    found.registered(NS, here, here, 0, here, 1e-6 * np.eye(6), engine)  # type: ignore[arg-type]
    assert faded == [KEPT_WEIGHT] * corrected, "what was mapped by the wrong clock counts little"
    (fit,) = found.fits()
    assert fit.applied == (1e-3 * offset if corrected else 0.0)
    assert fit.offset_sigma > 0.001, "as told"


@pytest.mark.parametrize(("yaw", "sigma", "told"), [(6.4, 2.55, False), (2.0, 0.3, True), (2.0, 0.45, False)])
def test_what_may_be_chance_is_no_wrong_mount(yaw: float, sigma: float, told: bool) -> None:
    """In the first metres of a drive a right mount was 6.4 deg off, one standard deviation 2.55."""
    calibration = Calibration({"main": XT16_MOUNT}, 0.05)
    calibration._known["main"] = np.radians([0.0, 0.0, 0.0, yaw]), np.radians([0.01, 0.5, 0.5, sigma])
    assert calibration.fault() == ("the mount of the main LiDAR is off: yaw +2.0 deg" if told else "")


def test_least_squares_agrees_with_numpy() -> None:
    random = np.random.default_rng(2)
    a, x = random.standard_normal((60, 3)), np.array([0.3, -0.2, 0.1])
    r = a @ x + 0.01 * random.standard_normal(60)
    fit = LeastSquares(np.full(3, 1e6))
    for k in range(0, 60, 6):
        fit.add(
            1e4 * a[k : k + 6].T @ a[k : k + 6],
            1e4 * a[k : k + 6].T @ r[k : k + 6],
            1e4 * r[k : k + 6] @ r[k : k + 6],
            6.0,
        )
    found, sigma = fit.solve()
    fade = np.sqrt(np.exp(-np.arange(9, -1, -1) / 300.0)).repeat(6)
    wanted = np.linalg.lstsq(a * fade[:, None], r * fade, rcond=None)[0]
    np.testing.assert_allclose(found, wanted, rtol=1e-6)
    np.testing.assert_allclose(sigma, 0.01 * np.sqrt(np.diag(np.linalg.inv(a.T @ a))), rtol=0.3)


def ground(scene: str, random: np.random.Generator) -> np.ndarray:
    """(n, 3) of ground around a robot whose wheels stand at z = -0.4 m, noise of 1 cm."""
    xy = random.uniform(-3.5, 3.5, (6000, 2))
    xy = xy[np.hypot(*xy.T) > 0.6]
    z = np.full(len(xy), -0.4)
    if scene == "field":  # blocks of 20 cm, up to 10 cm high
        cell = np.floor(xy / 0.2).astype(int) + 50
        z += random.uniform(0.0, 0.1, (100, 100))[cell[:, 0], cell[:, 1]]
    elif scene == "ramp":  # begins 0.7 m ahead, 15 deg
        z += np.tan(np.radians(15.0)) * np.maximum(xy[:, 0] - 0.7, 0.0)
    elif scene == "step":  # 4 cm, beside the robot
        z[xy[:, 1] > 0.3] += 0.04
    return np.column_stack([xy, z + 0.01 * random.standard_normal(len(xy))]).astype(np.float32)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("walls", [False, True])
def test_a_head_lidar_that_sees_nothing_but_ground_tells_no_place_of_its_mount(
    walls: bool, seed: int
) -> None:
    """Its points lie 6 cm beside the middle of planes that noise tilts by 0.04 rad."""
    random = np.random.default_rng(seed)
    found = Calibration({"main": XT16_MOUNT, "head": L1_MOUNT}, 0.05)
    fit = found._beside["head"]
    for _ in range(100):
        n = np.column_stack([0.04 * random.standard_normal((400, 2)), np.ones(400)])
        if walls:
            n[:100], n[100:200] = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
        at = np.column_stack([random.uniform(-2.0, 2.0, (400, 2)), np.full(400, -0.4)])
        off = fit.pose(np.eye(4), np.zeros(3), np.zeros(3), 0.0)[1]
        j = np.column_stack([n, np.cross(at, n)])
        r = 0.06 * n[:, 0] - j @ off + 0.005 * random.standard_normal(400)
        fitted = (j.T @ j, j.T @ r, 400, 400, 400, float(r @ r), 0.0)
        fit.add(fitted, np.eye(4), off, np.zeros(3), np.zeros(3), 0.01, 0.0)
    found._known["head"] = fit.solve()
    assert found.fault() == (
        "the mounts of the main and the head LiDAR do not fit together: x +6.0 cm" if walls else ""
    )


CONTACTS = np.array([[0.2, -0.2, -0.4], [0.2, 0.2, -0.4], [-0.2, -0.2, -0.4], [-0.2, 0.2, -0.4]])
UP = np.array([0.0, 0.0, 1.0])


def calibration(cloud: Callable[[], np.ndarray], contacts: np.ndarray, e: np.ndarray, z: float) -> str:
    """What is said after ten scans of a robot at rest whose main LiDAR is turned by `e` and `z` too high, by the
    configuration."""
    found = Calibration({"main": XT16_MOUNT}, 0.05)
    for _ in range(10):
        seen = (cloud() @ rotation_rpy(*e).T + [0.0, 0.0, z]).astype(np.float32)
        found.clouds({"main": seen}, None, np.eye(4), np.zeros(3), np.zeros(3), contacts)  # type: ignore[arg-type]
    return found.fault()


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("scene", ["flat", "field", "ramp", "step"])
def test_right_mounts_are_well_on_even_and_on_rough_ground(scene: str, seed: int) -> None:
    random = np.random.default_rng(seed)
    still = ground(scene, random)
    contacts = CONTACTS.copy()
    contacts[:, 2] += random.uniform(0.0, 0.1, 4) if scene == "field" else 0.0
    assert calibration(lambda: still, contacts, np.zeros(3), 0.0) == ""


def test_wheels_on_a_plank_are_no_wrong_mount() -> None:
    random = np.random.default_rng(0)
    contacts = CONTACTS + [0.0, 0.0, 0.04] * (CONTACTS[:, :1] > 0.0)
    assert calibration(lambda: ground("flat", random), contacts, np.zeros(3), 0.0) == ""


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("e", "z", "told"),
    [
        ((2.0, 0.0, 0.0), 0.0, "roll +2.0 deg"),
        ((-2.0, 0.0, 0.0), 0.0, "roll -2.0 deg"),
        ((0.0, 2.0, 0.0), 0.0, "pitch +2.0 deg"),
        ((0.0, 0.0, 0.0), 0.02, "z +2.0 cm"),
        ((0.0, 0.0, 0.0), -0.02, "z -2.0 cm"),
    ],
)
def test_a_wrong_mount_is_told_at_rest(e: tuple[float, float, float], z: float, told: str, seed: int) -> None:
    random = np.random.default_rng(seed)
    said = calibration(lambda: ground("flat", random), CONTACTS, np.radians(e), z)
    # turned about the axes of base_link, an XT16 that is 0.16 m ahead is not higher or lower itself
    assert said.startswith("the mount of the main LiDAR is off: ")
    assert told in said


@pytest.mark.parametrize(
    ("name", "turn", "place", "told"),
    [
        ("main", (0.0, 0.0, 2.0), (0.0, 0.0, 0.0), "the mount of the main LiDAR is off: yaw +2.0 deg"),
        ("head", (0.0, 0.0, -2.0), (0.0, 0.0, 0.0), "do not fit together: yaw -2.0 deg"),
        ("head", (0.0, 0.0, 0.0), (0.02, 0.0, 0.0), "do not fit together: x +2.0 cm"),
        pytest.param(
            "head",
            (0.0, 0.0, 0.0),
            (0.0, -0.02, 0.0),
            "do not fit together: y -2.0 cm",
            marks=pytest.mark.campaign,
        ),
        ("head", (0.0, 2.0, 0.0), (0.0, 0.0, 0.0), "the mount of the head LiDAR is off: pitch +2.0 deg"),
        pytest.param(
            "head",
            (0.0, 0.0, 0.0),
            (0.0, 0.0, 0.02),
            "the mount of the head LiDAR is off: z +2.0 cm",
            marks=pytest.mark.campaign,
        ),
    ],
)
def test_a_wrong_mount_is_told_while_the_robot_drives(
    samples: list[Sample], name: LidarName, turn: Vector, place: Vector, told: str
) -> None:
    mounts: dict[LidarName, Extrinsics] = {"main": XT16_MOUNT, "head": L1_MOUNT}
    right = mounts[name]
    rpy = rpy_of(rotation_rpy(*np.radians(turn)) @ rotation_rpy(*right.rpy))
    x, y, z = np.add(right.translation, place).tolist()
    mounts[name] = Extrinsics((x, y, z), rpy)
    scans = feed(LidarInertialOdometry(mounts=mounts), samples[:1400])
    assert told in scans[-1].fault
    assert "stamps" not in scans[-1].fault


@pytest.mark.parametrize(
    "contacts",
    [np.zeros((4, 3)), CONTACTS[:2], CONTACTS[:, [2, 1, 0]], CONTACTS * [1.0, 0.0, 1.0]],
    ids=["one point", "two wheels", "on its side", "in a line"],
)
def test_wheels_that_make_no_ground_are_not_looked_at(contacts: np.ndarray) -> None:
    random = np.random.default_rng(0)
    assert calibration(lambda: ground("flat", random), contacts, np.radians([5.0, 0.0, 0.0]), 0.0) == ""
