"""Checks of inputs as a table, one row each: what is watched, what is allowed, what happens beyond, what the operator
reads.

The code that judges asks the row (`outside`, `tell`) and spells no limit and no sentence of its own. Checks that are no
rows yet, such as the gate's timeouts, tilt, fence and stop zone, stand in the code and in `docs/operate/safety.md`.
The site shows this table as a page; the health of processes and `tools.bench faults` read it. A limit that an
operator may set stands in the configuration, and the row names its field.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from string import Formatter


class Check(StrEnum):
    """What a monitor compares."""

    RANGE = "range"
    """A value with what is possible or usual, in its unit."""
    AGE = "age"
    """A stamp with the clock."""
    CLOCK = "clock"
    """A remote clock with ours: drift, delay, steps."""
    REPEAT = "repeat"
    """A payload with the ones before: a stream that repeats itself is dead."""
    AGREEMENT = "agreement"
    """A stream with another that must tell the same."""
    OWNER = "owner"
    """A publisher with the one that a topic belongs to."""
    CONTACT = "contact"
    """A force or a held wheel with what the map explains."""


class Consequence(StrEnum):
    """What happens, from the mildest on."""

    TELL = "tell"
    """`status` says it; nothing else changes."""
    DEGRADE = "degrade"
    """The input is not used; localisation is `degraded`."""
    HOLD = "hold"
    """Zero velocity while it lasts."""
    LATCH = "latch"
    """Zero velocity until `resume`."""
    LOST = "lost"
    """The pose is not known: zero velocity, the goal ends."""
    REFUSE = "refuse"
    """The message, file or start is refused."""


@dataclass(frozen=True, slots=True)
class Monitor:
    """One row."""

    name: str
    """Unique; `tools.bench faults --without NAME` takes it out."""
    stream: str
    """What is watched, as operators call it."""
    check: Check
    consequence: Consequence
    judge: str
    """The process that judges."""
    words: str
    """What the operator reads; a format string that is filled by `tell`."""
    remedy: str
    """What the operator does about it."""
    low: float = -math.inf
    high: float = math.inf
    """Allowed from `low` to `high`, in `unit`; infinite where a setting or another row decides."""
    unit: str = ""
    setting: str = ""
    """The field of the configuration that holds the limit, such as `gate.sensor_timeout.imu`."""
    against: str = ""
    """The stream that it is compared with."""
    test: str = ""
    """The test that was seen to fail without it, below `tests/`."""

    def outside(self, value: float, low: float | None = None, high: float | None = None) -> bool:
        """Whether `value` is beyond what is allowed; what is no number is. `low`, `high`: limits from the
        configuration.

        Never where the monitor was taken out, see `taken_out`.
        """
        if self.name in _OUT:
            return False
        low, high = self.low if low is None else low, self.high if high is None else high
        return not low <= value <= high

    @property
    def active(self) -> bool:
        """False only where a bench took it out: for checks that `outside` cannot express."""
        return self.name not in _OUT

    def tell(self, **values: object) -> str:
        """The operator's words, with what was found; `low` and `high` of the row come by themselves."""
        return self.words.format(**{"low": self.low, "high": self.high, **values})


@cache
def _pattern(words: str) -> re.Pattern[str]:
    """What `words` look like once they are filled."""
    return re.compile(
        "".join(
            re.escape(text) + (".+?" if field is not None else "")
            for text, field, *_ in Formatter().parse(words)
        )
    )


def raised(text: str) -> list[Monitor]:
    """The monitors whose words stand in `text`: causes, holds and reasons travel as words, for people and logs
    alike."""
    return [monitor for monitor in MONITORS if _pattern(monitor.words).search(text)]


_OUT: set[str] = set()
"""Monitors that a bench took out, to show that its rows fail without them. No configuration reaches this."""


@contextmanager
def taken_out(*names: str) -> Iterator[None]:
    """Without these monitors, in this process. For `tools.bench faults --without` and its tests. Raises KeyError for an
    unknown name."""
    for name in names:
        BY_NAME[name]
    _OUT.update(names)
    try:
        yield
    finally:
        _OUT.difference_update(names)


# One block per area, in the order in which data flows. Rows are constants, so that the judge names its row.

