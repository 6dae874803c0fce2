"""Logs: readable by others, recoverable wherever they were cut, the same bytes for the same messages."""

from __future__ import annotations

import os
import signal
import struct
import subprocess
import sys
import tracemalloc
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Schema
from rosbags.highlevel import AnyReader

from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.cli.stack import _run_folder
from rbtrg_robot.log import read as log_read
from rbtrg_robot.log import write as log_write
from rbtrg_robot.log.read import CONFIG, Entry, LogContents, LogError, first_of, read_log, read_run
from rbtrg_robot.log.stats import summarize
from rbtrg_robot.log.summary import is_intact, overview
from rbtrg_robot.log.write import LogWriter, recover
from rbtrg_robot.wire.messages import encode, header
from tests.places import ROOT


def write(path: Path, count: int = 200, *, drop: int = -1, close: bool = True) -> LogWriter:
    """IMU at 200 Hz, one status; message number `drop` is missing."""
    writer = LogWriter(path, {"scene": "flat", "seed": "3"}, {CONFIG: b"seed: 3\n"})
    for i in range(count):
        if i != drop:
            stamp = i * 5_000_000
            writer.write(t.IMU, encode(t.IMU.kind(header=header(stamp, "base_link"))), stamp, stamp, i + 1)
    writer.write(t.GOAL_STATUS, encode(t.GOAL_STATUS.kind(id="g")), count * 5_000_000, 1, 1)
    if close:
        writer.close()
    return writer


def test_rosbags_and_mcap_read_every_message(tmp_path: Path) -> None:
    path = tmp_path / "log_0.mcap"
    write(path)
    with AnyReader([path]) as reader:
        stamps = [
            reader.deserialize(raw, connection.msgtype).header.stamp.nanosec
            for connection, _, raw in reader.messages()
            if connection.topic == "/imu/data"
        ]
    assert stamps == [i * 5_000_000 for i in range(200)]
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 201
    assert summary.statistics.attachment_count == 1


