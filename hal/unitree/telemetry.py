"""Messages of the robot become samples for the stack and the few values that the driver itself needs."""

from __future__ import annotations

import logging
import math
from collections import Counter
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hal.limbs import MOTORS
from hal.plausible import ImuCheck, impossible_joints, lost_motor
from hal.rotation import rotation_rpy, up_of
from hal.safety.monitors import ATTITUDE, BATTERY, CLOCK_DRIFT, CLOCK_STEP, LOW_RATE
from hal.types import LYING, NS, Array, ImuSample, JointSample, LidarScan, Phase
from hal.unitree.api import WireError
from hal.unitree.clock import RemoteClock
from hal.unitree.cloud import RawImu, decode_imu
from hal.unitree.config import UnitreeConfig
from hal.unitree.layout import LOW_STATE_CDR, SPORT_MODE_STATE_CDR, low_state_checksum, view
from hal.unitree.lidars import STEP_TOLD, LidarInput, Silence
from hal.unitree.link import L1_IMU, LOW_STATE, SPORT_STATE, Link
from hal.unitree.motion import WHEEL_SLOTS, Motion, remote
from hal.unitree.quality import LinkQuality
from hal.unitree.turns import Turns

log = logging.getLogger(__name__)

IMU_PERIOD = 4
"""[ms] of LowState ticks between IMU samples: 250 Hz from 500 Hz."""
JOINT_PERIOD = 20
"""[ms] of LowState ticks between joint samples."""
MOUNT_SAMPLES = 200
"""L1 IMU samples averaged before the mount is judged."""
MOUNT_TOLERANCE = math.radians(25.0)
REFUSAL_TOLD = 2 * NS
"""[ns] for which an impossible sample is told."""


def _angle(a: Array, b: Array) -> float:
    """Between two vectors [rad]; NaN where one is zero."""
    norms = float(np.linalg.norm(a) * np.linalg.norm(b))
    return math.acos(max(-1.0, min(1.0, float(a @ b) / norms))) if norms > 0.0 else math.nan


