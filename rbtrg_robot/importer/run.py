"""Makes a run of ours from a foreign bag: our topics, types and frames. Topics without a role are copied bit for
bit."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from hal.lidar.config import LidarConfig
from hal.limbs import MOTORS
from hal.rotation import rotation_rpy, rpy_of
from hal.types import GRAVITY, NS, Array, Extrinsics, ImuSample, JointSample, LidarName, LidarScan
from hal.unitree.api import WireError
from hal.unitree.cloud import Limits, sweep
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import StackConfig, load
from rbtrg_robot.importer.bag import Bag, Source, entry_of
from rbtrg_robot.importer.mounts import Frames
from rbtrg_robot.importer.roles import (
    HANDED_ON,
    LIVOX,
    MOUNTED,
    ROLES,
    TURNED_ANGLE,
    Probe,
    RoleError,
    assign,
    needless_mount,
    probe,
    read_cloud,
    turned,
)
from rbtrg_robot.log.bag import describe
from rbtrg_robot.log.read import CONFIG, Entry, LogError
from rbtrg_robot.log.write import LogWriter
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import imu_msg, joint_msg, odometry_msg, scan_msg, xyz
from rbtrg_robot.wire.messages import MessageError, decode, encode, stamp_of

FARTHEST_POINT = 200.0
"""Points beyond are dropped [m]; those of a robot's own body are not known, and stay."""
CLOCKS_APART = NS // 4
"""Two sensors whose stamps differ by more from when they were recorded have different clocks [ns]."""
FOREIGN = "/imported"
"""In front of the names of foreign topics that are names of ours."""
FILE_BYTES = 1_000_000_000
LIDARS: tuple[LidarName, ...] = ("main", "head")


@dataclass(slots=True)
class Found:
    """What an import is going to do."""

    roles: dict[str, Probe]
    probes: dict[str, Probe]
    mounts: dict[str, Extrinsics]
    notes: list[str] = field(default_factory=list)
    """What the operator should know, a line each."""
    shifts: dict[str, int] = field(default_factory=dict)
    """Added to the stamps of a topic [ns]."""
    scale: float = 1.0
    """Of the accelerometer."""

    def rows(self) -> list[tuple[str, str, str]]:
        """Role, topic, what it is or what its lack costs."""
        out = []
        for role in ROLES:
            one = self.roles.get(role.name)
            several = [p for p in self.probes.values() if p.source.type in role.types]
            if one is not None:
                out.append((role.name, one.source.topic, one.about))
            elif role.name in (*HANDED_ON, "tf") and several:
                out.append(
                    (
                        role.name,
                        ", ".join(p.source.topic for p in several),
                        "read" if role.name == "tf" else "handed on",
                    )
                )
            else:
                out.append((role.name, "-", role.cost))
        return out


def look(
    bag: Bag,
    named: Mapping[str, str],
    mounts: Mapping[str, Extrinsics],
    urdf: Path | None = None,
    unit: str = "auto",
) -> Found:
    """Find roles, mounts, clocks and units. `named`: ROLE -> TOPIC; `mounts`: ROLE -> pose in base_link; `unit` of
    the accelerometer: auto, m/s2, g.

    Raises RoleError, ConfigError, LogError."""
    frames = Frames()
    if urdf is not None:
        frames.take_urdf(urdf)
    probes = probe(bag, frames)
    roles = assign(probes, named)
    needless_mount(mounts, roles)
    if unit != "auto" and "imu" not in roles:
        raise RoleError("--imu-unit: this bag has no imu")
    found = Found(roles, probes, {})
    for name in MOUNTED:
        if name not in roles:
            continue
        mount = mounts.get(name) or frames.mount(roles[name].frame)
        if mount is None:
            found.notes.append(
                f"mount of {name}: frame {roles[name].frame!r} is not in the tf of the bag; base_link is put there: "
                f"--mount {name}=X,Y,Z,ROLL,PITCH,YAW or --urdf FILE"
            )
        found.mounts[name] = mount or Extrinsics((0.0, 0.0, 0.0))
    _clocks(found)
    if "imu" in roles:
        _imu(found, unit)
    if not roles.keys() & {"main"} and not ("imu" in roles and roles.keys() & {"joints", "wheels"}):
        seen = ", ".join(sorted({s.type or s.encoding for s in bag.sources})) or "nothing"
        hint = (
            f"; `rbtrg-robot map convert {bag.path} OUT.npz` reads its grid map" if "/GridMap" in seen else ""
        )
        raise RoleError(
            f"{bag.path} holds neither a LiDAR nor an IMU with wheels, so no run can be made of it; it holds {seen}"
            + hint
        )
    for one in probes.values():
        if one.broken:
            found.notes.append(f"{one.source.topic} cannot be read: {one.broken}")
    return found


