"""A run's folder is a rosbag2 that other programs open as it is."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest
import yaml
from mcap.records import Channel, Schema
from rosbags.highlevel import AnyReader

from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.log import recorder as log_recorder
from rbtrg_robot.log.bag import NAME, describe
from rbtrg_robot.log.read import Entry, read_log
from rbtrg_robot.log.recorder import Recorder
from rbtrg_robot.log.write import LogWriter
from rbtrg_robot.stage_config import RecorderConfig
from rbtrg_robot.wire.clock import SourceClock
from rbtrg_robot.wire.messages import encode, header


def test_files_that_end_together_are_described_one_after_the_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two threads wrote one draft: the description was half of each."""
    at_once, most, others = 0, 0, threading.Barrier(2)

    def slow(folder: Path) -> None:
        nonlocal at_once, most
        at_once += 1
        most = max(most, at_once)
        try:
            others.wait(0.3)  # for another one, which must not come
        except threading.BrokenBarrierError:
            others.reset()
        at_once -= 1
        describe(folder)

    monkeypatch.setattr(log_recorder, "describe", slow)
    now = 0.0
    monkeypatch.setattr(log_recorder.time, "monotonic", lambda: now)
    recorder = Recorder(tmp_path, RecorderConfig(rotate_seconds=10.0, spare_gb=0.0), {}, {}, SourceClock())
    for k in range(3):
        recorder.write(t.IMU, encode(msg.Imu(header=header(k + 1, "x"))), k + 1, k + 1)
        now += 11.0
        recorder.housekeep()
    recorder.close()
    assert most == 1
    assert len(yaml.safe_load((tmp_path / NAME).read_text())["rosbag2_bagfile_information"]["files"]) == 3


def test_others_open_the_folder_and_every_file_begins_with_what_is_latched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 0.0
    monkeypatch.setattr(log_recorder.time, "monotonic", lambda: now)
    recorder = Recorder(tmp_path, RecorderConfig(rotate_seconds=10.0, spare_gb=0.0), {}, {}, SourceClock())
    recorder.write(t.DESCRIPTION, encode(msg.String(data="<robot/>")), 1, 1)
    recorder.write(t.TF_STATIC, encode(msg.TFMessage()), 1, 1)
    for k in range(3):
        recorder.write(t.IMU, encode(msg.Imu(header=header(k + 1, "x"))), k + 1, k + 1)
        now += 11.0
        recorder.housekeep()
    recorder.write(t.IMU, encode(msg.Imu()), 4, 4)
    recorder.close()
    for k in range(4):
        first, second, *_ = (entry for entry, *_ in read_log(tmp_path / f"log_{k}.mcap"))
        assert (first.topic, second.topic) == (t.DESCRIPTION.name, t.TF_STATIC.name)
    with AnyReader([tmp_path]) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
        texts = [
            reader.deserialize(raw, c.msgtype).data
            for c, _, raw in reader.messages()
            if c.topic == t.DESCRIPTION.name
        ]
    assert counts == {t.DESCRIPTION.name: 4, t.TF_STATIC.name: 4, t.IMU.name: 4}
    assert texts == ["<robot/>"] * 4


def test_a_file_that_is_being_written_and_other_encodings_are_left_out_of_the_description(
    tmp_path: Path,
) -> None:
    with LogWriter(tmp_path / "log_0.mcap", {}) as writer:
        writer.write(t.IMU, encode(msg.Imu()), 5, 5)
        writer.copy(
            Entry("/x", "T", b"{}", 6, 6, 1),
            Schema(0, b"", "jsonschema", "T"),
            Channel(0, "/x", "json", {}, 0),
        )
    with LogWriter(tmp_path / "log_1.mcap", {}) as unfinished:
        unfinished.write(t.IMU, encode(msg.Imu()), 7, 7)
        unfinished.flush()
        describe(tmp_path)
        told = yaml.safe_load((tmp_path / NAME).read_text())["rosbag2_bagfile_information"]
        assert told["relative_file_paths"] == ["log_0.mcap"]
        assert [x["topic_metadata"]["name"] for x in told["topics_with_message_count"]] == [t.IMU.name]