# -- clocks and streams of the robot ---------------------------------------------------------------------------------
GUARD_BLIND = Monitor(
    "guard is blind",
    stream="/cloud/main, /cloud/head",
    check=Check.AGE,
    consequence=Consequence.HOLD,
    judge="guard",
    words="no sweep of any LiDAR for {age} s: nobody sees what steps into the way",
    remedy="power, cable and driver of the LiDARs; `status` lists their topics",
    low=-0.5,
    high=0.5,
    unit="s",
    against="clock",
    test="rbtrg_robot/stages/test_guard.py",
)
MAIN_SILENT = Monitor(
    "main LiDAR is silent",
    stream="/cloud/main",
    check=Check.AGE,
    consequence=Consequence.TELL,
    judge="guard",
    words="the main LiDAR is silent for {age} s: 0.2 m/s and 0.3 rad/s at most, only the head's LiDAR sees what steps into the way",
    remedy="power, cable and driver of the main LiDAR; `status` lists its topic",
    low=-0.5,
    high=0.5,
    unit="s",
    against="clock",
    test="rbtrg_robot/stages/test_guard.py",
)
TRACKER_STALE = Monitor(
    "tracker's inputs",
    stream="/odom/fast, /odom, /elevation_map/status, /goal/status",
    check=Check.AGE,
    consequence=Consequence.HOLD,
    judge="tracker",
    words="{topic} tells of {age} s ago, limit {limit} s",
    remedy="if it lasts: `status` shows which process is slow or silent, its log says why",
    setting="freshness",
    against="clock",
    test="rbtrg_robot/stages/test_tracker.py",
)
CLOCK_DRIFT = Monitor(
    "clock drift",
    "LowState, clouds, IMU of the L1",
    Check.CLOCK,
    Consequence.HOLD,
    "robot",
    "telemetry of the robot arrives {late:.1f} s late",
    "look at the network and at the load of this computer; it goes on when messages are on time again. If none was slow, the clock of the "
    "robot was set: restart the stack",
    high=100.0,  # two crystals of 50 ppm each; temperature is in that figure
    unit="ppm that an offset grows",
    against="the receive times",
    test="hal/unitree/test_clock.py",
)
CLOCK_STEP = Monitor(
    "clock step",
    "LowState, clouds, IMU of the L1",
    Check.CLOCK,
    Consequence.TELL,
    "robot",
    "the clock of {source} stepped by {step:+.2f} s",
    "nothing, it is followed; if it repeats, find out what sets that clock (`trust_stamps: false` drives without a LiDAR's)",
    against="the receive times, the round trip of a request",
    test="hal/unitree/test_clock.py",
)
SWEEP_LATE = Monitor(
    "late sweeps",
    "clouds",
    Check.AGE,
    Consequence.TELL,
    "robot",
    "sweeps of the {name} LiDAR arrive {late:.1f} s late",
    "look at its network and driver. If its clock was set while it was silent: restart the stack, or `trust_stamps: false`",
    high=0.3,  # the guard's reaction, for which speeds are chosen
    unit="s later than the shortest way",
    against="the receive times",
    test="hal/unitree/test_backend.py",
)
POINT_TIMES = Monitor(
    "point times",
    "clouds",
    Check.RANGE,
    Consequence.REFUSE,
    "robot, odometry",
    "point field {field!r} holds {held}: not the times of a sweep",
    "set the driver to a time per point, in seconds, milli-, micro- or nanoseconds, relative to the header or absolute",
    low=0.01,  # 50 Hz, half of the turn empty
    high=0.6,  # 2 Hz
    unit="s from the first point to the last",
    test="hal/test_sweep_times.py",
)
ACCELERATION = Monitor(
    "acceleration",
    "IMU, IMU of the L1",
    Check.RANGE,
    Consequence.REFUSE,
    "robot, odometry",
    "{stream}: an acceleration of {value:.3g} m/s^2, possible are {low:g} to {high:g}",
    "the sensor or its driver is broken: replace it, or `unitree.imu` of the other one",
    low=-400.0,  # 40 g, the widest range of inertial sensors (ADXL357); a fall onto concrete reaches 30 g
    high=400.0,
    unit="m/s^2",
    test="hal/test_plausible.py",
)
TURN_RATE = Monitor(
    "turn rate",
    "IMU, IMU of the L1",
    Check.RANGE,
    Consequence.REFUSE,
    "robot, odometry",
    "{stream}: a turn rate of {value:.3g} rad/s, possible are {low:g} to {high:g}",
    "the sensor or its driver is broken, or it tells degrees: replace it, or `unitree.imu` of the other one",
    low=-35.0,  # 2000 deg/s, the widest range of such sensors
    high=35.0,
    unit="rad/s",
    test="hal/test_plausible.py",
)
GRAVITY_SIZE = Monitor(
    "size of gravity",
    "IMU",
    Check.RANGE,
    Consequence.REFUSE,
    "robot, odometry",
    "{stream} measures {value:.1f} m/s^2 on average, gravity has 9.8: its unit is wrong",
    "set its driver to m/s^2",
    low=4.9,  # half a second of braking, of a shock or of falling stays within half of gravity
    high=14.7,
    unit="m/s^2",
    against="gravity",
    test="hal/test_plausible.py",
)
GRAVITY_SIDE = Monitor(
    "side of gravity",
    "IMU",
    Check.AGREEMENT,
    Consequence.REFUSE,
    "robot, odometry",
    "{stream}: gravity is {value:.0f} deg from where its gyro tells: signs or units are wrong",
    "look at the driver of the IMU; stand the robot up and restart the stack",
    high=60.0,  # a wrong axis is off by 90
    unit="deg",
    against="its gyro",
    test="hal/test_plausible.py",
)
UPRIGHT = Monitor(
    "upright at the start",
    "IMU",
    Check.RANGE,
    Consequence.REFUSE,
    "robot, odometry",
    "{stream} tells that the robot lies on its side or back, tilted by {value:.0f} deg",
    "set it on its feet or its belly; where it stands already, the signs or axes of the IMU are wrong: see its driver and `unitree.imu_yaw`",
    high=60.0,  # beyond it the robot counts as fallen
    unit="deg, until it was upright once",
    test="hal/test_plausible.py",
)
JOINT_SPEED = Monitor(
    "joint speed",
    "joints",
    Check.RANGE,
    Consequence.REFUSE,
    "robot, odometry",
    "joints: {motor} tells {value:.3g} rad/s, possible are {low:g} to {high:g}",
    "look at this motor and its encoder",
    low=-200.0,  # five times what the motors reach
    high=200.0,
    unit="rad/s",
    test="hal/test_plausible.py",
)
JOINT_ANGLE = Monitor(
    "joint angle",
    "joints",
    Check.RANGE,
    Consequence.REFUSE,
    "robot, odometry",
    "joints: {motor} tells an angle of {value:.3g} rad, possible are {low:g} to {high:g}",
    "look at this motor and its encoder",
    low=-7.0,  # no joint of a leg turns all the way round
    high=7.0,
    unit="rad",
    test="hal/test_plausible.py",
)
JOINT_TORQUE = Monitor(
    "joint torque",
    "joints",
    Check.RANGE,
    Consequence.REFUSE,
    "robot, odometry",
    "joints: {motor} tells {value:.3g} Nm, possible are {low:g} to {high:g}",
    "look at this motor and its driver",
    low=-400.0,  # nine times the strongest motor of these robots
    high=400.0,
    unit="Nm",
    test="hal/test_plausible.py",
)
LOW_RATE = Monitor(
    "rate of LowState",
    "LowState",
    Check.RANGE,
    Consequence.TELL,
    "robot",
    "LowState comes {rate:.0f} times a second, usual are 500: a touch or a wheel that rolls on is felt late",
    "look at the network and at the load of this computer",
    low=100.0,  # a touch is felt in 0.05 s: five samples
    unit="Hz over a second",
    test="hal/unitree/test_telemetry.py",
)
BATTERY = Monitor(
    "battery",
    "LowState",
    Check.RANGE,
    Consequence.TELL,
    "robot",
    "the battery tells {value:.0f} %, possible are {low:.0f} to {high:.0f}: how much is left is not known",
    "look at the vendor's app before a long way",
    low=0.0,
    high=100.0,
    unit="%",
    test="hal/unitree/test_telemetry.py",
)
ATTITUDE = Monitor(
    "attitude",
    "LowState",
    Check.RANGE,
    Consequence.TELL,
    "robot",
    "the robot's own attitude is a quaternion of length {value:.2g}, it must be 1: whether it has fallen is told by the stack's IMU alone",
    "restart the robot",
    low=0.9,
    high=1.1,
    unit="length",
    test="hal/unitree/test_telemetry.py",
)
MOTOR_LOST = Monitor(
    "lost motor messages",
    "LowState",
    Check.RANGE,
    Consequence.TELL,
    "robot",
    "motor {motor} has lost {value} messages, error bits {bits:#x}",
    "look at the cables of this leg and at the vendor's app before the robot drives on",
    high=1000.0,  # two seconds of 500 Hz
    unit="messages since it was switched on",
    test="hal/unitree/test_backend.py",
)

