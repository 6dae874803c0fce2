"""`map close` against a stack that is played: it goes on with the new map, or tells why not."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hal.types import NS, Array
from mapping.elevation import ElevationMap
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.cli import close as map_close
from rbtrg_robot.cli.close import CloseError, close
from rbtrg_robot.config import load
from rbtrg_robot.log.read import CONFIG
from rbtrg_robot.log.write import LogWriter
from rbtrg_robot.orders import map as map_orders
from rbtrg_robot.orders.heard import Heard
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.convert import MAP, odometry_msg
from rbtrg_robot.wire.frames import laid
from rbtrg_robot.wire.messages import header, stamp_of
from tools.bench.ports import free_endpoint


class Stack:
    """Odometry and elevation of a robot that is where a drive ended."""

    def __init__(self, bus: Bus, place: Array, stamp: int) -> None:
        """place (4,) in `odom`: x, y, z [m], yaw [rad]; stamp [ns] of the log's end."""
        self.place, self.prior, self.location, self.epoch = place, "", "", 1
        self.height, self.detail = 0.05, ""
        self.refuses, self.glides = False, 0.5
        self.taken: msg.MapPrior | None = None
        self.areas: list[msg.GroundArea] = []
        self._bus, self.stamp, self._over = bus, stamp - 3 * NS, threading.Event()
        bus.subscribe([t.MAP_PRIOR])
        for topic in (t.ODOM, t.MAP_STATUS, t.AREAS):
            bus.advertise(topic)
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> Stack:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _odom(self) -> msg.Odometry:
        turned = np.array([0.0, 0.0, math.sin(self.place[3] / 2), math.cos(self.place[3] / 2)])
        return odometry_msg(self.stamp, self.place[:3], turned, np.zeros(3), np.zeros(3))

    def _run(self) -> None:
        while not self._over.is_set():
            self.stamp += NS // 5
            self._bus.publish(t.ODOM, self._odom(), self.stamp)
            status = msg.MapStatus(
                header=header(self.stamp, MAP),
                epoch=self.epoch,
                prior=self.prior,
                location=self.location,
                height_correction=self.height,
                detail=self.detail,
            )
            self._bus.publish(t.MAP_STATUS, status, self.stamp)
            self._bus.publish(t.AREAS, msg.Areas(areas=[msg.GroundArea()]), self.stamp)
            for received in self._bus.take(0.02):
                self._answer(received.decode())

    def _answer(self, prior: msg.MapPrior) -> None:
        if self.refuses:
            self.detail = "the map was not loaded: the robot does not know where it is"
        elif self.location != "closing" and prior.id != self.prior:
            self.taken, self.location = prior, "closing"
            threading.Timer(self.glides, self._arrive).start()

    def _arrive(self) -> None:
        assert self.taken is not None
        self.prior, self.location, self.detail = self.taken.id, "located", "the loops of the map were closed"


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
        Stack(there, np.array([9.0, 2.0, 0.0, 1.0]), 100 * NS) as played,
    ):
        yield played, bus


def flushed(run: Path) -> None:
    """The recorder writes on."""
    with LogWriter(run / f"run_{time.monotonic_ns()}.mcap", {}):
        pass