class Telemetry:
    """Drains the link into samples. Ages are host time since the last message that carried something new."""

    def __init__(self, link: Link, options: UnitreeConfig, *, log_raw: bool = False) -> None:
        """`log_raw`: a dry run. What the posture is read from is logged whenever it changes, and no request is answered
        by the robot."""
        self._log_raw = log_raw
        self._link, self._options = link, options
        self._imu_rotation = rotation_rpy(0.0, 0.0, options.imu_yaw)
        self.lidars = [
            LidarInput(lidar, mounted, options.topic(lidar))
            for lidar, mounted in zip(options.lidars, options.mounted(), strict=True)
        ]
        self._l1 = next((lidar for lidar in self.lidars if lidar.model == "l1"), None)
        self._leak = np.array([*options.l1_gyro_leak, 0.0])
        self._checks = {"lowstate": ImuCheck("IMU"), "l1": ImuCheck("IMU of the L1")}
        self.impossible = 0
        """Samples with values that cannot be."""
        self._refused: dict[str, tuple[str, int]] = {}
        """By stream why its newest impossible sample was not passed on, and when [ns]."""
        self.low_clock = RemoteClock(answers=not log_raw)
        self._link_quality = LinkQuality()
        self.motion = Motion(options.wheels)
        self._motors = np.flatnonzero(np.isin(MOTORS, options.robot.moves))
        """Slots of the motors that it has."""
        self._turns = Turns()
        self.low: np.void | None = None
        self.battery = 1.0
        """State of charge [0..1], as last told; full before that."""
        self.upright = True
        """Whether the trunk is less than 60 deg from level, by the robot's attitude filter as last told."""
        self.sport: np.void | None = None
        self._heard_at: int | None = None
        """When the last LowState with a new tick came [ns]."""
        self._sport_at: int | None = None
        self._raw = ""
        self._sport_stamp: tuple[int, int] | None = None
        self._l1_stamp: int | None = None
        self._silence = Silence(link)
        self._tick = 0
        """Of the newest LowState [ms]; it does not run over."""
        self._sampled = self._elapsed = 0
        """Tick of the last LowState that was looked at for samples, and [ms] up to it, which never start over."""
        self._due = {IMU_PERIOD: 0, JOINT_PERIOD: 0}
        self._last: dict[type, int] = {}
        self.bad: Counter[str] = Counter()
        """Unreadable messages by topic."""
        self.low_unread = ""
        """Why the newest LowState was not believed; empty when it was."""
        self._gravity, self._own_gravity = np.zeros(3), np.zeros(3)
        self._gravity_count = 0
        self.mount_error: float | None = None
        """Angle between gravity as the L1 and as the trunk feel it [rad]; None before enough samples at rest."""
        self.order_note = ""
        """The L1's quaternion looks wrong for this reason, in words; nothing here drives by it."""
        self.restarts = 0
        """How often the robot's own clock started anew."""

    def warm_up(self) -> None:
        """Compile before the first sweep has to wait for it."""
        for lidar in self.lidars:
            lidar.warm_up()

    # -- draining --------------------------------------------------------------------------------------------------

    def read(self, now: int) -> list[ImuSample | JointSample | LidarScan]:
        """Everything that arrived, stamped on the host clock, in stamp order."""
        out: list[ImuSample | JointSample | LidarScan] = []
        for data in self._link.take(SPORT_STATE):
            self._guarded(SPORT_STATE, self._take_sport, data, now)
        lows, speakers = self._link.take(LOW_STATE), self._link.speakers(LOW_STATE)
        fresh = [
            self._guarded(LOW_STATE, partial(self._take_low, who), data, now)
            for data, who in zip(lows, speakers, strict=True)
        ]
        for low in fresh:  # after the clock has seen the whole batch: all of it was received by now
            out += self._low_samples(low, now) if low is not None else []
        if self._l1 is not None:
            for data in self._link.take(L1_IMU):
                out += self._guarded(L1_IMU, self._take_l1_imu, data, now) or []
        for lidar in self.lidars:
            for topic in lidar.inputs:
                for data in self._link.take(topic):
                    out += self._guarded(topic, partial(lidar.take, topic), data, now) or []
        out.sort(key=lambda sample: sample.stamp)
        return out

    def _guarded(self, topic, take, data: bytes, now: int):  # type: ignore[no-untyped-def]
        try:
            return take(data, now)
        except WireError as error:
            self.bad[topic] += 1
            if topic == LOW_STATE:
                self.low_unread = str(error)
            if self.bad[topic] in (1, 10, 100) or self.bad[topic] % 1000 == 0:
                log.warning("%s: unreadable message %d: %s", topic, self.bad[topic], error)
            return None

    def _take_sport(self, data: bytes, now: int) -> None:
        sport = view(data, SPORT_MODE_STATE_CDR)
        stamp = (int(sport["stamp"]["sec"]), int(sport["stamp"]["nanosec"]))
        if stamp != self._sport_stamp:  # a repeated stamp is a frozen publisher
            self._sport_stamp, self._sport_at, self.sport = stamp, now, sport
            self.motion.hear_sport(sport, now / NS)
            if self._log_raw and self.raw != self._raw:
                self._raw = self.raw
                log.info("sportmodestate: %s, taken as %s", self._raw, self.phase)

    def _take_low(self, who: int, data: bytes, now: int) -> np.void | None:
        """The message of a publisher if it is new, and of the robot that has the floor."""
        low = view(data, LOW_STATE_CDR)
        if self._options.check_crc and low["crc"] not in (0, low_state_checksum(data)):
            raise WireError("its checksum is wrong")
        self.low_unread = ""
        if not self._turns.counts((who, low["sn"].tobytes()), now):
            return None
        tick = self._unwrapped(low)
        if tick == self._tick and self.low is not None:
            return None  # frozen publisher: nothing new
        self._heard_at = now
        if not self.low_clock.hear(tick * 1_000_000, now):
            return None
        self._link_quality.heard(tick - self._tick if self.low is not None else 0, now)
        self._tick, self.low = tick, low
        self.motion.hear_low(low, now / NS)
        return low

    def _unwrapped(self, low: np.void) -> int:
        """[ms] Its tick as the nearest one to `_tick`, which does not run over."""
        return self._tick + (int(low["tick"]) - self._tick + 2**31) % 2**32 - 2**31

    def believe_clock(self, now: int) -> None:
        """The way to the robot is short, so its clock was set, as by a restart."""
        self.low_clock.restart(now)
        self.restarts += 1
        log.warning("LowState: %s", CLOCK_STEP.tell(source="the robot", step=self.low_clock.step / NS))

    def _low_samples(self, low: np.void, now: int) -> list[ImuSample | JointSample | LidarScan]:
        tick = int(low["tick"])
        self._elapsed += (tick - self._sampled) % 2**32  # of a restarted robot: far ahead, everything is due
        self._sampled = tick
        stamp = self.low_clock.date(self._unwrapped(low) * 1_000_000, now)
        out: list[ImuSample | JointSample | LidarScan] = []
        if self._is_due(IMU_PERIOD):
            imu, turn = low["imu_state"], self._imu_rotation
            gyro, accel = turn @ imu["gyroscope"], turn @ imu["accelerometer"]
            if not self._refuse("lowstate", self._checks["lowstate"].impossible(gyro, accel), now):
                out += self._imu("lowstate", stamp, now, gyro, accel)
        if self._is_due(JOINT_PERIOD):
            motors = low["motor_state"]
            q, dq, tau = (self._of_motors(motors[name]) for name in ("q", "dq", "tau_est"))
            self._take_state(low, now)
            lost, bits = self._of_motors(motors["lost"]), self._of_motors(motors["reserve"][:, 0])
            self._refuse("motors", lost_motor(lost, bits), now)
            if not self._refuse("joints", impossible_joints(q, dq, tau), now):
                out.append(JointSample(self._after(JointSample, stamp), q, dq, tau))
        return out

    def _of_motors(self, values: NDArray[Any]) -> Array:
        """(16,) in the order of `hal.limbs.MOTORS`; of motors that it has not, 0."""
        out = np.zeros(len(MOTORS))
        out[self._motors] = values[self._motors]
        return out

    def _take_state(self, low: np.void, now: int) -> None:
        charge, attitude = float(low["bms_state"]["soc"]), low["imu_state"]["quaternion"].astype(np.float64)
        if not self._refuse("battery", BATTERY.tell(value=charge) if BATTERY.outside(charge) else "", now):
            self.battery = charge / 100.0
        length = float(np.linalg.norm(attitude))
        if not self._refuse("attitude", ATTITUDE.tell(value=length) if ATTITUDE.outside(length) else "", now):
            self.upright = up_of(attitude)[2] > 0.5

    def _is_due(self, period: int) -> bool:
        """Once per `period` [ms] on average, also where LowState comes in steps that do not divide it."""
        due = self._due[period]
        if self._elapsed < due:
            return False
        self._due[period] = period + (due if self._elapsed < due + period else self._elapsed)
        return True

    def _imu(
        self, stream: str, stamp: int, now: int, gyro: Array, accel: Array
    ) -> list[ImuSample | JointSample | LidarScan]:
        """A possible sample, unless gravity contradicts it."""
        if self._refuse(stream, self._checks[stream].contradicted(stamp, gyro, accel), now):
            return []
        return [ImuSample(self._after(ImuSample, stamp), gyro, accel)] if self._options.imu == stream else []

    def _refuse(self, stream: str, reason: str, now: int) -> bool:
        if reason:
            self._refused[stream] = reason, now
            self.impossible += 1
        return bool(reason)

    def _after(self, kind: type, stamp: int) -> int:
        """`stamp`, or just after the last one of its kind: a better clock offset must not turn time back."""
        last = self._last.get(kind)
        if last is not None and last - NS < stamp <= last:
            stamp = last + 1
        self._last[kind] = stamp
        return stamp

    def _take_l1_imu(self, data: bytes, now: int) -> list[ImuSample | JointSample | LidarScan]:
        assert self._l1 is not None
        raw = decode_imu(data, self._options.l1_imu_wxyz)
        if raw.stamp == self._l1_stamp:
            return []  # frozen publisher: nothing new
        if not self._l1.clock.hear(raw.stamp, now, "imu"):
            return []
        self._l1_stamp = raw.stamp
        rotation = self._l1.rotation
        gyro, accel = rotation @ (raw.gyro - raw.gyro[2] * self._leak), rotation @ raw.accel
        if self._refuse("l1", self._checks["l1"].impossible(gyro, accel), now):
            return []
        self._judge_mount(raw, gyro, accel, now)
        if self._options.imu != "l1":
            return []
        return self._imu("l1", self._l1.clock.date(raw.stamp, now), now, gyro, accel)

    def _judge_mount(self, raw: RawImu, gyro: Array, accel: Array, now: int) -> None:
        """Compare gravity through the configured mount with the trunk's own, at rest."""
        if self.low is None or not np.abs(gyro).max() < 0.1:
            return
        if now - self._refused.get("lowstate", ("", -NS))[1] < NS:  # the trunk's tells nothing then
            self._gravity, self._own_gravity, self._gravity_count = np.zeros(3), np.zeros(3), 0
            return
        own = self._imu_rotation @ self.low["imu_state"]["accelerometer"]
        self._gravity += accel
        self._own_gravity += own  # as many samples as of the L1: a jolt is in both or in neither
        self._gravity_count += 1
        if self._gravity_count < MOUNT_SAMPLES:
            return
        error = _angle(self._own_gravity, self._gravity)
        self.mount_error = error if math.isfinite(error) else self.mount_error
        self._judge_order(raw)
        self._gravity, self._own_gravity, self._gravity_count = np.zeros(3), np.zeros(3), 0

    def _judge_order(self, raw: RawImu) -> None:
        """Whether the quaternion tells the gravity that the accelerometer feels only in the other order."""
        wxyz = self._options.l1_imu_wxyz
        other = raw.quaternion[[3, 0, 1, 2]] if wxyz else raw.quaternion[[1, 2, 3, 0]]
        agrees = [_angle(np.array(up_of(q)), raw.accel) < MOUNT_TOLERANCE for q in (raw.quaternion, other)]
        self.order_note = ""
        if agrees == [False, True]:
            order = "x, y, z, w" if wxyz else "w, x, y, z"
            self.order_note = (
                f"the L1 stores its quaternion {order}: set unitree.l1_imu_wxyz={str(not wxyz).lower()}"
            )

    def note(self, now: int) -> str:
        """What the newest samples lack, in words; empty when all is well."""
        told = [reason for reason, at in self._refused.values() if now - at < REFUSAL_TOLD]
        if (rate := self._link_quality.rate) is not None and LOW_RATE.outside(rate):
            told.append(LOW_RATE.tell(rate=rate))
        clock = self.low_clock
        if clock.stepped_at is not None and now - clock.stepped_at < STEP_TOLD:
            told.append(CLOCK_STEP.tell(source="the robot", step=clock.step / NS))
        return "; ".join(filter(None, [*told, self.lidar_note(now)]))

    def lidar_note(self, now: int) -> str:
        """Which LiDAR does not speak, in words, and where else clouds are sent, or whose stamps are wrong; empty when
        all is well."""
        notes = (self._silence.words(self.lidars, now), *(lidar.note(now) for lidar in self.lidars))
        return "; ".join(note for note in notes if note)

    def several(self, now: int) -> str:
        """The robots whose LowState comes by turns, in words; empty where one speaks."""
        return self._turns.words(now)

    def figures(self) -> dict[str, float]:
        """Figures for the operator: offsets of clocks [s] and the rate of LowState [Hz] as float, counters as int."""
        clocks = {"low_state": self.low_clock, **{f"lidar_{x.name}": x.clock for x in self.lidars}}
        return {
            **{f"{name}_clock_offset": c.offset / NS for name, c in clocks.items() if c.offset is not None},
            **self._link_quality.figures(),
            "clock_jumps": sum(clock.steps for clock in clocks.values()),
            "robot_restarts": self.restarts,
            "impossible_samples": self.impossible,
            **{f"lidar_{lidar.name}_empty": lidar.empty for lidar in self.lidars},
            **{f"lidar_{lidar.name}_missed": lidar.missed for lidar in self.lidars},
            **{f"lidar_{lidar.name}_frozen": lidar.frozen for lidar in self.lidars},
            **{f"lidar_{lidar.name}_untimed": lidar.untimed for lidar in self.lidars},
            **{f"lidar_{lidar.name}_refused": lidar.refused for lidar in self.lidars},
            **{f"unreadable {topic}": count for topic, count in self.bad.items()},
        }

    # -- values ----------------------------------------------------------------------------------------------------

    def low_age(self, now: int) -> float:
        """Seconds since the newest LowState was measured, by the robot's own clock; infinite before the first."""
        newest = self.low_clock.newest()
        return math.inf if newest is None else (now - newest) / NS

    def low_trouble(self, now: int) -> str:
        """Why LowState is old, in words."""
        silent = math.inf if self._heard_at is None else (now - self._heard_at) / NS
        late = self.low_clock.late()
        if self.low_clock.back and silent <= self._options.state_timeout:
            return (
                CLOCK_STEP.tell(source="the robot", step=-self.low_clock.back)
                + ", waiting for prompt answers"
            )
        if late > silent:
            return CLOCK_DRIFT.tell(late=late)
        why = f"unreadable, {self.low_unread}" if self.low_unread else "check cable and robot"
        return f"no LowState for {silent:.1f} s: {why}"

    def sport_age(self, now: int) -> float:
        """Seconds since the last sportmodestate with a new stamp; infinite before the first."""
        return math.inf if self._sport_at is None else (now - self._sport_at) / NS

    @property
    def mode(self) -> int:
        """Mode of the sport service (0 idle, 1 balance, 2 pose, 3 locomotion, 5 lying, 6 locked, 7 damping, 8
        recovery)."""
        return -1 if self.sport is None else int(self.sport["mode"])

    @property
    def told(self) -> Phase | None:
        """The posture that newer firmware tells in `error_code`; None where the code is not among `state_codes`."""
        code = -1 if self.sport is None else int(self.sport["error_code"])
        return Phase(self._options.state_codes[code]) if code in self._options.state_codes else None

    @property
    def phase(self) -> Phase:
        """The robot's posture: damped, sitting, standing (with locked joints) or ready for Move."""
        if self.told is not None:
            return self.told
        if self.mode == 7:
            return Phase.DAMPED
        if self.mode in (5, 10) or not self._high:
            return Phase.SITTING
        return Phase.READY if self.mode in (1, 2, 3) else Phase.STANDING

    @property
    def standing_tall(self) -> bool:
        """Whether it is on its feet, by its own word or else by the height of its body."""
        return self._high if self.told is None else self.told not in LYING

    @property
    def _high(self) -> bool:
        return self.sport is not None and float(self.sport["body_height"]) > 0.2

    @property
    def raw(self) -> str:
        """The raw values that tell the posture, as the robot sends them."""
        if self.sport is None:
            return "no sportmodestate"
        sport, height = self.sport, float(self.sport["body_height"])
        return (
            f"error_code {int(sport['error_code'])}, mode {self.mode}, "
            f"gait_type {int(sport['gait_type'])}, body_height {height:.1f} m"
        )

    @property
    def speed(self) -> float:
        """Measured planar speed [m/s]; the larger of the sport service's estimate and the wheels' mean."""
        estimate = 0.0 if self.sport is None else math.hypot(*map(float, self.sport["velocity"][:2]))
        wheels, rolls_on = 0.0, self._options.wheels
        if self.low is not None and rolls_on is not None:
            wheels = abs(float(self.low["motor_state"]["dq"][WHEEL_SLOTS].mean())) * rolls_on.radius
        return max(v for v in (estimate, wheels, 0.0) if math.isfinite(v))

    @property
    def yaw_rate(self) -> float:
        """Measured [rad/s], magnitude."""
        return 0.0 if self.low is None else abs(float(self.low["imu_state"]["gyroscope"][2]))

    @property
    def motor_temperature(self) -> float:
        """Hottest of its motors [deg C]."""
        return 0.0 if self.low is None else float(self.low["motor_state"]["temperature"][self._motors].max())

    @property
    def remote(self) -> bool:
        """Whether somebody moves a stick of the robot's own remote."""
        return self.low is not None and remote(self.low)

    @property
    def contact(self) -> tuple[bool, bool, bool, bool]:
        """Wheel or foot on ground, FR FL RR RL. A robot without foot sensors reports zeros: taken as contact."""
        if self.low is None or not self.low["foot_force"].any():
            return True, True, True, True
        fr, fl, rr, rl = (bool(force > 20) for force in self.low["foot_force"])
        return fr, fl, rr, rl