# -- localisation ----------------------------------------------------------------------------------------------------
LIDAR_REPEATS = Monitor(
    "lidar_repeats",
    "LiDAR",
    Check.REPEAT,
    Consequence.LOST,
    "odometry",
    "the {name} LiDAR repeats its sweep: its stamps go on, its points do not",
    "power the LiDAR off and on, or restart its driver",
    high=1,
    unit="sweeps in a row; each one that repeats another of the last 512 is refused",
    test="mapping/odometry/test_inputs_that_lie.py",
)
IMU_REPEATS = Monitor(
    "imu_repeats",
    "IMU",
    Check.REPEAT,
    Consequence.LOST,
    "odometry",
    "the IMU repeats its sample: its stamps go on, its values do not",
    "restart the robot; drive it by hand to a safe place with care",
    high=4,
    unit="samples in a row; at most 2 where a driver tells each sample more than once",
    test="mapping/odometry/test_inputs_that_lie.py",
)
IMU_PART_REPEATS = Monitor(
    "imu_part_repeats",
    "IMU",
    Check.REPEAT,
    Consequence.LOST,
    "odometry",
    "the {name} of the IMU repeats its value: the IMU's stamps go on, this part of it is dead",
    "restart the robot; drive it by hand to a safe place with care",
    high=24,  # three axes at rest may well agree for some samples
    unit="samples in a row",
    test="mapping/odometry/test_inputs_that_lie.py",
)
JOINTS_REPEAT = Monitor(
    "joints_repeat",
    "joints",
    Check.REPEAT,
    Consequence.DEGRADE,
    "odometry",
    "the joints repeat their sample: their stamps go on, their values do not",
    "restart the robot",
    high=4,
    unit="samples in a row",
    test="mapping/odometry/test_inputs_that_lie.py",
)
IMPOSSIBLE_SPEED = Monitor(
    "impossible_speed",
    "odometry",
    Check.RANGE,
    Consequence.LOST,
    "odometry",
    "the pose moves at {speed:.1f} m/s, as no robot can: accelerometer or wheels tell what cannot be",
    "let the robot stand; if it comes again, restart the stack and look at the IMU",
    high=1.0,
    unit="of 4 m/s gained in a sweep, or 1.6 m/s up or down with wheels on the ground",
    test="mapping/odometry/test_inputs_that_lie.py",
)
IMU_DISAGREES = Monitor(
    "imu_disagrees",
    "IMU",
    Check.AGREEMENT,
    Consequence.LOST,
    "odometry",
    "without a scan that fits, over {seconds:.0f} s the accelerometer leads {moved:.2f} m from where each wheel does: one of them is wrong",
    "let the robot stand; if it comes again, look at the IMU and its driver",
    high=1.0,
    unit="of 0.4 m over a second",
    against="wheels",
    test="mapping/odometry/test_inputs_that_lie.py",
)
SCANS_DISAGREE = Monitor(
    "scans_disagree",
    "LiDAR",
    Check.AGREEMENT,
    Consequence.DEGRADE,
    "odometry",
    "over {seconds:.0f} s the scans lead {moved:.2f} m and {turned:.0f} deg from where each wheel and the gyro do: all wheels slip, or what the LiDAR shows is not where the robot is",
    "look whether the wheels spin; if not, restart the stack",
    high=1.0,
    unit="of 0.4 m or 6 deg over a second",
    against="wheels, IMU",
    test="mapping/odometry/test_inputs_that_lie.py",
)
GROUND_HEIGHT = Monitor(
    "height of the ground",
    "LiDAR",
    Check.AGREEMENT,
    Consequence.LOST,
    "odometry",
    "the {name} LiDAR sees level ground {seen:.2f} m {side} itself, by the legs it lies {told:.2f} m below it: "
    "its unit or its mount is wrong, or the robot stands in a pit or on a plinth",
    "set its driver to metres, and look whether it is mounted as the configuration says; "
    "put the robot onto level ground",
    low=0.6,  # a robot may start on a pallet, or between kerbs; a foot, half or twice a metre is far beyond
    high=1.6,
    unit="of what the legs tell, until it was once within",
    against="legs",
    test="mapping/odometry/test_ground_height.py",
)
SCANS_SCALE = Monitor(
    "scans_scale",
    "LiDAR",
    Check.AGREEMENT,
    Consequence.DEGRADE,
    "odometry",
    "over {way:.1f} m of the wheels the scans lead {off:.2f} m from where each wheel does: the LiDAR's distances are wrong, or all wheels slip",
    "look whether the wheels spin; if not, look at the unit in which the LiDAR's driver tells distances",
    high=0.3,  # where all wheels slip on steps 0.23 was seen; another unit is off by a half or more
    unit="m over a metre of the wheels",
    against="wheels",
    test="mapping/odometry/test_inputs_that_lie.py",
)
SCANS_MIRRORED = Monitor(
    "scans mirrored",
    "LiDAR",
    Check.AGREEMENT,
    Consequence.LOST,
    "odometry",
    "the robot turned by {gyro:.0f} deg by the gyro, the scans turned by {scans:.0f} deg the other way: the {name} LiDAR tells left for right, or the gyro's z axis is reversed",
    "mend the axes in the LiDAR's driver or in that of the IMU, and restart the stack",
    low=-0.3,
    unit="of the gyro's turn over 8 deg",
    against="IMU",
    test="mapping/odometry/test_inputs_that_lie.py",
)
MOVED_WHILE_STILL = Monitor(
    "moved_while_still",
    "LiDAR",
    Check.AGREEMENT,
    Consequence.DEGRADE,
    "odometry",
    "wheels and gyro stand still, the scans moved by {moved:.2f} m and {turned:.0f} deg: is the robot carried, or its floor moving?",
    "put the robot on firm ground; people who walk past are not taken for it",
    high=10,
    unit="scans in a row",
    against="wheels, IMU",
    test="mapping/odometry/test_inputs_that_lie.py",
)

