"""Bags of others become runs of ours: every container, every layout of a cloud, and a plain word where something is
missing."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from mcap.records import Channel, Schema
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore
from typer.testing import CliRunner

from hal.types import GRAVITY, NS, POINT_DTYPE, POINT_QUANTUM, TIME_QUANTUM
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.cli.topic import topic_app
from rbtrg_robot.config import ConfigError
from rbtrg_robot.hosts.offline import rerun
from rbtrg_robot.importer.bag import Bag
from rbtrg_robot.importer.mounts import parse_mount
from rbtrg_robot.importer.roles import RoleError
from rbtrg_robot.importer.run import config_of, convert_bag, look, used
from rbtrg_robot.log.bag import describe
from rbtrg_robot.log.read import Entry, LogError, read_run
from rbtrg_robot.log.trajectory import of_run
from rbtrg_robot.log.write import LogWriter
from rbtrg_robot.wire.convert import lidar_scan
from rbtrg_robot.wire.messages import decode, encode, header
from tests.places import SHARED, needs_shared
from tools.bench.outside import foreign

LAYOUTS = [*foreign.LAYOUTS, "livox custom", "organised"]


def imported(bag: Path, out: Path, **how: object) -> tuple[Path, list[str], dict[str, int]]:
    """Run, notes, counts."""
    recording = Bag(bag)
    found = look(recording, how.pop("named", {}), how.pop("mounts", {}), **how)  # type: ignore[arg-type]
    counts = convert_bag(recording, found, out)
    return out, found.notes, counts


def scans(run: Path) -> list[np.ndarray]:
    return [
        lidar_scan(decode(entry.data, msg.PointCloud2)).points
        for entry in read_run(run)
        if entry.topic == t.POINTS.name
    ]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_gives_the_same_sweep(tmp_path: Path, layout: str) -> None:
    run, _, counts = imported(foreign.write(tmp_path / "bag", foreign.sweeps(layout, 3)), tmp_path / "run")
    assert counts == {t.POINTS.name: 3}
    (first, *_), wanted = scans(run), foreign.room(0)
    if layout == "organised":
        wanted = wanted[: len(wanted) // 2 * 2]
        wanted = wanted[np.arange(len(wanted)) % 7 != 0]
    assert first.dtype == POINT_DTYPE
    assert len(first) == len(wanted)
    for axis in "xyz":
        np.testing.assert_allclose(first[axis], wanted[axis], atol=0.51 * POINT_QUANTUM)
    shift = (
        0.0 if layout == "organised" else wanted["time"][0]
    )  # float32 counts from the header, clocks from the first point
    np.testing.assert_allclose(first["time"], wanted["time"] - shift, atol=1.1 * TIME_QUANTUM)
    entry = next(e for e in read_run(run) if e.topic == t.POINTS.name)
    assert abs(entry.publish_time - (foreign.START_STAMP + round(float(shift) * NS))) < 1_000


@pytest.mark.parametrize("kind", ["db3", "zstd", "messages", "bag"])
def test_every_container_gives_the_same_run(tmp_path: Path, kind: str) -> None:
    messages = [
        *foreign.sweeps("ouster", 3),
        *foreign.imu(0.3),
        foreign.static("base_link", "lidar", (0.1, 0.0, 0.5)),
    ]
    wanted, _, _ = imported(foreign.write(tmp_path / "mcap", messages), tmp_path / "a")
    got, notes, _ = imported(foreign.write(tmp_path / kind, messages, kind), tmp_path / "b")

    def ours(run: Path) -> list[Entry]:
        return [e for e in read_run(run) if e.topic in (t.POINTS.name, t.IMU.name)]

    assert ours(got) == ours(wanted)
    assert len(ours(got)) == 63
    assert not [note for note in notes if "mount of main" in note]


def test_the_topics_of_any_bag_are_listed_and_echoed(tmp_path: Path) -> None:
    bag = foreign.write(tmp_path / "bag", [*foreign.sweeps("ouster", 2), *foreign.imu(0.1)], "bag")

    def told(*words: str) -> str:
        return CliRunner().invoke(topic_app, [*words, "--log", str(bag)], catch_exceptions=False).stdout

    lines = told("list").splitlines()
    assert [line.split() for line in lines] == [
        ["/imu", "sensor_msgs/msg/Imu", "20", "messages"],
        ["/points", "sensor_msgs/msg/PointCloud2", "2", "messages"],
    ]
    assert told("echo", "imu", "-n", "1").startswith("header:")
    with pytest.raises(ConfigError, match=r"^/x is not in .*bag.bag; `rbtrg-robot topic list --log"):
        told("echo", "/x")


def test_a_split_bag_without_its_description_is_read_in_order(tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    folder.mkdir()
    for k in range(11):
        part = foreign.write(tmp_path / f"part{k}", foreign.sweeps("velodyne", 11)[k : k + 1])
        next(part.glob("*.mcap")).rename(folder / f"bag_{k}.mcap")
    run, _, _ = imported(folder, tmp_path / "run")
    stamps = [e.publish_time for e in read_run(run)]
    assert len(stamps) == 11
    assert stamps == sorted(stamps)


def test_a_run_that_was_made_runs_again_with_lidar_and_imu(tmp_path: Path) -> None:
    messages = [*foreign.sweeps("hesai", 12), *foreign.imu(1.5)]
    run, _, _ = imported(foreign.write(tmp_path / "bag", messages), tmp_path / "run")
    counts = rerun(run, ["odometry", "elevation"], tmp_path / "again.mcap")
    assert counts[t.ODOM.name] >= 5
    assert counts[t.MAP_UPDATE.name] > 0
    again = rerun(run, ["odometry"], tmp_path / "part.mcap", start_offset=0.2, duration=0.9)
    assert 0 < again[t.POINTS.name] < counts[t.POINTS.name]


def test_without_an_imu_it_runs_by_lidar_alone_and_says_so(tmp_path: Path) -> None:
    run, _, _ = imported(foreign.write(tmp_path / "bag", foreign.sweeps("ouster", 20)), tmp_path / "run")
    rerun(run, ["odometry", "elevation"], tmp_path / "again.mcap")
    way = of_run(tmp_path / "again.mcap")
    assert len(way.stamps) == 20
    assert way.poses[-1, 0, 3] == pytest.approx(0.05 * 19, abs=0.05)
    health = [
        decode(e.data, msg.OdometryHealth)
        for e in read_run(tmp_path / "again.mcap")
        if e.topic == t.ODOM_HEALTH.name
    ]
    assert {h.health for h in health} == {"degraded"}
    assert all("no IMU" in h.reason for h in health)


def test_without_a_lidar_it_runs_by_wheels_and_imu(tmp_path: Path) -> None:
    rolling = []
    for k in range(300):
        stamp = foreign.START_STAMP + k * NS // 50
        twist = msg.Twist(linear=msg.Vector3(x=0.5 if k > 100 else 0.0))
        message = msg.Odometry(
            header=header(stamp, "odom"),
            child_frame_id="base_link",
            twist=msg.TwistWithCovariance(twist=twist),
        )
        rolling.append(("/wheel/odometry", msg.Odometry.__msgtype__, stamp + 1_000_000, encode(message)))
    bag = foreign.write(tmp_path / "bag", [*rolling, *foreign.imu(6.0)])
    run, _, counts = imported(bag, tmp_path / "run")
    assert counts[t.WHEELS.name] == 300
    rerun(run, ["odometry"], tmp_path / "again.mcap")
    way = of_run(tmp_path / "again.mcap")
    driven = 0.5 * (way.stamps[-1] - foreign.START_STAMP - 2 * NS) / NS
    assert way.poses[-1, 0, 3] == pytest.approx(driven, abs=0.1)


def test_two_lidars_alike_are_not_guessed(tmp_path: Path) -> None:
    messages = [*foreign.sweeps("ouster", 3, "/left"), *foreign.sweeps("ouster", 3, "/right", "other")]
    bag = Bag(foreign.write(tmp_path / "bag", messages))
    with pytest.raises(RoleError, match=r"which topic is main\? .*/left.*/right.*--map main="):
        look(bag, {}, {})
    found = look(bag, {"main": "/right", "head": "/left"}, {})
    assert {name: one.source.topic for name, one in found.roles.items()} == {
        "main": "/right",
        "head": "/left",
    }
    with pytest.raises(RoleError, match=r"--map main=/nothing: the bag holds no such topic.*/left"):
        look(bag, {"main": "/nothing"}, {})
    with pytest.raises(RoleError, match="there is no such role"):
        look(bag, {"mian": "/left"}, {})


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"named": {"tf": "/tf"}}, "--map tf: every topic of it is taken; choose from main"),
        ({"named": {"lidra": "/points"}}, "--map lidra: there is no such role; choose from main"),
        ({"mounts": {"lidra": None}}, "--mount lidra: there is no such role; choose from main, head, imu"),
        ({"mounts": {"wheels": None}}, "--mount wheels: it counts in base_link; choose from"),
        ({"mounts": {"head": None}}, "--mount head: this bag has no head"),
        ({"unit": "g"}, "--imu-unit: this bag has no imu"),
    ],
)
def test_what_would_change_nothing_is_refused(tmp_path: Path, how: dict[str, Any], words: str) -> None:
    mounts = {name: parse_mount("0,0,0") for name in how.pop("mounts", {})}
    bag = foreign.write(tmp_path / "bag", foreign.sweeps("hesai", 3))
    with pytest.raises(RoleError, match=words):
        look(Bag(bag), how.pop("named", {}), mounts, **how)


def test_a_cloud_that_somebody_made_of_sweeps_is_no_lidar(tmp_path: Path) -> None:
    plain = np.zeros(90_000, [("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
    plain["x"] = 1.0
    whole = foreign.encode_cloud(foreign.START_STAMP, "map", plain)
    derived = [
        ("/map_points", msg.PointCloud2.__msgtype__, foreign.START_STAMP + k * NS // 10, whole)
        for k in range(3)
    ]
    found = look(Bag(foreign.write(tmp_path / "bag", [*foreign.sweeps("hesai", 3), *derived])), {}, {})
    assert found.roles["main"].source.topic == "/points"
    rows = {role: (topic, words) for role, topic, words in found.rows()}
    assert rows["imu"][0] == "-"
    assert "LiDAR alone" in rows["imu"][1]


def test_an_imu_in_g_and_in_other_axes_is_told_and_corrected(tmp_path: Path) -> None:
    messages = [*foreign.sweeps("hesai", 3), *foreign.imu(0.5, accel=(0.0, -1.0, 0.0))]
    bag = foreign.write(tmp_path / "bag", messages)
    _, notes, _ = imported(bag, tmp_path / "run")
    assert any("counts in g" in note for note in notes)
    assert any("-y axis points up" in note and "--mount imu=0,0,0,-90,0,0" in note for note in notes)
    run, notes, _ = imported(bag, tmp_path / "turned", mounts={"imu": parse_mount("0,0,0,-90,0,0")})
    assert not [note for note in notes if "axis points up" in note]
    first = decode(next(e.data for e in read_run(run) if e.topic == t.IMU.name), msg.Imu)
    a = first.linear_acceleration
    np.testing.assert_allclose((a.x, a.y, a.z), (0.0, 0.0, GRAVITY), atol=1.0)
    run, _, _ = imported(bag, tmp_path / "kept", unit="m/s2")
    kept = decode(next(e.data for e in read_run(run) if e.topic == t.IMU.name), msg.Imu)
    assert kept.linear_acceleration.y == pytest.approx(-1.0, abs=0.1)


def test_the_turn_that_is_proposed_goes_on_from_the_one_of_tf(tmp_path: Path) -> None:
    """The bag's tf turns the IMU about x, and its axes differ about y as well: what is proposed stands alone, and
    levels it."""
    tf = foreign.static(
        "base_link", "imu", (0.1, 0.0, 0.2), turn=(math.sin(math.pi / 4), 0.0, 0.0, math.cos(math.pi / 4))
    )
    messages = [*foreign.sweeps("hesai", 3), *foreign.imu(0.5, accel=(9.81, 0.0, 0.0)), tf]
    bag = Bag(foreign.write(tmp_path / "bag", messages))
    (note,) = [note for note in look(bag, {}, {}).notes if "axis points up" in note]
    assert note.startswith("the IMU's x axis points up, 90 deg")
    proposed = parse_mount(note.split("--mount imu=")[1].split()[0])
    assert proposed.translation == (0.1, 0.0, 0.2)
    assert not [note for note in look(bag, {}, {"imu": proposed}).notes if "axis points up" in note]


def test_mounts_come_from_tf_urdf_or_the_operator(tmp_path: Path) -> None:
    chain = [
        foreign.static("base_link", "mast", (0.0, 0.0, 0.3)),
        foreign.static("mast", "lidar", (0.1, 0.0, 0.2)),
    ]
    bag = foreign.write(tmp_path / "bag", [*foreign.sweeps("hesai", 3), *chain])
    found = look(Bag(bag), {}, {})
    np.testing.assert_allclose(found.mounts["main"].translation, (0.1, 0.0, 0.5))
    assert config_of(found).mounted_lidars()[0].mount == found.mounts["main"]
    told = parse_mount("0,0,1,0,0,90")
    assert look(Bag(bag), {}, {"main": told}).mounts["main"] == told
    assert told.rpy[2] == pytest.approx(math.pi / 2)
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(
        '<robot><joint type="fixed"><parent link="base_link"/><child link="lidar"/>'
        '<origin xyz="0 0 0.7" rpy="0 0 0"/></joint></robot>'
    )
    bare = foreign.write(tmp_path / "bare", foreign.sweeps("hesai", 3))
    assert look(Bag(bare), {}, {}, urdf).mounts["main"].translation == (0.0, 0.0, 0.7)
    assert any("mount of main" in note for note in look(Bag(bare), {}, {}).notes)


def test_two_clocks_are_brought_together_and_told(tmp_path: Path) -> None:
    late = [(topic, kind, stamp, data) for topic, kind, stamp, data in foreign.sweeps("hesai", 5)]
    booted = [
        (
            "/imu",
            msg.Imu.__msgtype__,
            stamp,
            encode(msg.Imu(header=header(stamp - foreign.START_STAMP + 3 * NS, "imu"))),
        )
        for _, _, stamp, _ in foreign.imu(0.6)
    ]
    run, notes, _ = imported(foreign.write(tmp_path / "bag", [*late, *booted]), tmp_path / "run")
    assert any("the clock of imu differs" in note for note in notes)
    stamps = [e.publish_time for e in read_run(run) if e.topic == t.IMU.name]
    assert abs(stamps[0] - foreign.START_STAMP) < 200_000_000


def test_what_has_no_role_is_handed_on_bit_for_bit(tmp_path: Path) -> None:
    path = tmp_path / "bag.mcap"
    odd = Schema(1, b"not a definition", "jsonschema", "acme/Thing")
    with LogWriter(path, {"who": "acme"}) as writer:
        for topic, kind, stamp, data in foreign.sweeps("velodyne", 2):
            schema = Schema(0, b"", "ros2msg", kind)
            writer.copy(Entry(topic, kind, data, stamp, stamp, 1), schema, Channel(0, topic, "cdr", {}, 0))
        for encoding in ("json", "protobuf"):
            entry = Entry("/thing", odd.name, b'{"a": 1}', foreign.START_STAMP, foreign.START_STAMP, 1)
            writer.copy(entry, odd, Channel(0, "/thing", encoding, {"k": encoding}, 0))
        mine = encode(msg.Odometry(header=header(foreign.START_STAMP, "odom")))
        writer.copy(
            Entry("/odom", msg.Odometry.__msgtype__, mine, foreign.START_STAMP, 1, 1),
            Schema(0, b"", "ros2msg", msg.Odometry.__msgtype__),
            Channel(0, "/odom", "cdr", {}, 0),
        )
    run, _, counts = imported(path, tmp_path / "run")
    things = [e for e in read_run(run) if e.topic == "/thing"]
    assert [e.data for e in things] == [b'{"a": 1}'] * 2
    assert [e.data for e in read_run(run) if e.topic == "/imported/odom"] == [mine]
    assert "/odom" not in counts
    assert used(counts) == 3


def test_a_bag_with_nothing_for_us_is_refused_with_what_it_holds(tmp_path: Path) -> None:
    path = foreign.write(tmp_path / "bag", [foreign.static("a", "b", (0.0, 0.0, 0.0))])
    with pytest.raises(RoleError, match=r"neither a LiDAR nor an IMU with wheels.*tf2_msgs/msg/TFMessage"):
        look(Bag(path), {}, {})
    (tmp_path / "x.bag").write_bytes(b"version https://git-lfs.github.com/spec/v1\n")
    with pytest.raises(LogError, match="git lfs pull"):
        Bag(tmp_path / "x.bag")
    (tmp_path / "x.mcap").write_bytes(b"PNG")
    with pytest.raises(LogError, match="is no bag"):
        Bag(tmp_path / "x.mcap")


def test_a_damaged_bag_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    path = tmp_path / "bag.mcap"
    with LogWriter(path, {}) as writer:
        for topic, kind, stamp, data in foreign.sweeps("velodyne", 8):
            schema = Schema(0, b"", "ros2msg", kind)
            writer.copy(Entry(topic, kind, data, stamp, stamp, 1), schema, Channel(0, topic, "cdr", {}, 0))
            writer.flush()
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    _, notes, counts = imported(path, tmp_path / "run")
    assert any("the bag is damaged: bag.mcap ends after" in note for note in notes)
    assert 0 < counts[t.POINTS.name] < 8
    path.write_bytes(whole[:60])
    with pytest.raises(LogError, match="damaged, before its first message"):
        Bag(path)


@pytest.mark.parametrize("kind", ["db3", "bag"])
@pytest.mark.parametrize("share", [0.0, 0.05, 0.3, 0.9])
def test_a_damaged_bag_of_another_kind_is_told_in_a_line(tmp_path: Path, kind: str, share: float) -> None:
    made = foreign.write(tmp_path / "bag", foreign.sweeps("velodyne", 4), kind)
    path = made if kind == "bag" else next(made.glob("*.db3"))
    whole = path.read_bytes()
    path.write_bytes(whole[: 40 + int(share * len(whole))])
    try:
        bag = Bag(path)
        assert len(list(bag.messages())) < 4
    except LogError as error:
        told = str(error)
    else:
        told = " ".join(bag.damage)
    assert path.name in told


def test_broken_messages_of_ros_1_are_left_out_and_counted(tmp_path: Path) -> None:
    messages = foreign.sweeps("velodyne", 6)
    for k in (1, 4):
        messages[k] = (*messages[k][:3], messages[k][3][:200])
    path = foreign.write(tmp_path / "bag", messages, "bag")
    recording = Bag(path)
    found = look(recording, {}, {})
    counts = convert_bag(recording, found, tmp_path / "run")
    assert counts[t.POINTS.name] == 4
    assert found.notes[-1] == "the bag is damaged: 2 messages of /points are broken, and left out"
    assert len([note for note in found.notes if "broken" in note]) == 1


def test_a_description_hides_no_file_of_a_recorder_that_was_killed(tmp_path: Path) -> None:
    for k in range(3):
        with LogWriter(tmp_path / f"log_{k}.mcap", {}) as writer:
            topic, kind, stamp, data = foreign.sweeps("velodyne", 3)[k]
            schema = Schema(0, b"", "ros2msg", kind)
            writer.copy(Entry(topic, kind, data, stamp, stamp, 1), schema, Channel(0, topic, "cdr", {}, 0))
        if k == 1:
            describe(tmp_path)
    assert len(list(Bag(tmp_path).messages())) == 3


def test_what_was_latched_in_a_db3_is_latched_in_the_run(tmp_path: Path) -> None:
    never = QosTime(2147483647, 4294967295)
    latched = Qos(
        *(QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, never, never),
        *(QosLiveliness.AUTOMATIC, never, False),
    )
    topic, kind, stamp, data = foreign.static("base_link", "lidar", (0.0, 0.0, 0.5))
    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer2(tmp_path / "bag", version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        made = writer.add_connection(topic, kind, typestore=store, offered_qos_profiles=[latched])
        writer.write(made, stamp, data)
    (source,) = Bag(tmp_path / "bag").sources
    assert source.latched
    (told,) = yaml.safe_load(source.channel.metadata["offered_qos_profiles"])
    assert (told["depth"], told["durability"], told["reliability"]) == (1, 1, 1)


def test_a_rerun_says_at_once_what_a_log_lacks(tmp_path: Path) -> None:
    bag = foreign.write(tmp_path / "bag", foreign.sweeps("ouster", 3))
    with pytest.raises(LogError, match=r"holds no /imu/data .*which odometry needs"):
        rerun(bag, ["odometry"], tmp_path / "a.mcap")
    with pytest.raises(LogError, match=r"holds no /odom .*which elevation needs"):
        rerun(bag, ["elevation"], tmp_path / "b.mcap")
    named = [(t.POINTS.name, *m[1:]) for m in foreign.sweeps("ouster", 3)]
    both = foreign.write(tmp_path / "named", [*named, *((t.IMU.name, *m[1:]) for m in foreign.imu(0.3))])
    with pytest.raises(LogError, match=r"not as we record it: .*`rbtrg-robot import` reads it"):
        rerun(both, ["odometry"], tmp_path / "c.mcap")
    with pytest.raises(LogError, match=r"holds no /elevation_map/update .*which planner needs"):
        rerun(both, ["planner"], tmp_path / "d.mcap")  # what it publishes itself is no map to plan on
    db3 = foreign.write(tmp_path / "db3", foreign.sweeps("ouster", 3), "db3")
    with pytest.raises(LogError, match=r"no .mcap file in .*`rbtrg-robot import` reads the bag"):
        rerun(db3, ["odometry"], tmp_path / "e.mcap")


@needs_shared
@pytest.mark.parametrize(
    ("clip", "count", "step"), [("os0_8_10scans", 10, (0.65, 0.80)), ("os1_128_3scans", 3, (0.2, 0.45))]
)
def test_real_sweeps_are_tracked(tmp_path: Path, clip: str, count: int, step: tuple[float, float]) -> None:
    """The OS0-8 drives straight on at about 7 m/s; how the OS1-128 moved nobody wrote down."""
    run, _, counts = imported(SHARED / "data" / "real" / clip, tmp_path / "run")
    assert counts[t.POINTS.name] == count
    rerun(run, ["odometry", "elevation"], tmp_path / "again.mcap")
    way = of_run(tmp_path / "again.mcap")
    assert len(way.stamps) == count
    steps = np.linalg.norm(np.diff(way.poses[1:, :3, 3], axis=0), axis=1)
    assert step[0] < steps.min()
    assert steps.max() < step[1]
    assert abs(way.poses[-1, 1, 3]) < 0.05 * abs(way.poses[-1, 0, 3]) + 0.05
    for entry in read_run(tmp_path / "again.mcap"):
        if entry.topic == t.ODOM_HEALTH.name:
            health = decode(entry.data, msg.OdometryHealth)
            assert health.inliers > 0.9