def test_same_messages_give_the_same_bytes(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap")
    write(tmp_path / "b.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_a_log_and_the_folder_of_a_run_are_the_users_alone(tmp_path: Path) -> None:
    folder = _run_folder(tmp_path / "logs", "yard")
    with LogWriter(folder / "log_0.mcap", {}):
        assert (folder / "log_0.mcap").stat().st_mode & 0o077 == 0
    assert folder.stat().st_mode & 0o077 == 0


def test_what_was_flushed_survives_sigkill(tmp_path: Path) -> None:
    path = tmp_path / "log_0.mcap"
    script = (
        "import sys, time; from pathlib import Path; from tests.rbtrg_robot.log.test_file import write\n"
        f"writer = write(Path({str(path)!r}), 300, close=False); writer.flush(); print('flushed', flush=True)\n"
        "time.sleep(60)\n"
    )
    child = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, cwd=ROOT)
    assert child.stdout is not None
    assert child.stdout.readline() == b"flushed\n"
    os.kill(child.pid, signal.SIGKILL)
    child.wait()
    child.stdout.close()
    assert not is_intact(path)
    count, damage = recover(path, tmp_path / "fixed.mcap")
    assert count == 301
    assert damage
    assert is_intact(tmp_path / "fixed.mcap")
    assert first_of(tmp_path / "fixed.mcap").attachments[CONFIG] == b"seed: 3\n"


@pytest.mark.parametrize("share", [0.2, 0.5, 0.8, 0.99])
def test_a_truncated_log_reads_up_to_the_cut(tmp_path: Path, share: float) -> None:
    path = tmp_path / "log_0.mcap"
    writer = LogWriter(path, {"scene": "flat"})
    for i in range(400):
        writer.write(t.IMU, encode(t.IMU.kind()), i, i, i + 1)
        if i % 20 == 0:
            writer.flush()
    writer.close()
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    contents = LogContents()
    times = [entry.log_time for entry, _, _ in read_log(path, contents)]
    assert times == list(range(len(times)))
    assert contents.damage or share > 0.9
    assert any("recover" in line for line in summarize(path).damage) or contents.indexed


def test_a_log_that_is_being_written_is_not_called_damaged(tmp_path: Path) -> None:
    path = tmp_path / "log_0.mcap"
    with LogWriter(path, {"scene": "flat"}) as writer:
        writer.write(t.IMU, encode(t.IMU.kind(header=header(5, "base_link"))), 5, 5, 1)
        writer.flush()
        summary = summarize(path)
        assert (summary.unfinished, summary.problems()) == (["log_0.mcap"], [])
        assert summary.topics["/imu/data"].count == 1
    summary = summarize(path)
    assert (summary.unfinished, summary.problems()) == ([], [])
    path.write_bytes(path.read_bytes()[:-20])
    assert len(summarize(path).problems()) == 1


def test_what_is_no_log_is_refused_in_words(tmp_path: Path) -> None:
    text = tmp_path / "notes.mcap"
    text.write_text("dear diary")
    with pytest.raises(LogError, match="not an MCAP file"):
        list(read_log(text))
    with pytest.raises(LogError, match="there is no"):
        list(read_run(tmp_path / "missing.mcap"))
    (tmp_path / "empty").mkdir()
    with pytest.raises(LogError, match=r"no \.mcap file"):
        list(read_run(tmp_path / "empty"))


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(LogError, match="--log-dir"):
        LogWriter(tmp_path / "file" / "log_0.mcap", {})


def test_recover_never_overwrites(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap")
    write(tmp_path / "b.mcap")
    with pytest.raises(LogError, match="exists"):
        recover(tmp_path / "a.mcap", tmp_path / "b.mcap")


def test_recover_says_why_nothing_comes_of_it(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap")
    with pytest.raises(LogError, match=r"a folder: recover one of its files, as in .*a\.mcap"):
        recover(tmp_path, tmp_path / "b.mcap")
    (tmp_path / "a.mcap").write_bytes((tmp_path / "a.mcap").read_bytes()[:800])
    with pytest.raises(LogError, match="ends within its first messages"):
        recover(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert not (tmp_path / "b.mcap").exists()


def test_pictures_that_the_recorder_left_out_or_added_late_are_no_loss(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with LogWriter(path, {}, {}) as writer:
        for number in (1, 6, 11, 8, 9, 12):
            writer.write(t.CAMERA, encode(msg.CompressedImage()), 10**9 * number, 10**9 * number, number)
    assert summarize(path).problems() == []


def test_statistics_find_the_missing_message(tmp_path: Path) -> None:
    write(tmp_path / "log_0.mcap", drop=77)
    summary = summarize(tmp_path)
    imu = summary.topics["/imu/data"]
    assert (imu.count, imu.missing) == (199, 1)
    assert imu.rate == pytest.approx(199.0, abs=1.0)
    assert imu.longest_gap == pytest.approx(0.010)
    assert summary.metadata["scene"] == "flat"
    assert summary.problems() == ["/imu/data: 1 of 200 messages are missing"]


def test_a_full_disk_is_told_in_one_line_and_may_have_room_later(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="No space left on device; make room") as raised:
        LogWriter(Path("/dev/full"), {})
    assert raised.value.retry
    (tmp_path / "file").touch()
    with pytest.raises(LogError, match="choose another --log-dir") as raised:
        LogWriter(tmp_path / "file" / "log.mcap", {})
    assert not raised.value.retry


@pytest.mark.parametrize("stamp", [-1, -(2**63), 2**63 - 1, 2**64])
def test_a_stamp_that_no_log_can_hold_does_not_end_the_recording(tmp_path: Path, stamp: int) -> None:
    """An attachment says what its sender wants."""
    with LogWriter(tmp_path / "log.mcap", {}) as writer:
        writer.write(t.CLOCK, encode(t.CLOCK.kind()), 5, stamp, -7)
    (entry,) = read_run(tmp_path / "log.mcap")
    assert entry.publish_time == min(max(stamp, 0), 2**64 - 1)


def test_a_length_that_no_memory_has_is_damage_and_no_crash(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with LogWriter(path, {}) as writer:
        writer.write(t.HEARTBEAT, encode(msg.Heartbeat()), 1, 1)
    content = RecordBuilder()
    broken = bytes([0x7F]) + struct.pack("<Q", 2**63)
    Chunk("", broken, 0, 0, 0, len(broken)).write(content)
    whole = path.read_bytes()
    at = 8  # behind the magic: records of an opcode, a length and so many bytes
    for _record in ("header", "metadata"):
        at += 9 + struct.unpack_from("<Q", whole, at + 1)[0]
    path.write_bytes(whole[:at] + content.end() + whole[at:])
    contents = LogContents()
    assert list(read_log(path, contents)) == []
    assert "OverflowError" in contents.damage


def test_a_recorder_that_was_killed_before_it_wrote_does_not_spoil_the_run(tmp_path: Path) -> None:
    (tmp_path / "log_0.mcap").touch()
    with LogWriter(tmp_path / "log_1.mcap", {}) as writer:
        writer.write(t.ODOM, encode(t.ODOM.kind()), 1, 1)
    assert [entry.topic for entry in read_run(tmp_path)] == [t.ODOM.name]


def with_chunk(path: Path, chunk: Chunk) -> LogContents:
    """What is found in a log whose first chunk is this one."""
    with LogWriter(path, {}) as writer:
        writer.write(t.HEARTBEAT, encode(msg.Heartbeat()), 1, 1)
    content = RecordBuilder()
    chunk.write(content)
    whole = path.read_bytes()
    at = 8
    for _record in ("header", "metadata"):
        at += 9 + struct.unpack_from("<Q", whole, at + 1)[0]
    path.write_bytes(whole[:at] + content.end() + whole[at:])
    contents = LogContents()
    assert list(read_log(path, contents)) == []
    return contents


ZEROS = zstandard.compress(bytes(1_000_000))


@pytest.mark.parametrize(
    "chunk",
    [
        Chunk("zstd", ZEROS, 0, 0, 0, 1 << 32),  # as much memory as it says
        Chunk("zstd", ZEROS, 0, 0, 0, 10),  # more bytes than it says
        Chunk("zstd", ZEROS[:-4], 0, 0, 0, 1_000_000),
        Chunk("lz4", b"\x04\x22M\x18" + bytes([255] * 50), 0, 0, 0, 10),
        Chunk("lz4", lz4.frame.compress(bytes(1_000_000)), 0, 0, 0, 10),
        Chunk("brotli", b"abc", 0, 0, 0, 3),
        Chunk("zstd", ZEROS, 0, 0, 12345, 1_000_000),  # another checksum
    ],
    ids=["huge", "bomb", "cut", "no lz4", "lz4 bomb", "brotli", "checksum"],
)
def test_a_chunk_that_lies_is_damage(tmp_path: Path, chunk: Chunk) -> None:
    assert with_chunk(tmp_path / "a.mcap", chunk).damage


def test_a_chunk_never_takes_more_memory_than_it_says(tmp_path: Path) -> None:
    bomb = zstandard.compress(bytes(100_000_000))
    tracemalloc.start()
    with_chunk(tmp_path / "a.mcap", Chunk("zstd", bomb, 0, 0, 0, 10))
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 20_000_000


def test_a_log_of_more_topics_than_a_file_can_number_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path / "a.mcap")
    monkeypatch.setattr(log_write, "MOST_TOPICS", 1)
    with pytest.raises(LogError, match="more than 1 topics"):
        recover(tmp_path / "a.mcap", tmp_path / "b.mcap")


def test_a_cloud_that_another_program_packed_does_not_end_the_log(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    foreign = encode(msg.CompressedPointCloud2(format="draco", compressed_data=np.arange(9, dtype=np.uint8)))
    kind = msg.CompressedPointCloud2.__msgtype__
    with LogWriter(path, {}) as writer:
        writer.copy(
            Entry("/c", kind, foreign, 1, 1, 1),
            Schema(0, b"", "ros2msg", kind),
            Channel(0, "/c", "cdr", {}, 0),
        )
        writer.write(t.HEARTBEAT, encode(msg.Heartbeat()), 2, 2)
    contents = LogContents()
    first, _second = (entry.data for entry, *_ in read_log(path, contents))
    assert first == foreign
    assert not contents.damage
    assert overview(path).topics["/c"].count == 1


def test_recover_keeps_both_channels_of_a_topic_and_all_facts(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with LogWriter(path, {"scene": "flat"}) as writer:
        writer.add_metadata("acme", {"lot": "7"})
        for encoding, data in (("json", b"{}"), ("cbor", b"\xa0")):
            writer.copy(
                Entry("/x", "T", data, 1, 1, 1),
                Schema(0, b"s", "jsonschema", "T"),
                Channel(0, "/x", encoding, {}, 0),
            )
        writer.add_metadata("late", {"end": "well"})
    recover(path, tmp_path / "b.mcap")
    contents = LogContents()
    found = [
        (channel.message_encoding, entry.data)
        for entry, _, channel in read_log(tmp_path / "b.mcap", contents)
    ]
    assert found == [("json", b"{}"), ("cbor", b"\xa0")]
    assert contents.metadata == {"run": {"scene": "flat"}, "acme": {"lot": "7"}, "late": {"end": "well"}}


def test_zeros_behind_the_end_are_damage_that_recover_mends(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("ab") as file:
        file.write(bytes(200_000))
    assert "behind its end" in summarize(tmp_path / "a.mcap").problems()[0]
    assert "behind its end" in overview(tmp_path / "a.mcap").damage[0]
    recover(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert summarize(tmp_path / "b.mcap").damage == []
    with AnyReader([tmp_path / "b.mcap"]) as reader:
        assert reader.message_count == 201


def test_an_overview_reads_no_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path / "log_0.mcap", 50_000)
    passed = summarize(tmp_path)
    chunks = []
    real = log_read.breakup_chunk
    monkeypatch.setattr(log_read, "breakup_chunk", lambda *a, **k: chunks.append(1) or real(*a, **k))
    assert sum(1 for _ in read_run(tmp_path)) == 50_001
    assert len(chunks) > 5
    chunks.clear()
    found = overview(tmp_path)
    assert len(chunks) == 1  # the facts stand before it
    assert {name: held.count for name, held in found.topics.items()} == {
        name: s.count for name, s in passed.topics.items()
    }
    assert found.seconds == pytest.approx(250.0)
    assert found.metadata == {"scene": "flat", "seed": "3"}
    assert found.damage == []
    began, whole = found.begin, (tmp_path / "log_0.mcap").read_bytes()
    (tmp_path / "log_0.mcap").write_bytes(whole[: len(whole) - 100])  # killed before it wrote its summary
    chunks.clear()
    found = overview(tmp_path, quick=True)
    assert len(chunks) == 2  # the facts, the first time
    assert (found.topics, found.damage) == (
        {},
        ["log_0.mcap has no index; `rbtrg-robot log recover` makes one"],
    )
    assert found.begin == began