STAMP_AHEAD = Monitor(
    "stamp ahead",
    "IMU, joints",
    Check.AGE,
    Consequence.REFUSE,
    "odometry",
    "{stream}: a stamp {value:.1f} s ahead of the one before",
    "nothing, it was one; where it lasts, look at the clock of this driver",
    high=0.2,  # forty periods of the IMU, ten of the joints; a real gap of the stream is taken after three samples
    unit="s",
    against="the samples that follow",
    test="mapping/odometry/test_intake.py",
)
SWEEP_CLOCK = Monitor(
    "clock of the sweeps",
    "clouds",
    Check.AGREEMENT,
    Consequence.DEGRADE,
    "odometry",
    "the clock of the {name} LiDAR is {value:+.2f} s off the IMU's, its sweeps are not used",
    "restart the driver of this LiDAR, then the stack; a clock that is set while it runs must not feed odometry",
    low=-0.05,  # up to here odometry finds the offset by itself (`odometry.max_time_offset`)
    high=0.2,  # topics come out of step by up to 0.15 s on a busy computer
    unit="s",
    against="the stamps of the IMU",
    test="mapping/odometry/test_intake.py",
)

# -- map, contact, what the robot feels ------------------------------------------------------------------------------
TOUCHED = Monitor(
    "touched", "joints and IMU", Check.CONTACT, Consequence.HOLD, "robot",
    "touched something that the LiDAR does not see at {where}",
    "look at the place; drive around it, or forget it with `rbtrg-robot map clear`",
    high=30.0, unit="N", against="map", test="hal/safety/test_touch.py",
)  # fmt: skip
HOLE_WIDTH = Monitor(
    "width of a hole", "elevation map", Check.RANGE, Consequence.HOLD, "elevation",
    "a hole that is too wide to cross",
    "drive around it, or lay something over it",
    setting="graph.max_gap", against="rims on both sides", test="mapping/elevation/test_holes.py",
)  # fmt: skip

