"""The camera process: frames while somebody looks, few otherwise, and never a reason to end."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hal.camera import CameraError, CameraFrame
from hal.mujoco.view.camera import RenderedCamera
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts import camera as module
from rbtrg_robot.hosts import robot as robot_host
from rbtrg_robot.hosts.camera import RETRY_AFTER, Demand, Desk, image_msg, info_msg, source_of
from rbtrg_robot.log.moments import TIME_AROUND, Moments, Thinned
from rbtrg_robot.log.photos import photos, save
from rbtrg_robot.log.write import LogWriter
from rbtrg_robot.wire.messages import decode, encode, stamp_of


def frames(demand: Demand, begin: float, end: float) -> int:
    """Frames that come due from `begin` to `end` [s]."""
    return sum(demand.due(begin + k / 100.0) for k in range(round(100 * (end - begin))))


def test_nothing_is_drawn_while_nobody_looks_and_nothing_records() -> None:
    assert frames(Demand(5.0, recorded=False), 0.0, 10.0) == 0


def test_once_a_second_for_the_log_and_at_its_rate_while_somebody_looks() -> None:
    demand = Demand(5.0, recorded=True)
    assert frames(demand, 0.0, 10.0) == 10
    demand.looked_at(10.0)
    assert frames(demand, 10.0, 12.0) == pytest.approx(10, abs=1)
    assert frames(demand, 12.0, 22.0) == pytest.approx(10, abs=1)


@pytest.mark.parametrize(("cost", "count"), [(0.02, 50), (0.06, 0), (math.inf, 0)])
def test_frames_that_cost_little_come_all_the_time(cost: float, count: int) -> None:
    assert frames(Demand(5.0, recorded=False, always=None, cost=cost), 0.0, 10.0) == pytest.approx(
        count, abs=1
    )


class Source:
    """A camera that fails until it is told otherwise."""

    def __init__(self, seconds: float = 0.0) -> None:
        """`seconds`: CPU that a frame takes."""
        self.broken, self.seconds = True, seconds
        self.opened = self.closed = self.shown = 0
        self.hangs = False

    def open(self) -> str:
        self.opened += 1
        return "made up"

    def frame(self, now: int) -> CameraFrame:
        if self.broken:
            raise CameraError("no light: switch it on")
        began = time.process_time()
        while time.process_time() - began < self.seconds:
            pass
        self.shown += not self.hangs
        return CameraFrame(now, b"\xff\xd8picture %d" % self.shown)

    def close(self) -> None:
        self.closed += 1


def test_a_camera_that_fails_is_told_and_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    source = Source()
    monkeypatch.setattr(module, "source_of", lambda *_: source)
    config = load(None, [], scene="flat", record=False)
    camera = config.camera.mounted()
    assert camera is not None
    desk = Desk(config, camera)
    assert desk.frame(0.0, 0) is None, "nobody looks"
    assert not source.opened, "nothing is loaded before"
    desk.take(t.CAMERA_REQUEST, msg.String(data="test"), 1.0)
    assert desk.frame(1.0, 5) is None
    assert desk.trouble == "no light: switch it on"
    assert source.closed == 1
    source.broken = False
    desk.take(t.CAMERA_REQUEST, msg.String(data="test"), 2.0)
    assert desk.frame(2.0, 6) is None, "not so soon"
    desk.take(t.CAMERA_REQUEST, msg.String(data="test"), 1.0 + RETRY_AFTER)
    frame = desk.frame(1.1 + RETRY_AFTER, 7)
    assert frame is not None
    assert desk.trouble == ""
    image = decode(encode(image_msg(camera, frame)), msg.CompressedImage)
    assert (image.format, image.data.tobytes(), stamp_of(image)) == ("jpeg", b"\xff\xd8picture 1", 7)
    info = decode(encode(info_msg(camera, 3)), msg.CameraInfo)
    assert info.k.reshape(3, 3).tolist() == camera.matrix.tolist()
    assert info.header.frame_id == image.header.frame_id == "camera_front"


@pytest.mark.parametrize("drawn", [False, True])
def test_a_camera_that_repeats_one_picture_shows_nothing_new_and_is_told(
    monkeypatch: pytest.MonkeyPatch, drawn: bool
) -> None:
    source = Source()
    source.broken = False
    monkeypatch.setattr(module, "source_of", lambda *_: source)
    config = load(None, [] if drawn else ["camera.source=v4l2:/dev/video0"], scene="flat", record=False)
    camera = config.camera.mounted()
    assert camera is not None
    desk = Desk(config, camera)
    came: list[bool] = []
    told: list[str] = []
    for k in range(40):  # 10 s; it hangs from the third second to the seventh
        source.hangs = 12 <= k < 28
        desk.take(t.CAMERA_REQUEST, msg.String(data="test"), 0.25 * k)
        came.append(desk.frame(0.25 * k, k) is not None)
        told.append(desk.trouble)
    assert [k for k in range(40) if not came[k]] == ([] if drawn else list(range(12, 28)))
    assert [k for k in range(40) if told[k]] == ([] if drawn else list(range(20, 28)))
    assert drawn or told[25].startswith("it sends one picture again and again")


@pytest.mark.parametrize(("seconds", "always"), [(0.0, True), (0.06, False)])
def test_what_a_frame_costs_is_measured_and_a_cheap_one_comes_all_the_time(
    monkeypatch: pytest.MonkeyPatch, seconds: float, always: bool
) -> None:
    source = Source(seconds)
    source.broken = False
    monkeypatch.setattr(module, "source_of", lambda *_: source)
    config = load(None, [], scene="flat", record=False)
    camera = config.camera.mounted()
    assert camera is not None
    desk = Desk(config, camera)
    desk.take(t.CAMERA_REQUEST, msg.String(data="test"), 0.0)
    assert desk.frame(0.0, 1) is not None
    assert (desk.frame(100.0, 2) is not None) is always


def test_the_simulated_camera_counts_the_times_of_obstacles_from_where_the_simulator_does() -> None:
    config = load(None, [], scene="flat")
    camera = config.camera.mounted()
    assert camera is not None
    drawn, driven = source_of(config, camera), robot_host.build(config, begin=robot_host.CLOCK_BEGIN)
    assert isinstance(drawn, RenderedCamera)
    assert drawn.start_time == driven.start_time


def state(**fields: Any) -> msg.RobotState:
    return msg.RobotState(phase="ready", **fields)


def test_stops_falls_touches_and_refusals_are_moments_once() -> None:
    moments = Moments()
    assert not moments.begins(t.ROBOT_STATE, state())
    assert moments.begins(t.ROBOT_STATE, state(estop=True))
    assert not moments.begins(t.ROBOT_STATE, state(estop=True))
    assert not moments.begins(t.ROBOT_STATE, state())
    assert moments.begins(t.ROBOT_STATE, msg.RobotState(phase="fault"))
    assert moments.begins(t.GOAL_STATUS, msg.GoalStatus(id="a", state="rejected"))
    assert not moments.begins(t.GOAL_STATUS, msg.GoalStatus(id="a", state="rejected"))
    assert moments.begins(t.GOAL_STATUS, msg.GoalStatus(id="b", state="aborted"))
    assert not moments.begins(t.GOAL_STATUS, msg.GoalStatus(id="c", state="reached"))
    assert moments.begins(t.TOUCHED, msg.PoseStamped())
    moments = Moments()
    refused = [(9, 0), (9, 0), (10, 0), (11, 5), (12, 5), (13, 0), (13, 0), (14, 0)]
    begun = [
        moments.begins(t.ROBOT_STATE, state(latch=latch, refused_count=np.array([count], np.uint32)))
        for count, latch in refused
    ]
    assert begun == [False, False, True, False, False, False, False, True], (
        "not before this process, nor while latched"
    )


def test_what_is_thinned_is_whole_around_a_moment() -> None:
    thinned = Thinned(1.0)
    written = [k for k in range(100) for _ in thinned.take(k, 0.2 * k)]
    assert written == pytest.approx(list(range(0, 100, 5)), abs=1)
    before = thinned.moment(20.0)
    assert before == [k for k in range(76, 100) if k not in written], (
        "those of the last 5 s that were left out"
    )
    after = [k for k in range(100, 150) if thinned.take(k, 0.2 * k)]
    assert after[:25] == list(range(100, 125)), f"all of them for {TIME_AROUND} s"
    assert len(after[25:]) <= 6
    jitter = [0.02 * (-1) ** k for k in range(20)]
    thinned = Thinned(1.0)
    assert all(thinned.take(k, k + late) for k, late in enumerate(jitter)), (
        "one a second comes not every second time"
    )


def test_who_wants_a_photo_gets_the_next_frame_and_the_log_gives_it_back(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    source = Source()
    source.broken = False
    monkeypatch.setattr(module, "source_of", lambda _config, _camera: source)
    config = load(None, [], scene="flat", record=False)
    camera = config.camera.mounted()
    assert camera is not None
    desk = Desk(config, camera)
    desk.take(t.CAMERA_REQUEST, msg.String(), 0.0)
    assert desk.frame(0.0, 1) is not None
    assert not desk.keeps()
    desk.take(t.PHOTO_REQUEST, msg.String(), 10.0)
    frame = desk.frame(10.0, 2)
    assert frame is not None
    assert desk.keeps()
    assert not desk.keeps()
    with LogWriter(tmp_path / "log_0.mcap", {}) as writer:
        for k in range(1, 4):
            image = encode(image_msg(camera, CameraFrame(k, b"\xff\xd8" + bytes([k]))))
            writer.write(t.PHOTO, image, k, k, k)
            writer.write(t.CAMERA, image, k, k, k)
    whole = (tmp_path / "log_0.mcap").read_bytes()
    (tmp_path / "cut").mkdir()
    (tmp_path / "cut" / "log_0.mcap").write_bytes(whole[:-200])  # without its index
    for folder in (tmp_path, tmp_path / "cut"):
        assert [(p.name, p.jpeg) for p in photos(folder / "log_0.mcap")] == [
            (f"{k}.jpg", b"\xff\xd8" + bytes([k])) for k in range(1, 4)
        ]
    assert [path.read_bytes()[-1] for path in save(tmp_path / "log_0.mcap", tmp_path / "out")] == [1, 2, 3]
