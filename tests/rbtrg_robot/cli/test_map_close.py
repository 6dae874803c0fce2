"""`map close` against a stack that is played: the robot goes on with the new map, or hears why not."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hal.rotation import wrap
from hal.types import NS, Array
from mapping.elevation import ElevationMap
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.cli import close as map_close
from rbtrg_robot.cli.close import CloseError, close
from rbtrg_robot.config import load
from rbtrg_robot.log.read import CONFIG
from rbtrg_robot.log.write import LogWriter
from rbtrg_robot.orders.still import LIMIT, Still
from rbtrg_robot.provenance import fingerprint
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.convert import MAP, ODOM, odometry_msg, rpy_quaternion, transform_msg, yaw_of
from rbtrg_robot.wire.frames import MapFrame, offset_of
from rbtrg_robot.wire.messages import header
from tools.bench.ports import free_endpoint


class Stack:
    """Odometry and elevation of a robot that stands where a drive ended."""

    def __init__(self, bus: Bus, place: Array, start: Array, stamp: int) -> None:
        """place (4,) in `odom`: x, y, z [m], yaw [rad]; start (4,): of `odom` in `map`; stamp [ns] of the log's end."""
        self.place, self.prior, self.goal, self.epoch = place, "", "", 1
        self.areas: list[msg.GroundArea] = []
        self.frame = transform_msg(0, MAP, ODOM, (start[0], start[1], 0.0), rpy_quaternion((0, 0, start[3])))
        self._bus, self.stamp, self._over = bus, stamp - 3 * NS, threading.Event()
        bus.subscribe([t.MAP_PRIOR, t.INITIAL_POSE])
        for topic in (t.ODOM, t.MAP_STATUS, t.GOAL_STATUS, t.TF_STATIC, t.AREAS):
            bus.advertise(topic)
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> Stack:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def in_map(self) -> tuple[float, float, float]:
        """Where the robot stands."""
        frame = MapFrame()
        frame.take(msg.TFMessage(transforms=[self.frame]))
        return frame.pose2(self.place[0], self.place[1], self.place[3])

    def _odom(self) -> msg.Odometry:
        turned = np.array([0.0, 0.0, math.sin(self.place[3] / 2), math.cos(self.place[3] / 2)])
        return odometry_msg(self.stamp, self.place[:3], turned, np.zeros(3), np.zeros(3))

    def _run(self) -> None:
        while not self._over.is_set():
            self.stamp += NS // 5
            self._bus.publish(t.ODOM, self._odom(), self.stamp)
            status = msg.MapStatus(header=header(self.stamp, MAP), epoch=self.epoch, prior=self.prior)
            self._bus.publish(t.MAP_STATUS, status, self.stamp)
            self._bus.publish(t.AREAS, msg.Areas(areas=[msg.GroundArea()]), self.stamp)
            state = "moving" if self.goal else "reached"
            self._bus.publish(t.GOAL_STATUS, msg.GoalStatus(id=self.goal, state=state), self.stamp)
            self._bus.publish(t.TF_STATIC, msg.TFMessage(transforms=[self.frame]), self.stamp)
            for received in self._bus.take(0.02):
                message = received.decode()
                if received.topic is t.MAP_PRIOR:
                    self.prior, self.epoch, self.areas = message.id, self.epoch + 1, message.areas
                elif received.topic is t.INITIAL_POSE:
                    at = message.pose.pose
                    x, y, yaw = offset_of(
                        (at.position.x, at.position.y, yaw_of(at.orientation)), self._odom()
                    )
                    self.frame = transform_msg(0, MAP, ODOM, (x, y, 0.0), rpy_quaternion((0.0, 0.0, yaw)))


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run's folder."""
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / CONFIG).write_text(load(None, (), scene="flat").to_yaml())
    with LogWriter(folder / "run.mcap", {}, {CONFIG: load(None, (), scene="flat").to_yaml().encode()}):
        pass
    return folder


@pytest.fixture
def stack() -> Iterator[tuple[Stack, Bus]]:
    endpoint = free_endpoint()
    with (
        Bus(endpoint, "elevation", router=True) as there,
        Bus(endpoint, "cli") as bus,
        Stack(there, np.array([9.0, 2.0, 0.0, 1.0]), np.array([-6.5, -5.0, 0.0, 0.0]), 100 * NS) as played,
    ):
        yield played, bus


def flushed(run: Path) -> None:
    """The recorder writes on."""
    with LogWriter(run / f"run_{time.monotonic_ns()}.mcap", {}):
        pass