OWN_PARTS = Monitor(
    name="own parts",
    stream="LiDAR sweeps",
    check=Check.REPEAT,
    consequence=Consequence.TELL,
    judge="odometry",
    words="the LiDARs see something that moves with the robot and holds its turns: set own_parts: [{parts}]",
    remedy="take it off, or set own_parts in the configuration; `rbtrg-robot calibrate lidar` writes it",
    setting="own_parts",
    against="odometry",
    test="mapping/odometry/test_own.py",
)

# -- commands and who gives them -------------------------------------------------------------------------------------
ROLLS_ON = Monitor(
    "rolls on",
    stream="rt/lowstate, rt/sportmodestate",
    check=Check.AGREEMENT,
    consequence=Consequence.LATCH,
    judge="robot, guardian, sentry",
    words="StopMove is not followed: {speed} after {after}",
    remedy="use the hardware stop; find out who else commands the robot, then `posture recover` and `resume`",
    high=0.05,
    unit="m/s",
    against="StopMove",
    test="hal/unitree/test_motion.py",
)
MOVES_UNTOLD = Monitor(
    "moves untold",
    stream="/odom/fast, /joint_states",
    check=Check.AGREEMENT,
    consequence=Consequence.LATCH,
    judge="robot",
    words="it moves by {speed} m/s at a command of zero",
    remedy="somebody else drives or pushes the robot, it slides, or odometry errs: find out, then `resume`",
    setting="gate.moving_speed",
    against="/cmd_vel",
    test="hal/safety/test_gate.py",
)
TWO_ROBOTS = Monitor(
    "two robots",
    stream="rt/lowstate, rt/api/sport/response",
    check=Check.OWNER,
    consequence=Consequence.REFUSE,
    judge="robot",
    words="more than one robot on this DDS domain: {found}",
    remedy="unplug one of them, or give it another DDS domain (`unitree.domain`); then `posture recover` and `resume`",
    test="hal/unitree/test_two_robots.py",
)
OLD_HANDS = Monitor(
    "old hands",
    stream="/teleop/cmd_vel, /teleop/trunk",
    check=Check.AGE,
    consequence=Consequence.HOLD,
    judge="robot",
    words="their sender saw the robot {age} s ago, limit {high:.1f} s",
    remedy="let go until the link is quicker; move nearer",
    low=0.0,
    high=0.5,
    unit="s",
    against="/robot/state",
    test="rbtrg_robot/stages/test_robot.py",
)
BLIND_HANDS = Monitor(
    "blind hands",
    stream="/teleop/cmd_vel, /teleop/trunk",
    check=Check.AGE,
    consequence=Consequence.HOLD,
    judge="robot",
    words="the stamp is {stamp}, none that the robot told",
    remedy="set header.stamp to the newest stamp of the robot that was seen, for example of /robot/state (docs/operate/ros.md)",
    against="/robot/state",
    test="rbtrg_robot/stages/test_robot.py",
)