def _clocks(found: Found) -> None:
    used = {
        name: found.roles[name] for name in ("imu", "main", "head", "joints", "wheels") if name in found.roles
    }
    offsets = {name: p.offset for name, p in used.items() if p.stamps}
    if not offsets or max(offsets.values()) - min(offsets.values()) <= CLOCKS_APART:
        return
    reference = min(offsets, key=lambda name: abs(offsets[name]))
    for name, offset in offsets.items():
        apart = offset - offsets[reference]
        if abs(apart) > CLOCKS_APART:
            found.shifts[used[name].source.topic] = apart
            found.notes.append(
                f"the clock of {name} differs from that of {reference} by {-apart / NS:.3f} s: its stamps "
                "are moved by that, "
                "as they were recorded; what the line took stays in them"
            )


def _imu(found: Found, unit: str) -> None:
    one = found.roles["imu"]
    if unit == "g" or (unit == "auto" and one.in_g):
        found.scale = GRAVITY
        if unit == "auto":
            found.notes.append(
                "the accelerometer counts in g: taken times 9.81 (--imu-unit m/s2 for as it is)"
            )
    mount = found.mounts["imu"]
    turn = rotation_rpy(*mount.rpy)
    angle = turned(one, turn)
    if angle > TURNED_ANGLE:
        force = np.mean(one.accel, axis=0)
        up = int(np.argmax(np.abs(force)))
        x, y, z = turn @ force
        # What brings up to where it is, after the turn of the mount that is there.
        level = rotation_rpy(math.atan2(y, z), math.atan2(-x, math.hypot(y, z)), 0.0)
        better = ",".join(
            f"{value:.3g}" for value in (*mount.translation, *np.degrees(rpy_of(level @ turn)).round() + 0.0)
        )
        found.notes.append(
            f"the IMU's {'-' if force[up] < 0 else ''}{'xyz'[up]} axis points up, {math.degrees(angle):.0f} "
            "deg from base_link's z: "
            f"its axes are others; --mount imu={better} turns them (the yaw is yours to say)"
        )


def config_of(found: Found) -> StackConfig:
    """The configuration that a re-run starts from: the real robot's clock, the sensors that are there."""
    lidars = [
        LidarConfig(name=name, model=_model(found.roles[name]), mount=found.mounts[name])
        for name in LIDARS
        if name in found.roles
    ]
    imu = found.mounts.get("imu", Extrinsics((0.0, 0.0, 0.0)))
    without = "imu" if "imu" not in found.roles else "lidar" if "main" not in found.roles else ""
    return load(
        base={
            "backend": "unitree",
            "scene": "",
            "lidars": [lidar.model_dump(mode="json") for lidar in lidars or [LidarConfig()]],
            "odometry": {
                "without": without,
                "use_joints": "joints" in found.roles,
                "inertial": {"imu_position": list(imu.translation)},
            },
        }
    )


def _model(one: Probe) -> str:
    if one.source.type in LIVOX or "line" in one.fields:
        return "mid360"
    return "l1" if "utlidar" in one.source.topic or "unilidar" in one.source.topic else "xt16"


