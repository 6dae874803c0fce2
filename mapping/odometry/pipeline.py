"""LiDAR-inertial odometry around KISS-ICP, for a robot on wheels and legs.

    imu, joints ──> predict ──> deskew ──> register ──> judge ──> correct ──> local map
                 (filter)     (to scan end)  (engine)   (health)   (filter)
                                  └──> search, second opinion (KISS-ICP) ──^

The sweeps of several LiDARs come deskewed to the same stamp and are registered together; the main one makes the local
map. While the main one is silent the other takes its place, and the health is `degraded`.

Results are a function of the samples, not of the order in which topics arrive: a scan waits until IMU and joints have
passed its end, or until another topic is `patience` ahead. `FastPose` and `WheelOdometry` are the exception: they
answer at once with what has arrived.

Frame `odom`: below the robot's start, z up along gravity, x along the initial heading; z = 0 is the ground under the
wheels when joints are known at the start, else base_link itself."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from hal.robots import describe
from hal.rotation import rotation_vector
from hal.safety.monitors import IMPOSSIBLE_SPEED, IMU_DISAGREES, SCANS_DISAGREE
from hal.types import NS, Array, Extrinsics, ImuSample, JointSample, LidarName, LidarScan
from mapping.odometry.agreement import TURN_TOLD, Agreement, Handedness, Scale, way_ahead
from mapping.odometry.calibration import TURNING_RATE, Calibration
from mapping.odometry.contacts import contacts_of
from mapping.odometry.deskew import Deskewer
from mapping.odometry.health import Health, HealthMonitor, Verdict
from mapping.odometry.inbox import Inbox
from mapping.odometry.inertial import InertialFilter
from mapping.odometry.inertial_kernels import SILENCE_TIME
from mapping.odometry.intake import Sweep
from mapping.odometry.own import OwnFilter, OwnPart, OwnParts
from mapping.odometry.pose_stream import PoseStream
from mapping.odometry.registration.engines import Match, make_engine
from mapping.odometry.registration.observability import UNKNOWN_SIGMA
from mapping.odometry.registration.witness import Witness
from mapping.odometry.rehearsal import rehearse
from mapping.odometry.startup import START_WINDOW, Before, Startup, put_at, start
from mapping.odometry.stillness import still
from mapping.odometry.types import FastPose, OdometryConfig, ScanOdometry
from mapping.odometry.wheel_scale import WheelScale
from mapping.odometry.wheels import WheelOdometry, velocities, ways_of_wheels

ZERO = np.zeros(6)
LARGEST_GAIN, FALL_SPEED = 4.0, 1.6
"""Largest gain of speed from one sweep to the next, also of a thrown robot, and largest vertical speed with wheels on
the ground [m/s]."""
TOLD_SIGMA = 1.0
"""A scan whose standard deviation ahead is larger [m] does not tell how far the robot came."""
TYRE_SLIP = 0.01
"""Slip of tyres on firm ground beside what the scans taught, as a share of the way, one standard deviation. Loose
ground is worse."""
CREEP_RATE = math.radians(0.02)
"""[rad/s] by which scans may turn a robot whose wheels and gyro stand still: its tyres give way slowly, and gravity or
somebody's hand turns it. So slow, it follows the median of the scans: people who walk past do not turn it."""
HEADING_TOLD = math.radians(0.2)
"""A scan whose heading has a larger standard deviation [rad] does not turn it."""
OVER_GROUND = [0, 1, 5]
"""Position in the plane and heading, of a (6, 6) covariance."""


