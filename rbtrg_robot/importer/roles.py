"""Roles in a foreign bag: which topic is the LiDAR, the IMU, the wheels; by type, rate, frame and contents.

A role that two topics could fill is not guessed: the operator names it with `--map ROLE=TOPIC`."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hal.errors import OperatorError
from hal.limbs import MOTORS
from hal.types import GRAVITY, NS
from hal.unitree.api import WireError
from hal.unitree.cloud import TIME_NAMES, RawCloud, decode_cloud
from hal.unitree.livox import decode_livox
from rbtrg_robot import msg
from rbtrg_robot.importer.bag import Bag, Source
from rbtrg_robot.importer.mounts import Frames
from rbtrg_robot.wire.messages import MessageError, decode, stamp_of

LIVOX = ("livox_ros_driver2/msg/CustomMsg", "livox_ros_driver/msg/CustomMsg")
CLOUD = msg.PointCloud2.__msgtype__
PROBE_MESSAGES = 60
"""Messages of a topic that are looked at."""
PROBE_SPAN = 15 * NS
"""[ns] of the recording that are looked at, at least."""
POINT_RATIO = 1.5
"""A LiDAR that gives so many times the points of another is the main one, without a question."""
IN_G = 0.5, 2.0
"""Mean of an accelerometer that counts in g lies between these; one in m/s^2 is at 9.8."""
TURNED_ANGLE = 0.35
"""Angle [rad] between what gravity says is up and the z axis of base_link from which the axes are told to differ."""


@dataclass(frozen=True, slots=True)
class Role:
    """What a topic can be for us."""

    name: str
    types: tuple[str, ...]
    cost: str
    """What a log that lacks it cannot do."""


ROLES = (
    Role("main", (CLOUD, *LIVOX), "no map; the place by wheels and IMU alone, which drifts"),
    Role("head", (CLOUD, *LIVOX), "nothing sees the ground at the feet"),
    Role("imu", (msg.Imu.__msgtype__,), "LiDAR alone, at constant velocity: up is where the first scan had "
        "it, quick turns are found late"),
    Role("joints", (msg.JointState.__msgtype__,), "no legs: no height of the ground below the wheels"),
    Role("wheels", (msg.Odometry.__msgtype__, msg.TwistStamped.__msgtype__), "nothing helps where the LiDAR "
        "sees too little"),
    Role("tf", (msg.TFMessage.__msgtype__,), "mounts must be told (--mount, --urdf)"),
    Role("camera", ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"), "nothing: no stage reads one"),
    Role("fix", ("sensor_msgs/msg/NavSatFix",), "nothing: no stage reads one"),
)  # fmt: skip
BY_NAME = {role.name: role for role in ROLES}
HANDED_ON = ("camera", "fix")
"""Roles that may have any number of topics: they are copied as they are."""
NAMED = ("main", "head", "imu", "joints", "wheels")
"""Roles whose topic `--map` says; of the others every topic is taken."""
MOUNTED = ("main", "head", "imu")
"""Roles whose place on the robot counts."""


class RoleError(OperatorError):
    """A role cannot be filled as asked, or two topics could fill it."""


@dataclass(slots=True)
class Probe:
    """What the first messages of a topic tell."""

    source: Source
    frame: str = ""
    seen: int = 0
    broken: str = ""
    stamps: list[int] = field(default_factory=list)
    """Of the messages [ns]."""
    offsets: list[int] = field(default_factory=list)
    """Recorded minus stamped [ns]."""
    points: list[int] = field(default_factory=list)
    fields: tuple[str, ...] = ()
    accel: list[np.ndarray] = field(default_factory=list)
    moving: bool = False
    motors: bool = False

    @property
    def rate(self) -> float:
        """[Hz]."""
        span = (max(self.stamps) - min(self.stamps)) / NS if self.stamps else 0.0
        return (len(self.stamps) - 1) / span if span > 0 else 0.0

    @property
    def offset(self) -> int:
        """Least time from the stamp to the record [ns]: what the two clocks differ by."""
        return min(self.offsets, default=0)

    @property
    def timed(self) -> bool:
        """Its points carry their times: a sweep as a driver sends it, not a cloud that somebody made of sweeps."""
        return any(name in self.fields for name in TIME_NAMES)

    @property
    def weight(self) -> float:
        """Points a second."""
        return float(np.mean(self.points)) * max(self.rate, 1.0) if self.points else 0.0

    @property
    def in_g(self) -> bool:
        """The accelerometer counts in g."""
        return bool(self.accel) and IN_G[0] < float(np.linalg.norm(self.accel, axis=1).mean()) < IN_G[1]

    @property
    def about(self) -> str:
        """For the table."""
        if self.broken:
            return self.broken
        words = [f"{self.rate:.4g} Hz" if self.rate else f"{self.seen} messages"]
        if self.points:
            words.append(f"{np.mean(self.points):.0f} points, {layout(self.fields)}")
        if self.accel:
            words.append("in g" if self.in_g else "m/s^2")
        if self.frame:
            words.append(f"frame {self.frame}")
        return ", ".join(words)


def layout(fields: tuple[str, ...]) -> str:
    """Whose layout the fields of a cloud are."""
    names = set(fields)
    if "offset_time" in names or {"tag", "line"} <= names:
        return "Livox"
    if {"t", "reflectivity"} <= names:
        return "Ouster"
    if {"timestamp", "ring"} <= names:
        return "Hesai or RoboSense"
    if {"time", "ring"} <= names:
        return "Velodyne or Unitree L1"
    return "points with time" if names & set(TIME_NAMES) else "points without time"


def read_cloud(source: Source, data: bytes) -> RawCloud:
    """A cloud of any driver. Raises WireError."""
    return decode_livox(data) if source.type in LIVOX else decode_cloud(data)


def probe(bag: Bag, frames: Frames) -> dict[str, Probe]:
    """The first messages of every topic that could have a role; `frames` takes the transforms among them."""
    wanted = {kind for role in ROLES for kind in role.types}
    found = {s.topic: Probe(s) for s in bag.sources if s.type in wanted and s.encoding == "cdr"}
    begin: int | None = None
    for source, log_time, _stamp, data in bag.messages(found):
        begin = log_time if begin is None else begin
        one = found[source.topic]
        if source.type == msg.TFMessage.__msgtype__:
            one.seen += 1
            if "static" in source.topic:
                try:
                    frames.take(decode(data, msg.TFMessage))
                except MessageError as error:
                    one.broken = str(error)
        elif one.seen < PROBE_MESSAGES:
            one.seen += 1
            try:
                _look(one, source, log_time, data)
            except (WireError, MessageError) as error:
                one.broken = str(error)
        missing = [
            p for p in found.values() if p.seen < min(PROBE_MESSAGES, p.source.count or PROBE_MESSAGES)
        ]
        if log_time - begin > PROBE_SPAN and all(p.seen == 0 for p in missing):
            break
    bag.damage.clear()
    for one in found.values():
        if one.stamps:  # a few that are broken are left out later, and counted
            one.broken = ""
    return found


def _look(one: Probe, source: Source, log_time: int, data: bytes) -> None:
    stamp = log_time
    if source.type == CLOUD or source.type in LIVOX:
        cloud = read_cloud(source, data)
        stamp, one.frame = cloud.stamp, cloud.frame
        one.fields = cloud.points.dtype.names or ()
        one.points.append(len(cloud.points))
    elif source.type == msg.Imu.__msgtype__:
        message = decode(data, msg.Imu)
        stamp, one.frame = stamp_of(message), message.header.frame_id
        a = message.linear_acceleration
        one.accel.append(np.array([a.x, a.y, a.z]))
    elif source.type == msg.JointState.__msgtype__:
        joints = decode(data, msg.JointState)
        stamp, one.motors = stamp_of(joints), set(MOTORS) <= set(joints.name)
    elif source.type == msg.Odometry.__msgtype__:
        odometry = decode(data, msg.Odometry)
        stamp, one.frame = stamp_of(odometry), odometry.child_frame_id
        v = odometry.twist.twist.linear
        one.moving |= abs(v.x) + abs(v.y) > 1e-3
    elif source.type == msg.TwistStamped.__msgtype__:
        twist = decode(data, msg.TwistStamped)
        stamp, one.frame, one.moving = stamp_of(twist), twist.header.frame_id, True
    else:
        return
    one.stamps.append(stamp)
    one.offsets.append(log_time - stamp)


def assign(probes: Mapping[str, Probe], named: Mapping[str, str]) -> dict[str, Probe]:
    """The topic of each role. `named`: the operator's choice, ROLE -> TOPIC. Raises RoleError if two topics could
    fill one."""
    chosen: dict[str, Probe] = {}
    for name, topic in named.items():
        if name not in NAMED:
            raise RoleError(f"--map {name}: {_no_choice(name, NAMED, 'every topic of it is taken')}")
        if topic == "":
            continue
        if topic not in probes or probes[topic].source.type not in BY_NAME[name].types:
            fits = [p.source.topic for p in probes.values() if p.source.type in BY_NAME[name].types]
            raise RoleError(
                f"--map {name}={topic}: the bag holds no such topic of {' or '.join(BY_NAME[name].types)}; "
                f"{'it holds ' + ', '.join(sorted(fits)) if fits else 'it holds none'}"
            )
        if probes[topic].broken:
            raise RoleError(f"--map {name}={topic}: it cannot be read: {probes[topic].broken}")
        chosen[name] = probes[topic]
    if "main" not in named and (main := _main(probes, chosen)) is not None:
        chosen["main"] = main
    if "imu" not in named:
        imus = [p for p in _whole(probes, "imu") if p.accel]
        _take(chosen, "imu", imus)
    if "joints" not in named:
        _take(chosen, "joints", [p for p in _whole(probes, "joints") if p.motors])
    if "wheels" not in named:
        rolling = _whole(probes, "wheels")
        for narrower in ([p for p in rolling if "wheel" in p.source.topic], [p for p in rolling if p.moving]):
            rolling = narrower if len(rolling) > 1 and narrower else rolling
        if len(rolling) == 1 or ("main" not in chosen and "joints" not in chosen):
            _take(chosen, "wheels", rolling)
    return chosen


def needless_mount(mounts: Collection[str], chosen: Collection[str]) -> None:
    """Raises RoleError for a mount that would change nothing."""
    for name in mounts:
        if name not in MOUNTED:
            raise RoleError(f"--mount {name}: {_no_choice(name, MOUNTED, 'it counts in base_link')}")
        if name not in chosen:
            raise RoleError(f"--mount {name}: this bag has no {name}")


def _no_choice(name: str, of: Sequence[str], why: str) -> str:
    lead = why if name in BY_NAME else "there is no such role"
    return f"{lead}; choose from {', '.join(of)}"


def _whole(probes: Mapping[str, Probe], role: str) -> list[Probe]:
    """The topics that could fill a role and can be read."""
    return [p for p in probes.values() if p.source.type in BY_NAME[role].types and p.seen and not p.broken]


def _take(chosen: dict[str, Probe], role: str, fitting: list[Probe]) -> None:
    if len(fitting) > 1:
        raise RoleError(_question(role, fitting))
    if fitting:
        chosen[role] = fitting[0]


def _main(probes: Mapping[str, Probe], chosen: Mapping[str, Probe]) -> Probe | None:
    clouds = [p for p in _whole(probes, "main") if any(p.points) and p is not chosen.get("head")]
    timed = [p for p in clouds if p.timed]  # a cloud that somebody made of sweeps carries no times
    fitting = sorted(timed or clouds, key=lambda p: -p.weight)
    if len(fitting) > 1 and fitting[0].weight < POINT_RATIO * fitting[1].weight:
        raise RoleError(_question("main", fitting))
    return fitting[0] if fitting else None


def _question(role: str, fitting: list[Probe]) -> str:
    lines = "; ".join(f"{p.source.topic} ({p.about})" for p in fitting)
    return (
        f"which topic is {role}? {lines}. Say --map {role}={fitting[0].source.topic} or another; --map "
        f"{role}= for none"
    )


def turned(probe_: Probe, mount: np.ndarray) -> float:
    """Angle [rad] between the mean specific force, through `mount` (3, 3) base_link <- IMU, and up."""
    mean = mount @ np.mean(probe_.accel, axis=0)
    norm = float(np.linalg.norm(mean))
    return (
        float(np.arccos(np.clip(mean[2] / norm, -1.0, 1.0)))
        if norm > 0.1 * GRAVITY * (0.1 if probe_.in_g else 1.0)
        else 0.0
    )
