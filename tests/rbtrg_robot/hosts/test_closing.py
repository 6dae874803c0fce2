"""A map of the run with its loops closed comes while the robot drives: the robot glides in `map`, its goal stays there,
and the elevation map becomes the one that came."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hal.rotation import quaternion, wrap
from hal.safety.geofence import Fence
from hal.scenes import Scene
from hal.types import NS
from mapping.closing.graph import levelled
from mapping.elevation.exchange import MapPatch
from mapping.elevation.map import ElevationMap
from mapping.odometry.types import Health, ScanOdometry
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.areas import fence_of, ground_area
from rbtrg_robot.cli.close import closed
from rbtrg_robot.config import StackConfig, load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.hosts.map_build import build
from rbtrg_robot.orders.heard import Heard as Told
from rbtrg_robot.orders.map import read
from rbtrg_robot.stages.elevation import ElevationStage
from rbtrg_robot.stages.loops import SCAN_FILE, LoopStage
from rbtrg_robot.stages.odometry import OdometryStage
from rbtrg_robot.stages.stage import Outputs, Stage
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import MAP, as_prior, cloud_msg, cloud_points, map_patch, patch_msg
from rbtrg_robot.wire.frames import GLIDE_SPEEDS, MapFrame, Planar, laid
from rbtrg_robot.wire.messages import decode, header, time_msg
from tests.hal.safety.test_geofence import deepest, rim
from tests.rbtrg_robot.hosts.test_initial_pose import planar
from tools.closing import Drift, Drive, drifted, ring, way_through, write_log

SHIFT = (0.16, -0.08)
"""Of the map that comes [m]: whole cells."""
LIFT = 0.06
"""Higher [m]: more than a scan may differ from the map."""


@dataclass
class Heard:
    """What the stack tells of frames and map."""

    stack: Lockstep
    offsets: list[tuple[float, Planar, Planar]] = field(default_factory=list)
    """When [s], offset of `odom` in `map`, place of the robot in `map`."""
    parts: list[MapPatch] = field(default_factory=list)
    areas: list[msg.GroundArea] = field(default_factory=list)
    cloud: np.ndarray = field(default_factory=lambda: np.empty((0, 3), np.float32))

    def __post_init__(self) -> None:
        self.stack.host.listen(self._note, {t.TF_STATIC, t.MAP_PARTS, t.MAP_CLOUD, t.AREAS})

    def _note(self, topic: Topic, payload: bytes, now: int) -> None:
        if topic is t.TF_STATIC:
            frame = MapFrame()
            frame.take(decode(payload, msg.TFMessage))
            odom = self.stack.newest.get(t.ODOM)
            place = planar(odom) if odom is not None else (0.0, 0.0, 0.0)
            self.offsets.append((now / 1e9, frame.offset, laid(frame.offset, place)))
        elif topic is t.AREAS:
            self.areas = decode(payload, msg.Areas).areas
        elif topic is t.MAP_PARTS:
            self.parts.append(map_patch(decode(payload, msg.MapPart).map, 0))
        else:
            self.cloud = cloud_points(decode(payload, msg.PointCloud2)).copy()

    def whole(self) -> MapPatch:
        """The present map."""
        self.parts.clear()
        self.stack.host.inject(t.MAP_REQUEST, msg.MapRequest(action="parts"))
        self.stack.run(0.5)
        (patch,) = self.parts
        return patch

    def closed(self) -> msg.MapPrior:
        """The present map elsewhere, as a map of this run."""
        patch = self.whole()
        moved = replace(
            patch, origin=(patch.origin[0] + SHIFT[0], patch.origin[1] + SHIFT[1]), stamp=patch.stamp
        )
        for name in ("elevation", "upper_bound"):
            moved.layers[name] = moved.layers[name] + np.float32(LIFT)
        x, y, yaw = self.offsets[-1][1]
        return msg.MapPrior(
            header=header(self.stack.now, MAP),
            id="sha256:0123456789abcdef",
            map=[patch_msg(moved)],
            cloud=cloud_msg(patch.stamp, MAP, self.cloud + np.float32([*SHIFT, LIFT])),
            odom_in_map=np.array([x + SHIFT[0], y + SHIFT[1], yaw, LIFT]),
            until=time_msg(patch.stamp),
        )


class Inside:
    """How deep a side of an area came under the robot where `map` has it [m], by the truth."""

    def __init__(self, stack: Lockstep, heard: Heard, fence: Fence) -> None:
        self._heard, self._rim = heard, rim(fence)
        self._first = heard.offsets[0][1]
        self.deepest = -math.inf
        stack.host.listen(self._note, {t.TRUTH})

    def _note(self, _topic: Topic, payload: bytes, _now: int) -> None:
        x, y, yaw = planar(decode(payload, t.TRUTH.kind))
        now = self._heard.offsets[-1][1]
        shifted = x + now[0] - self._first[0], y + now[1] - self._first[1], yaw
        self.deepest = max(self.deepest, deepest(self._rim, *shifted))


def heights(patch: MapPatch) -> dict[tuple[int, int], float]:
    """Of the trusted cells, by row and column."""
    rows, cols = np.nonzero(patch.layers["trusted"] > 0)
    cells = zip((rows + patch.cell[0]).tolist(), (cols + patch.cell[1]).tolist(), strict=True)
    return dict(zip(cells, patch.layers["elevation"][rows, cols].tolist(), strict=True))


def alike(a: MapPatch, b: MapPatch) -> float:
    """Share of the cells that both trust on which they agree."""
    one, other = heights(a), heights(b)
    off = np.array([one[cell] - other[cell] for cell in one.keys() & other.keys()])
    assert len(off) > 5000
    return float((np.abs(off) < 0.05).mean())


def test_the_robot_glides_in_the_map_while_it_drives_and_goal_and_areas_stay_where_they_are() -> None:
    with Lockstep(load(None, ["sim.lidar_step=8"], scene="yard")) as stack:
        heard = Heard(stack)
        stack.wait_ready()
        stack.run(1.0)
        prior = heard.closed()
        home = planar(stack.newest[t.TRUTH])
        x, y = home[0] + 5.5, home[1]
        goal = stack.send_goal(x, y)
        stack.run(2.0)
        assert stack.newest[t.GOAL_STATUS].state == "moving"
        before, first = stack.newest[t.MAP_STATUS], len(heard.offsets) - 1
        stack.host.inject(t.MAP_PRIOR, prior)
        stack.run(1.0)
        assert stack.newest[t.MAP_STATUS].location == "closing"
        corners = [
            (home[0] + dx, home[1] + dy) for dx, dy in ((3.4, -0.5), (3.9, -0.5), (3.9, 0.5), (3.4, 0.5))
        ]
        pond = ground_area("pond", corners, keep_out=True)
        stack.host.inject(t.AREAS_REQUEST, msg.Areas(header=header(stack.now, MAP), id="pond", areas=[pond]))
        inside = Inside(stack, heard, fence_of([pond]))
        stack.run_until(lambda: stack.newest[t.MAP_STATUS].location == "located", 40.0, "the closed map")
        now = stack.newest[t.MAP_STATUS]
        assert (now.prior, now.epoch) == (prior.id, before.epoch)
        assert now.height_correction - before.height_correction == pytest.approx(LIFT, abs=0.02)
        glided = heard.offsets[first:]
        for (since, old, _), (then, new, _) in pairwise(glided[1:]):
            assert math.dist(old[:2], new[:2]) <= GLIDE_SPEEDS[0] * (then - since) + 1e-6
        start, end = glided[0][1], glided[-1][1]
        assert end == pytest.approx((start[0] + SHIFT[0], start[1] + SHIFT[1], start[2]), abs=1e-9)
        assert glided[-1][0] - glided[1][0] > 0.8 * math.hypot(*SHIFT) / GLIDE_SPEEDS[0]
        stack.run_until(lambda: stack.newest[t.GOAL_STATUS].state == "reached", 90.0, "the goal")
        told = [status for status in stack.statuses if status.id == goal]
        assert {status.state for status in told} <= {
            "accepted",
            "planning",
            "moving",
            "recovering",
            "reached",
        }
        stack.run(1.0)
        place = planar(stack.newest[t.TRUTH])
        assert math.dist(place[:2], (x - SHIFT[0], y - SHIFT[1])) < 0.3, (
            "the goal stays where it is in the map"
        )
        assert alike(heard.whole(), map_patch(prior.map[0], 0)) > 0.97
        assert inside.deepest < 0.0, "it drove around the area where that lies in the map"
        (told_area,) = heard.areas
        assert told_area.corners.tolist() == pond.corners.tolist()
        stack.send_goal(home[0] + 3.65, home[1])
        stack.run(0.5)
        status = stack.newest[t.GOAL_STATUS]
        assert (status.state, status.reason) == ("rejected", "keep_out_area")

        # while it stands it is there at once, and the map with it
        prior = replace(heard.closed(), id="sha256:fedcba9876543210")
        stack.host.inject(t.MAP_PRIOR, prior)
        stack.run(1.0)
        assert stack.newest[t.MAP_STATUS].location == "located"
        assert heard.offsets[-1][1] == pytest.approx(prior.odom_in_map[:3], abs=1e-9)
        stack.run(1.0)
        assert alike(heard.whole(), map_patch(prior.map[0], 0)) > 0.97


class Played:
    """Odometry, elevation and the search for loops on a made-up drive: what LiDARs see is cast, the odometry is the
    truth and its drift."""

    def __init__(self, drive: Drive, config: StackConfig) -> None:
        self.drive, self.sweeps = drive, drive.sweeps()
        self.told, self.offsets, self.status = Told(), list[tuple[int, Planar]](), msg.MapStatus()
        x, y, _, yaw = levelled(drive.truth[0])
        lidars = config.mounted_lidars()
        self._scans: list[Any] = []
        played: Any = SimpleNamespace(poll=self._poll, counters={})
        self._odometry = OdometryStage(played, lidars, config.facts.imu, (x, y, yaw))
        self.elevation = ElevationStage(ElevationMap(config.elevation), config.elevation_stage, lidars)
        self._stages: list[Stage] = [self._odometry, self.elevation]
        self._config, self._frames = config, msg.TFMessage()
        self.now = 0

    def follow_loops(self, folder: Path) -> LoopStage:
        """The process `loops` starts, the one before it died."""
        stage = LoopStage(self._config)
        stage.put_on(folder)
        self._stages[2:] = [stage]
        stage.on(t.TF_STATIC, self._frames)
        if self.status.scans:
            stage.on(t.MAP_STATUS, self.status)
        return stage

    def _poll(self) -> list[Any]:
        scans, self._scans = self._scans, []
        return scans

    def scan(self, *, moves: bool = True) -> None:
        """The next one; one that does not move repeats the last."""
        if moves:
            self.now, self._pose, clouds = next(self.sweeps)
            self._clouds = {
                lidar.name: c for lidar, (_, c) in zip(self.drive.eyes.lidars, clouds, strict=True)
            }
        else:
            self.now += NS // 10
        speed = np.array([1.0 * moves, 0.0, 0.0])
        pose = self._pose[:3, 3], quaternion(self._pose[:3, :3])
        fields = {f.name: 0.0 for f in dataclasses.fields(ScanOdometry)}
        fields |= {"position": pose[0], "orientation": pose[1], "linear": speed, "angular": np.zeros(3)}
        fields |= {
            "covariance": np.zeros((6, 6)),
            "health": Health.GOOD,
            "degenerate": np.zeros(3),
            "reason": "",
        }
        self._scans.append(
            ScanOdometry(**(fields | {"stamp": self.now, "clouds": self._clouds, "lidars": (), "fault": ""}))
        )
        self.hear(self._odometry.tick(self.now) + self._odometry.on(t.CLOCK, None))
        for stage in self._stages[1:]:
            for tick in range(5):
                self.hear(stage.tick(self.now + tick))

    def hear(self, outputs: Outputs) -> None:
        """Hand what one stage says to the others."""
        for topic, message in outputs:
            self.told.take(topic, message)
            if topic is t.TF_STATIC:
                frame, self._frames = MapFrame(), message
                frame.take(message)
                self.offsets.append((self.now, frame.offset))
            if topic is t.MAP_STATUS:
                self.status = message
            for stage in self._stages:
                if topic in stage.inputs:
                    self.hear(stage.on(topic, message))

    def glides(self, place: Planar) -> None:
        """Asserts that neither `odom` nor a robot at `place` in it ever moves faster in `map`."""
        for (since, old), (now, new) in pairwise(self.offsets[1:]):
            far = GLIDE_SPEEDS[0] * (now - since) / NS
            assert math.dist(old[:2], new[:2]) <= far + 1e-6
            assert abs(wrap(new[2] - old[2])) <= GLIDE_SPEEDS[1] * (now - since) / NS + 1e-6
            assert math.dist(laid(old, place)[:2], laid(new, place)[:2]) <= 1.01 * far + 1e-6

    def walls_off(self, scene: Scene) -> float:
        """Share of trusted cells that are more than 0.3 m off: walls where none are, or none where they are."""
        grid = self.elevation.map.grid()
        rows, cols = np.nonzero(grid.trusted)
        x, y = grid.origin[0] + cols * grid.resolution, grid.origin[1] + rows * grid.resolution
        z = np.array([scene.z(*at) for at in zip(x, y, strict=True)])
        return float((np.abs(grid.height[rows, cols] - z) > 0.3).mean())


class Seen(Drive):
    """What the LiDARs see on it is cast once."""

    def __init__(
        self, scene: Scene, truth: np.ndarray, odometry: np.ndarray, cast: list[Any] | None = None
    ) -> None:
        super().__init__(scene, truth, odometry)
        self._cast = cast if cast is not None else list(super().sweeps())

    def sweeps(self) -> Iterator[Any]:
        return iter(self._cast)

    def part(self, n: int) -> Seen:
        """Its first `n` poses."""
        return Seen(self.scene, self.truth[:n], self.odometry[:n], self._cast[:n])


@pytest.fixture(scope="module")
def drive() -> Seen:
    """Twice round half of a ring, with an odometry that drifts by half a metre."""
    scene, corners = ring((5.0, 3.5))
    truth = way_through(scene, [*corners, corners[2]], step=STEP)
    return Seen(scene, truth, drifted(truth, Drift(bend=math.radians(0.02), climb=0.004), 3))


STEP = 0.7
"""[m] between two sweeps."""


def test_real_loops_close_while_the_robot_drives(drive: Seen, tmp_path: Path) -> None:
    """Of a drive whose odometry drifts by half a metre: by its log so far, on its way, and the rest where it stands."""
    drive = drive.part(len(drive.truth) - 8)
    truth, scene = drive.truth, drive.scene
    config = load(None, ["elevation.resolution=0.08"], scene="flat")
    played, run, out = Played(drive, config), tmp_path / "run.mcap", tmp_path / "closed.npz"
    so_far = len(truth) - 12
    for _ in range(so_far):
        played.scan()
    write_log(run, drive.part(so_far), ["elevation.resolution=0.08"])
    built = build([run], out, drift=6.0)
    assert len(built.record["closed"]) >= 2
    then = played.told.odometry(built.stamp)
    assert then is not None
    for _ in range(2):  # it drives while the map is made
        played.scan()
    before, epoch = played.walls_off(scene), played.status.epoch
    played.hear(played.elevation.on(t.MAP_PRIOR, closed(built, read(out, config.elevation), *then)))
    assert played.status.location == "closing"
    for _ in range(10):
        played.scan()
    start, *_, end = played.offsets
    place = planar_of(drive.odometry[-1])
    played.glides(place)
    assert math.dist(laid(start[1], place)[:2], laid(end[1], place)[:2]) > 0.03
    assert played.status.location == "closing"
    for _ in range(40):  # it stands
        played.scan(moves=False)
    assert (played.status.location, played.status.epoch) == ("located", epoch)
    here = laid(played.offsets[-1][1], place)
    assert math.dist(here[:2], truth[-1, :2, 3]) < 0.15
    assert played.walls_off(scene) < 0.7 * before


def by_themselves(drive: Seen) -> Played:
    """A stack that closes its loops."""
    settings = ["elevation.resolution=0.08", "loops.online=true", "loops.drift=6"]
    return Played(drive, load(None, settings, scene="flat"))


def test_loops_close_by_themselves_while_the_robot_drives(drive: Seen, tmp_path: Path) -> None:
    """Nobody gives a command: of a drive that drifts by half a metre, the map follows its loops."""
    truth, scene = drive.truth, drive.scene
    played = by_themselves(drive)
    played.follow_loops(tmp_path)
    told = set()
    for _ in truth:
        played.scan()
        told.add(played.status.location)
    assert told == {"", "closing"}, "it drives while it closes"
    played.glides(planar_of(drive.odometry[-1]))
    before, epoch = played.walls_off(scene), played.status.epoch
    far = math.dist(laid(played.offsets[0][1], planar_of(drive.odometry[-1]))[:2], truth[-1, :2, 3])
    assert far > 0.3
    for _ in range(40):  # it stands
        played.scan(moves=False)
    assert (played.status.location, played.status.epoch) == ("located", epoch)
    assert math.dist(laid(played.offsets[-1][1], planar_of(drive.odometry[-1]))[:2], truth[-1, :2, 3]) < 0.15
    assert played.walls_off(scene) < 0.7 * before


def test_loops_close_after_map_close_and_after_their_process_died(drive: Seen, tmp_path: Path) -> None:
    """Half-way round `map close` has the stack take a map, and the search dies: what it recorded is there again."""
    truth, half = drive.truth, len(drive.truth) // 2
    played = by_themselves(drive)
    died = played.follow_loops(tmp_path)
    for _ in range(half):
        played.scan()
    stamp = played.elevation.map.stamp
    prior = as_prior(played.elevation.map, stamp, f"{t.MAP_CLOSED.name}:closed.npz:{stamp}")
    there = np.array([*played.offsets[-1][1], 0.0])
    played.hear(played.elevation.on(t.MAP_PRIOR, replace(prior, odom_in_map=there, until=time_msg(stamp))))
    assert (played.status.location, played.status.prior) == ("located", prior.id)
    scans = len(died.recording.scans)
    with (tmp_path / SCAN_FILE).open("r+b") as file:
        file.truncate(file.seek(0, 2) - 5)  # it died while it wrote
    second = played.follow_loops(tmp_path)
    assert len(second.recording.scans) == scans - 1
    for _ in range(len(truth) - half):
        played.scan()
    for _ in range(40):
        played.scan(moves=False)
    assert second.closed is not None
    first = min(loop.match.first for loop in second.closed.loops)
    assert second.recording.scans[second.closed.keyframes[first].scan].stamp < stamp, (
        "with what was seen then"
    )
    assert played.status.location == "located"
    place = planar_of(drive.odometry[-1])
    assert math.dist(laid(played.offsets[-1][1], place)[:2], truth[-1, :2, 3]) < 0.15
    second.close()
    assert not list(tmp_path.iterdir()), "an end in order leaves nothing"


def planar_of(pose: np.ndarray) -> Planar:
    """Of a pose (4, 4)."""
    x, y, _, yaw = levelled(pose)
    return x, y, yaw