class LidarInertialOdometry:
    """Feed samples in, `poll` for finished scans. One thread."""

    def __init__(
        self,
        params: OdometryConfig | None = None,
        mounts: Mapping[LidarName, Extrinsics] | None = None,
        own: Sequence[OwnPart] = (),
        size: tuple[float, float] | None = None,
    ) -> None:
        """`mounts`: each LiDAR in base_link; None: the main one where the default robot carries it. `own`: parts of the
        robot beside its body, whose `size` is length and width [m]; None: that of the default robot."""
        params = params or OdometryConfig()
        mounts = mounts or {"main": describe().mounts["xt16"]}
        self._own = OwnFilter(own, mounts, size)
        self.parts = OwnParts(self._own.outline)
        """What moves with the robot and is none of `own`."""
        self.params = params
        self.counters: Counter[str] = Counter()
        self.initialised = False
        self._engine = make_engine(params.engine, params.planes, params.small_gicp, params.max_range)
        self._witness = Witness(params.kiss_icp, params.max_range)
        self._filter = InertialFilter(params.inertial)
        self._monitor = HealthMonitor(params.health)
        self._lever = np.array(params.inertial.imu_position)
        self._deskewer = Deskewer(mounts, self._lever)
        self.calibration = Calibration(mounts, params.max_time_offset)
        self._wheel_noise = np.array(params.inertial.wheel_noise)
        self._inbox = Inbox(params, self.counters, self._follow_clock, self.calibration.shift, self._own)
        self._imu, self._joints = self._inbox.imu, self._inbox.joints
        self._stream = PoseStream(params.inertial, params.smoothing, self._imu, self._joints, self._monitor)
        self._startup = Startup()
        self._before: Before | None = None
        self._scale = WheelScale()
        self._agreement = Agreement(SCANS_DISAGREE)
        self._distances = Scale()
        self._sides = Handedness()
        self._coasting = Agreement(IMU_DISAGREES)
        """IMU and wheels since the last scan that was used."""
        self._rolled, self._turned = math.nan, 0.0
        """What wheels [m] and gyro [rad] tell of the way and the turn since the last scan."""
        self._each = np.full(4, np.nan)
        """The same of each wheel [m]."""
        self._untrue = ""
        """Why what the filter integrated since the last scan cannot be believed; empty where it can."""
        self._still = False
        """Wheels and gyro say that the robot stood since the last scan."""
        self._seen: Array | None = None
        """Where the scans see a robot (4, 4) whose wheels and gyro stand still, if that is elsewhere."""
        self._born = 0.0
        """Variance of the place when what the last scan fitted was first seen [m^2]."""
        self._blind = 0.0
        """Way of the wheels without a scan that tells how far [m]."""
        self._misfits = 0
        self._looks = 0
        self._notes: list[str] = []
        self._health, self._reason = Health.DEGRADED, "waiting for the first scan"

    # --- samples in ---------------------------------------------------------------------------------------------
    def add_imu(self, sample: ImuSample) -> FastPose | None:
        """Take an inertial sample; the pose at its stamp once initialised."""
        row = self._inbox.take_imu(sample)
        if row is None:
            return None
        if not self.initialised or sample.stamp - self._filter.stamp > 60 * NS:
            return None
        return self._stream.on_imu(int(sample.stamp), row, self._health, self._reason)

    def add_joints(self, sample: JointSample) -> WheelOdometry | None:
        """Take a joint sample (thinned to 50 Hz); wheel-leg odometry at its stamp once initialised."""
        row = self._inbox.take_joints(sample)
        if row is None or not self.initialised:
            return None
        return self._stream.on_joints(int(sample.stamp), row)

    def add_scan(self, scan: LidarScan) -> None:
        """Take a scan; `poll` processes it."""
        self._inbox.take_scan(scan)

    def resume(self, before: Before) -> None:
        """Call before the first sample to continue another odometry from its last pose.

        The first scan is registered to that cloud, so neither pose nor map jumps by what the robot coasted meanwhile.
        A robot that was carried further than registration reaches becomes `lost`."""
        self._before = before

    def poll(self) -> list[ScanOdometry]:
        """Scans whose IMU and joint data have arrived, processed in order; a second without any scan also reports."""
        out: list[ScanOdometry] = []
        while True:
            sweep = self._inbox.next_sweep()
            if sweep is not None:
                result = self._process(sweep)
            elif (
                self.initialised
                and 2 * NS < self._inbox.now - self._filter.stamp < 60 * NS
                and not self._inbox.waiting
            ):
                result = self._coast(self._filter.stamp + NS)
            else:
                return out
            if result is not None:
                out.append(result)

    # --- one scan -----------------------------------------------------------------------------------------------
    def _process(self, sweep: Sweep) -> ScanOdometry | None:
        if not self.initialised:
            self._initialise(sweep)
            return None
        if sweep.end <= self._filter.stamp:
            self.counters["scan_backward"] += 1
            return None
        before, since = self._filter.pose(), self._filter.stamp
        stamps, track = self._predict(sweep.end)
        dead = self._inbox.dead
        if sweep.name != "main":
            silent = "" if dead("main") else "the main LiDAR is silent, "
            self._notes.append(f"{silent}the {sweep.name} LiDAR takes its place")
        self._notes += [dead(name) for name in self.calibration.shift if name != sweep.name and dead(name)]
        along = self._inbox.beside(sweep)
        others = self._deskewer.beside(along, stamps, track)
        if sweep.problem or self._untrue:
            return self._dead_reckoned(sweep.problem)
        if sweep.untimed:
            self._notes.append(
                f"the points of the {sweep.name} LiDAR carry no time: motion during a sweep stays in them"
            )
        cloud = self._deskewer.cloud(sweep, stamps, track)

        predicted = self._filter.pose()
        prior = self._filter.output(ZERO).covariance
        scans = self._engine.scans
        self._witness.moved(before, predicted)
        searching = self._monitor.doubts(sweep.end)
        beside = [seen for name, seen in others.items() if self.calibration.joins(name)]
        self._engine.take(cloud, beside)
        match = self._register(predicted, searching)
        verdict = self._monitor.judge(
            sweep.end, match, predicted, prior, scans, self._engine.sigma, self._still
        )
        if verdict.use:
            self._coasting.forget()
        heading = scans and verdict.covariance[5, 5] < TURN_TOLD**2
        if heading and self._monitor.fits_again(match, True, True):
            self._sides.add(sweep.name, match.pose, self._turned)
        else:
            self._sides.forget()
        if verdict.use and scans:
            measured = _rotation_to_body(verdict.covariance, match.pose)
            # The local map tilts slowly with every scan put into it, so its tilt errors are not independent from
            # scan to scan: gravity has the last word there.
            measured[[3, 4], [3, 4]] += math.radians(self.params.tilt_sigma) ** 2
            if verdict.held:
                measured[OVER_GROUND, OVER_GROUND] += UNKNOWN_SIGMA**2
            if verdict.strange:
                apart = np.linalg.inv(predicted) @ match.pose
                moved, turned = np.linalg.norm(apart[:3, 3]), np.linalg.norm(rotation_vector(apart[:3, :3]))
                self._filter.misplaced(3.0 * float(moved), 3.0 * float(turned))
            self._filter.update_pose(match.pose, measured)
            if verdict.held and verdict.insert and verdict.covariance[5, 5] < HEADING_TOLD**2:
                self._filter.creep(match.pose, CREEP_RATE * (sweep.end - since) / NS)
        self._seen = match.pose if verdict.use and not verdict.insert and verdict.held else None
        self._slip_unseen(verdict)
        self._misfits = 0 if verdict.use else self._misfits + 1
        if verdict.use:
            self._born = match.born
        if verdict.insert:
            self._engine.insert(self._filter.pose(), self._place_variance())
            self._compare(searching, verdict.health is Health.GOOD)
            if sweep.name == "main":
                self._calibrate(since, before, predicted, match.pose, verdict.covariance, cloud, others)
        self._learn_scale(before, sweep.end - since, verdict)
        if verdict.insert and not (searching or verdict.strange):
            after, each = self._filter.pose(), self._each * self._scale.value
            self._notes += filter(None, [self._agreement.add(sweep.end, before, after, each, self._turned)])
            self._distances.add(before, after, self._each)
        else:
            self._agreement.forget()
            self._distances.forget()
        self._notes += filter(None, [self._distances.words])
        self._health, self._reason = verdict.health, verdict.reason
        if self._notes and verdict.health is not Health.LOST:
            self._health = Health.DEGRADED
            self._reason = "; ".join([*self._notes, verdict.reason] if verdict.reason else self._notes)
        self._notes.clear()
        self._rejoin()
        if verdict.insert and self.parts.due(self._filter.pose()):
            self._look_for_parts(sweep, cloud, along, others)
        # nothing is mapped from a pose that is not sure
        clouds = {sweep.name: cloud, **others} if verdict.insert else {}
        return self._result(clouds, match, predicted, verdict.degenerate, verdict.degeneracy)

    def _register(self, predicted: Array, searching: bool) -> Match:
        """Where the scan fits: near the prediction, or where KISS-ICP finds it if the pose is in doubt or the scan
        suddenly fits badly."""
        match = self._engine.align(predicted if self._seen is None else self._seen)
        young = self._engine.scans < self.params.health.young
        if self._monitor.fits_again(match, young) or not (searching or self._monitor.dropped(match)):
            return match
        reach = 3.0 * math.sqrt(self._filter.p[8, 8])
        found = self._engine.align(self._witness.search(self._engine.frame, predicted, reach, self._misfits))
        return found if self._monitor.fits_again(found, young) else match

    def _compare(self, searched: bool, sure: bool) -> None:
        """Every few scans KISS-ICP says where the robot went; a disagreement puts a pose in doubt that was `sure`."""
        if searched:
            self._witness.found(self._filter.pose())
        self._looks += 1
        if (self._looks - 1) % self.params.kiss_icp.every:
            return
        against = self._witness.look(self._engine.frame, self._filter.pose(), sure)
        if against:
            self._monitor.doubt(against, tracked=True)
            self._notes.append(against)

    def _calibrate(
        self, since: int, before: Array, predicted: Array, pose: Array, covariance: Array, cloud: NDArray[np.float32],
        others: Mapping[LidarName, NDArray[np.float32]]
    ) -> None:  # fmt: skip
        """Compare the main LiDAR with the gyro, the others with the local map, and the ground that each sees with the
        wheels."""
        now, state = self._filter.stamp, self._filter.output(ZERO)
        rate = rotation_vector(before[:3, :3].T @ predicted[:3, :3]) * NS / (now - since)
        contacts = contacts_of(self._filter.limbs, self._joints.between(now - NS // 15, now)[1])
        self.calibration.registered(now, before, predicted, since, pose, covariance, self._engine)
        self.calibration.clouds({"main": cloud, **others}, self._engine, pose, state.linear, rate, contacts)
        if max(np.linalg.norm(rate), np.linalg.norm(state.angular)) > TURNING_RATE:
            self._notes += filter(None, [self.calibration.clock_fault()])

    def _look_for_parts(
        self, sweep: Sweep, cloud: NDArray[np.float32], along: Sequence[Sweep],
        others: Mapping[LidarName, NDArray[np.float32]]
    ) -> None:  # fmt: skip
        """Sweeps as measured beside their clouds, which are at the end of the main one."""
        seen = [(sweep.name, [sweep], cloud)]
        seen += [(name, [s for s in along if s.name == name], moved) for name, moved in others.items()]
        self.parts.look(
            [
                (
                    np.concatenate([self._own.in_base(name, s.xyz) for s in sweeps]),
                    moved,
                    self._own.place(name),
                )
                for name, sweeps, moved in seen
            ],
            self._filter.pose(),
        )

    def _initialise(self, sweep: Sweep) -> None:
        """The sweep tells when; IMU and joints up to its end tell attitude, velocity and height."""
        imu_stamp, imu = self._imu.between(sweep.end - START_WINDOW, sweep.end)
        joint_stamp, joints = self._joints.between(sweep.end - NS // 15, sweep.end)
        if len(imu) < 5:
            self.counters["scan_before_imu"] += 1
            if self.counters["scan_before_imu"] < 10:
                return
        if not self._startup.ready(sweep.end, imu_stamp, imu):
            return
        joints = joints if self.params.use_joints else joints[:0]
        start(self._filter, sweep.end, imu_stamp, imu, joint_stamp, joints, self._wheel_noise)
        if self._before is not None:
            put_at(self._filter, self._before)
            self._engine.take(self._before.cloud)
            self._engine.insert(self._before.pose, settled=True)
            self._witness.look(self._engine.frame, self._before.pose)
        self._stream.start(self._filter)
        self._monitor.start(sweep.end, lost=self._before is not None)
        self._before = None
        self.initialised = True
        self._rejoin()

    def _predict(self, end: int) -> tuple[NDArray[np.int64], Array]:
        """Advance the filter to `end`; the track it took. Notes which data were missing."""
        for topic, name, buffer in (("joints", "joint", self._joints), ("imu", "IMU", self._imu)):
            if buffer.any_between(max(self._filter.stamp, end - NS // 10), end):
                continue
            self.counters[f"scan_without_{topic}"] += 1
            if topic == "imu" or (self._inbox.heard(topic) and self.params.use_joints):
                self._notes.append(self._inbox.dead(topic) or f"no {name} data")
        stamps, track = self._advance(end)
        if (silence := int(np.diff(stamps).max(initial=0))) > SILENCE_TIME:
            self._notes.append(f"no IMU data for {silence / NS:.1f} s")
        self._notes += self._inbox.refused()
        return stamps, track

    def _advance(self, end: int) -> tuple[NDArray[np.int64], Array]:
        state = self._filter
        imu_stamp, imu = self._imu.between(state.stamp, end, beyond=1)
        joint_stamp, joints = self._joints.between(state.stamp, end)
        scale = self._scale.value
        noise = np.hypot(self._wheel_noise, [self._scale.noise, 0.0, 0.0])
        wheel, sigma, _ = velocities(
            state.limbs, joint_stamp, joints, imu_stamp, imu, state.x[10:13], self._lever, noise, scale
        )
        touching = bool(np.isfinite(sigma[:, 0]).all()) and len(wheel) >= 3
        self._rolled = (
            float(wheel[:, 0].mean()) / scale * (end - state.stamp) * 1e-9 if touching else math.nan
        )
        self._inbox.rolled(self._rolled)
        x, variance, before = state.x.copy(), np.diag(state.p)[[0, 1, 8]], state.pose()
        inside = imu[imu_stamp <= end]
        self._still = bool(touching and still(inside, x[10:13], joints, wheel))
        rate = float(inside[:, 2].mean()) if len(inside) else x[12]
        self._turned = (rate - x[12]) * (end - state.stamp) * 1e-9
        turning = inside[:, :3].mean(axis=0) - x[10:13] if len(inside) else np.zeros(3)
        self._each = np.full(4, np.nan)
        if touching:
            self._each = ways_of_wheels(state.limbs, joints, turning, (end - state.stamp) * 1e-9)
        stamps, track = state.advance(end, imu_stamp, imu, joint_stamp, wheel, sigma)
        speed = float(np.linalg.norm(state.x[3:6]))
        gained = float(np.linalg.norm(state.x[3:6] - x[3:6]))
        fast = max(gained / LARGEST_GAIN, abs(state.x[5]) / FALL_SPEED if touching else 0.0)
        self._untrue = self._inbox.dead("imu") or self._sides.words
        cannot_be = IMPOSSIBLE_SPEED.tell(speed=speed) if IMPOSSIBLE_SPEED.outside(fast) else ""
        if not self._untrue:
            apart = self._coasting.add(end, before, state.pose(), self._each * scale, self._turned)
            cannot_be = cannot_be or apart
        if cannot_be:
            self._untrue = cannot_be
            self._coasting.forget()
            state.refuse(x)
        elif self._still:
            state.hold(x, variance, rate)
        return stamps, track

    def _learn_scale(self, before: Array, interval: int, verdict: Verdict) -> None:
        """Compare the way of the wheels since `before` (4, 4), `interval` [ns] ago, with the scans, if they constrain
        the way ahead."""
        after = self._filter.pose()
        if not (verdict.health is Health.GOOD and math.isfinite(self._rolled)):
            self._scale.forget()
            return
        ahead = after[:3, 0]
        sigma = math.sqrt(max(float(ahead @ verdict.covariance[:3, :3] @ ahead), 0.0))
        self._scale.learn(self._rolled, way_ahead(before, after), interval * 1e-9, sigma)
        self._stream.scale = self._scale.value

    def _slip_unseen(self, verdict: Verdict) -> None:
        """Where no scan tells how far the robot came, its tyres may have slipped alike all the way: the error grows
        with the way, not with its root."""
        ahead = self._filter.pose()[:2, 0]
        if verdict.use and float(ahead @ verdict.covariance[:2, :2] @ ahead) < TOLD_SIGMA**2:
            self._blind = 0.0
        elif math.isfinite(self._rolled):
            way = self._blind + abs(self._rolled)
            self._filter.p[:2, :2] += TYRE_SLIP**2 * (way**2 - self._blind**2) * np.outer(ahead, ahead)
            self._blind = way

    def _coast(self, until: int) -> ScanOdometry:
        """No scan came: move the filter on so that a later one finds it near."""
        self._advance(until)
        return self._dead_reckoned("no scan", *self._inbox.refused())

    def _dead_reckoned(self, *reasons: str) -> ScanOdometry:
        self._sides.forget()
        covariance = self._filter.output(ZERO).covariance
        sigma = math.sqrt(float(np.linalg.eigvalsh(covariance[:3, :3])[-1]))
        stamp, inbox = self._filter.stamp, self._inbox
        untrue = self._untrue or inbox.dead(inbox.pace)
        reason = "; ".join(dict.fromkeys(filter(None, [untrue, *reasons, *self._notes])))
        self._notes.clear()
        if untrue:
            self._health, self._reason = self._monitor.lose(stamp, reason)
        else:
            self._health, self._reason = self._monitor.without_match(stamp, sigma, reason)
        self._rejoin()
        nothing = Match(self._filter.pose(), 0, 0.0, 0, 0.0, 0.0, np.zeros((6, 6)))
        return self._result({}, nothing, nothing.pose, np.array([0.0, 0.0, 1.0]), 0.0)

    def _result(
        self,
        clouds: Mapping[LidarName, NDArray[np.float32]],
        match: Match,
        predicted: Array,
        direction: Array,
        share: float,
    ) -> ScanOdometry:
        state = self._filter.output(ZERO)
        return ScanOdometry(
            stamp=self._filter.stamp,
            position=state.position,
            orientation=state.orientation,
            linear=state.linear,
            angular=state.angular,
            covariance=state.covariance,
            health=self._health,
            reason=self._reason,
            overlap=match.overlap,
            inliers=match.inliers,
            residual=match.residual,
            degenerate=direction,
            degeneracy=share,
            correction=float(np.linalg.norm(match.pose[:3, 3] - predicted[:3, 3])),
            clouds=clouds,
            place_sigma=math.sqrt(self._place_variance()),
            lidars=self.calibration.fits(),
            fault="; ".join(filter(None, (self.calibration.fault(), self.parts.words))),
        )

    def _place_variance(self) -> float:
        """Of x and y in `odom` [m^2]: where the robot is on its map, where that was made, and how large it is."""
        here = float(np.linalg.eigvalsh(self._filter.output(ZERO).covariance[:2, :2])[-1])
        return here + self._born + self._distances.unsure**2

    def _rejoin(self) -> None:
        self._stream.rejoin(self._filter)
        keep = max(min(self._filter.stamp, self._stream.dead.stamp), self._filter.stamp - 5 * NS)
        self._inbox.forget(keep)

    def _follow_clock(self, stamp: int) -> None:
        """The source clock was set: go on at the new time with the pose and the map kept."""
        self._deskewer.forget()
        self._filter.move_clock(stamp)
        self._stream.move_clock(stamp)
        # A long time without any message looks the same, and the robot may have been carried meanwhile.
        self._monitor.start(stamp - round((self.params.health.gap_again + 0.1) * NS))
        self._notes.append("source clock was set")

    def warm_up(self) -> None:
        """Compile every kernel."""
        self.parts.warm_up()
        rehearse(LidarInertialOdometry(self.params.model_copy(update={"use_joints": True})))


def _rotation_to_body(covariance: Array, pose: Array) -> Array:
    """Rotation part of a (6, 6) covariance from `odom` to base_link axes."""
    t = np.eye(6)
    t[3:, 3:] = pose[:3, :3].T
    return t @ covariance @ t.T