def test_the_stack_goes_on_with_a_map_whose_loops_are_closed(
    run: Path, stack: tuple[Stack, Bus], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    played, bus = stack
    monkeypatch.setattr(map_orders, "TIME_LIMIT", 4.0)
    played.glides = 6.0  # longer than an answer may take: the map that comes is heard of meanwhile
    pose = np.eye(4)
    pose[:2, :2] = [[math.cos(1.1), -math.sin(1.1)], [math.sin(1.1), math.cos(1.1)]]
    pose[:3, 3] = 2.3, -3.2, 0.4
    was, ends = played.place, list[int]()

    def built(runs: list[Path], out: Path, *, areas: list[msg.GroundArea], **_: object) -> map_close.Built:
        stamp = played.stamp - 4 * NS  # the robot stood: its newest scan is older than the log's end
        ends.append(stamp)
        assert runs == [run]
        assert len(areas) == 1, "what was drawn stays"
        elevation = ElevationMap()
        wheels = np.array([[0.2, -0.2, 0.0], [0.2, 0.2, 0.0], [-0.2, -0.2, 0.0], [-0.2, 0.2, 0.0]])
        elevation.fuse_ground(wheels, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), 1)
        elevation.save(out)
        played.place = was + np.array([3.0, 1.0, 0.1, 0.2])  # it drives on while the map is made
        return map_close.Built(record={"closed": [{}, {}], "moved_m": 0.4}, stamp=stamp, pose=pose)

    monkeypatch.setattr(map_close, "build", built)
    out = tmp_path / "closed.npz"
    result = close(bus, run, out, 0.1, lambda _: flushed(run))
    assert result.loaded
    assert result.words == "2 loops closed, the map moved by up to 0.40 m; the loops of the map were closed"
    assert played.prior.startswith(t.MAP_CLOSED.name), "loops that close by themselves go on"
    prior = played.taken
    assert prior is not None
    x, y, yaw, lift = prior.odom_in_map.tolist()
    # where the robot was at the end of the log it is in the new map
    assert laid((x, y, yaw), (was[0], was[1], was[3])) == pytest.approx((2.3, -3.2, 1.1))
    assert lift == pytest.approx(0.4 - was[2] - 0.05)
    assert prior.until.sec * NS + prior.until.nanosec == ends[0]
    again = close(bus, run, out, 0.1, lambda _: flushed(run))
    assert again.loaded, "the map that it made itself is no prior map of somebody"


def test_what_is_not_closed_says_why(
    run: Path, stack: tuple[Stack, Bus], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    played, bus = stack
    played.prior = "0" * 64
    with pytest.raises(CloseError, match="began with a prior map"):
        close(bus, run, tmp_path / "closed.npz", 0.1, lambda _: flushed(run))
    played.prior, played.refuses = f"{t.MAP_CLOSED.name}:1", True

    def moved(by: float, ago: int) -> None:
        record = {"closed": [{}], "moved_m": by}
        monkeypatch.setattr(
            map_close, "build", lambda *_a, **_k: map_close.Built(record=record, stamp=played.stamp - ago)
        )

    monkeypatch.setattr(map_close, "read", lambda *_: msg.MapPrior(id="1" * 64))
    moved(1.0, NS)
    with pytest.raises(CloseError, match=r"is made, but the stack goes on .* does not know where it is"):
        close(bus, run, tmp_path / "closed.npz", 0.1, lambda _: flushed(run))
    moved(1.0, 600 * NS)
    with pytest.raises(CloseError, match="ends before the odometry was heard"):
        close(bus, run, tmp_path / "closed.npz", 0.1, lambda _: flushed(run))
    moved(0.02, 0)
    result = close(bus, run, tmp_path / "closed.npz", 0.1, lambda _: flushed(run))
    assert not result.loaded
    assert "1 loops moved it by 0.02 m" in result.words
    assert played.taken is None


def test_what_was_heard_of_a_scan_is_told_by_its_stamp() -> None:
    heard = Heard()

    def odom(stamp: int) -> msg.Odometry:
        return odometry_msg(stamp, np.zeros(3), np.array([0, 0, 0, 1.0]), np.zeros(3), np.zeros(3))

    heard.take(t.ODOM, odom(NS))
    assert heard.seconds == 0.0, "no map was heard of"
    for k in range(2, 30):
        heard.take(t.MAP_STATUS, msg.MapStatus(prior="x", height_correction=0.01 * k))
        heard.take(t.ODOM, odom(k * NS // 10))
    assert (heard.prior, heard.seconds) == ("x", pytest.approx(2.7))
    told = heard.odometry(NS)
    assert told is not None
    assert (stamp_of(told[0]), told[1]) == (NS, pytest.approx(0.1))
    assert heard.odometry(5 * NS) is None