STRANGER = Monitor(
    "stranger",
    "every topic with an owner",
    Check.OWNER,
    Consequence.REFUSE,
    "every process",
    "{topic} also comes from {who}, which is refused: it belongs to {owner}",
    "end that program; where it is to replace the process, bring the stack up with `--without` it",
    against="the process that owns the topic",
    test="rbtrg_robot/wire/test_owner.py",
)

# -- goals -----------------------------------------------------------------------------------------------------------
PLACE_UNSURE = Monitor(
    "place_unsure",
    "odometry",
    Check.AGREEMENT,
    Consequence.TELL,
    "navigator",
    "the robot's place is known within {place:.2f} m (two standard deviations), the goal asks for {asked:.2f} m",
    "drive where the LiDAR sees walls or posts, or set the pose; or ask for less: navigator.goal_tolerance",
    setting="navigator.goal_tolerance",
    against="the goal's tolerance",
    test="rbtrg_robot/stages/navigation/test_navigator.py",
)
GOAL_SPENT = Monitor(
    name="goal without progress",
    stream="goal",
    check=Check.RANGE,
    consequence=Consequence.TELL,
    judge="navigator",
    words="nowhere new in {seconds:.0f} s",
    remedy="choose another goal, or clear the way; the last hindrance stands beside it",
    against="places where the robot was for this goal",
    test="rbtrg_robot/stages/navigation/test_navigator.py",
)


MONITORS: tuple[Monitor, ...] = tuple(v for v in dict(globals()).values() if isinstance(v, Monitor))
BY_NAME: dict[str, Monitor] = {monitor.name: monitor for monitor in MONITORS}