class Converter:
    """Messages of the roles as ours."""

    def __init__(self, found: Found) -> None:
        self._found = found
        self._roles = {p.source.topic: name for name, p in found.roles.items() if name != "tf"}
        self._limits = Limits(max_range=FARTHEST_POINT)
        self._turn: Array = rotation_rpy(*found.mounts.get("imu", Extrinsics((0.0, 0.0, 0.0))).rpy)
        self._units: dict[str, float | None] = dict.fromkeys(LIDARS)
        """Of each LiDAR's times [s], once a sweep has told it."""
        self.refused: Counter[str] = Counter()
        self.reasons: dict[str, str] = {}

    def convert(self, source: Source, data: bytes) -> tuple[Topic, bytes, int] | None:
        """Our topic, bytes and stamp [ns]; None for what has no role or cannot be used."""
        role = self._roles.get(source.topic)
        if role is None or role in HANDED_ON:
            return None
        try:
            made = self._made(role, source, data)
        except (WireError, MessageError) as error:
            made = None
            self.reasons.setdefault(source.topic, str(error))
        if made is None:
            self.refused[source.topic] += 1
            return None
        topic, message = made
        return topic, encode(message), stamp_of(message)

    def keeps(self, source: Source) -> bool:
        """Whether a topic is handed on as it is; an odometry is both, as the way that somebody may want to compare."""
        return self._roles.get(source.topic, "camera") in (*HANDED_ON, "wheels")

    def _made(self, role: str, source: Source, data: bytes) -> tuple[Topic, msg.Message] | None:
        shift = self._found.shifts.get(source.topic, 0)
        for name in LIDARS:
            if role == name:
                cloud = read_cloud(source, data)
                start, points, self._units[name] = sweep(cloud, self._limits, self._units[name])
                return (
                    (t.SWEEPS[name], scan_msg(LidarScan(start + shift, points, name)))
                    if len(points)
                    else None
                )
        if role == "imu":
            imu = decode(data, msg.Imu)
            gyro = self._turn @ xyz(imu.angular_velocity)
            accel = self._turn @ xyz(imu.linear_acceleration) * self._found.scale
            return t.IMU, imu_msg(ImuSample(stamp_of(imu) + shift, gyro, accel))
        if role == "joints":
            joints = decode(data, msg.JointState)
            place = {name: k for k, name in enumerate(joints.name)}
            if not set(MOTORS) <= set(place):
                raise WireError("it lacks some of the joints of `hal.limbs.MOTORS`")
            order = [place[motor] for motor in MOTORS]
            full = []
            for values in (joints.position, joints.velocity, joints.effort):
                if len(values) not in (0, len(joints.name)):
                    raise WireError(f"{len(values)} values for {len(joints.name)} joints")
                full.append(np.asarray(values)[order] if len(values) else np.zeros(len(order)))
            return t.JOINTS, joint_msg(JointSample(stamp_of(joints) + shift, *full))
        if source.type == msg.TwistStamped.__msgtype__:
            twist = decode(data, msg.TwistStamped)
            stamp, body = stamp_of(twist), twist.twist
        else:
            odometry = decode(data, msg.Odometry)
            stamp, body = stamp_of(odometry), odometry.twist.twist
        still = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
        return t.WHEELS, odometry_msg(stamp + shift, *still, xyz(body.linear), xyz(body.angular))


def convert_bag(
    bag: Bag, found: Found, out: Path, progress: Callable[[int], None] = lambda _done: None
) -> dict[str, int]:
    """Write the run folder `out`. Returns messages per topic; says in `found.notes` what was refused. Raises
    LogError."""
    if out.exists():
        raise LogError(f"{out} exists; name another folder with --out")
    config = config_of(found)
    attachments = {CONFIG: config.to_yaml().encode()}
    metadata = config.metadata() | {"imported": bag.path.name, "clock": "wall"}
    metadata |= {f"role.{name}": p.source.topic for name, p in found.roles.items()}
    counts: Counter[str] = Counter()
    converter = Converter(found)
    number = 0
    latched: dict[str, tuple[Entry, Source]] = {}
    """Newest of each latched topic, for the head of the next file."""
    writer = LogWriter(out / "log_0.mcap", metadata, attachments)
    try:
        for done, (source, log_time, published, data) in enumerate(bag.messages()):
            if writer.size > FILE_BYTES:
                writer.close()
                number += 1
                writer = LogWriter(out / f"log_{number}.mcap", metadata, attachments)
                for entry, told in latched.values():
                    writer.copy(replace(entry, log_time=log_time), told.schema, told.channel)
            if (made := converter.convert(source, data)) is not None:
                topic, payload, stamp = made
                counts[topic.name] += 1
                writer.write(topic, payload, log_time, stamp, counts[topic.name])
            if converter.keeps(source):
                name = FOREIGN + source.topic if source.topic in t.BY_NAME else source.topic
                counts[name] += 1
                entry = entry_of(source, name, log_time, published, counts[name], data)
                writer.copy(entry, source.schema, source.channel)
                if source.latched:
                    latched[name] = entry, source
            if done % 50 == 0:
                progress(done)
    finally:
        writer.close()
    (out / CONFIG).write_bytes(attachments[CONFIG])
    describe(out)
    for topic_name, count in converter.refused.items():
        why = converter.reasons.get(topic_name, "no point in range")
        found.notes.append(f"{count} messages of {topic_name} were not usable: {why}")
    found.notes += [f"the bag is damaged: {words}" for words in bag.damage]
    return dict(counts)


def used(counts: Mapping[str, int]) -> int:
    """Messages that a re-run can start from."""
    ours = {topic.name for topic in (t.IMU, t.JOINTS, t.WHEELS)} | {topic.name for topic in t.SWEEPS.values()}
    return sum(counts.get(name, 0) for name in ours)