@pytest.mark.parametrize("drives", [False, True])
def test_the_robot_goes_on_with_a_map_whose_loops_are_closed(
    run: Path, stack: tuple[Stack, Bus], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, drives: bool
) -> None:
    played, bus = stack
    pose = np.eye(4)
    pose[:2, :2] = [[math.cos(1.1), -math.sin(1.1)], [math.sin(1.1), math.cos(1.1)]]
    pose[:3, 3] = 2.3, -3.2, 0.4

    def built(runs: list[Path], out: Path, *, areas: list[msg.GroundArea], **_: object) -> map_close.Built:
        stamp = played.stamp - NS  # of the end of the log
        assert runs == [run]
        assert len(areas) == 1, "what was drawn stays"
        elevation = ElevationMap()
        wheels = np.array([[0.2, -0.2, 0.0], [0.2, 0.2, 0.0], [-0.2, -0.2, 0.0], [-0.2, 0.2, 0.0]])
        elevation.fuse_ground(wheels, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), 1)
        elevation.save(out)
        was = played.place
        if drives:  # on, by a metre and a bit, while the map is made
            played.place = was + np.array([math.cos(was[3]), math.sin(was[3]), 0.0, 0.2])
        return map_close.Built(record={"closed": [{}, {}], "moved_m": 0.4}, stamp=stamp, pose=pose)

    monkeypatch.setattr(map_close, "build", built)
    out = tmp_path / "closed.npz"
    result = close(bus, run, out, 0.1, lambda _: flushed(run))
    assert result.loaded
    place = (2.3 + math.cos(1.1), -3.2 + math.sin(1.1), 1.3) if drives else (2.3, -3.2, 1.1)
    assert result.words.startswith(
        f"2 loops closed, the map moved by up to 0.40 m; the robot stands at x {place[0]:.2f} y {place[1]:.2f}"
    )
    assert (played.epoch, played.prior) == (2, fingerprint(str(out)))
    x, y, yaw = played.in_map()
    assert (x, y) == pytest.approx(place[:2], abs=0.01)
    assert abs(wrap(yaw - place[2])) < 0.01
    again = close(bus, run, out, 0.1, lambda _: flushed(run))
    assert again.loaded, "the map that it made itself is no prior map of somebody"


def test_a_robot_that_cannot_stand_still_or_has_a_prior_map_keeps_its_map(
    run: Path, stack: tuple[Stack, Bus], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    played, bus = stack
    played.prior = "0" * 64
    with pytest.raises(CloseError, match="began with a prior map"):
        close(bus, run, tmp_path / "closed.npz", 0.1, lambda _: flushed(run))
    played.prior = ""

    def busy(*_a: object, **_k: object) -> map_close.Built:
        played.goal = "g1"
        return map_close.Built(record={"closed": [{}], "moved_m": 1.0}, stamp=played.stamp - NS)

    monkeypatch.setattr(map_close, "build", busy)
    monkeypatch.setattr(map_close, "read", lambda *_: msg.MapPrior())
    with pytest.raises(CloseError, match=r"is made, but the stack goes on .* on its way to goal g1"):
        close(bus, run, tmp_path / "closed.npz", 0.1, lambda _: flushed(run), wait=1.0)
    played.goal = ""

    def old(*_a: object, **_k: object) -> map_close.Built:
        return map_close.Built(record={"closed": [{}], "moved_m": 1.0}, stamp=played.stamp - 600 * NS)

    monkeypatch.setattr(map_close, "build", old)
    with pytest.raises(CloseError, match="ends before the odometry was heard"):
        close(bus, run, tmp_path / "closed.npz", 0.1, lambda _: flushed(run))

    def small(*_a: object, **_k: object) -> map_close.Built:
        return map_close.Built(record={"closed": [{}], "moved_m": 0.02}, stamp=10**19)

    monkeypatch.setattr(map_close, "build", small)
    result = close(bus, run, tmp_path / "closed.npz", 0.1, lambda _: flushed(run))
    assert not result.loaded
    assert "1 loops moved it by 0.02 m" in result.words
    assert played.epoch == 1


def test_still_ends_for_a_robot_that_moves_or_has_a_goal() -> None:
    for goal, words in (("g1", "on its way to goal g1"), ("", "it moves")):
        order = Still()
        order.tick(0.0)
        order.take(t.MAP_STATUS, msg.MapStatus())
        order.take(t.GOAL_STATUS, msg.GoalStatus(id="g1", state="moving" if goal else "reached"))
        for k in range(50):
            speed = 0.0 if goal else 0.2 * (k % 5 == 0)
            odom = odometry_msg(
                k * NS // 5, np.zeros(3), np.array([0, 0, 0, 1.0]), np.array([speed, 0, 0]), np.zeros(3)
            )
            order.take(t.ODOM, odom)
        assert order.outcome is None
        order.tick(LIMIT + 0.1)
        assert order.outcome is not None
        assert words in order.outcome.words
    silent = Still()
    silent.tick(0.0)
    silent.tick(LIMIT + 0.1)
    assert silent.outcome is not None
    assert "tells no pose" in silent.outcome.words
