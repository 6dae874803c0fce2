"""Packed sweeps: the same bytes come back, whatever was packed, and nothing damaged gets through as a sweep."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hal.lidar.spec import LIDARS
from hal.types import POINT_DTYPE, POINT_QUANTUM, TIME_QUANTUM, LidarScan
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.importer.bag import Bag, Decoder
from rbtrg_robot.log import packed
from rbtrg_robot.log.packed import COLUMNS, VERBATIM, PackedError, pack, unpack
from rbtrg_robot.log.read import LogContents, read_log
from rbtrg_robot.log.stats import summarize
from rbtrg_robot.log.write import LogWriter, recover
from rbtrg_robot.wire.convert import cloud_msg, scan_msg
from rbtrg_robot.wire.messages import MessageError, decode, encode

ODD = [
    0.0,
    -0.0,
    np.nan,
    np.inf,
    -np.inf,
    1e-40,
    -1e-40,
    1e30,
    POINT_QUANTUM,
    0.1,
    2.0**29,
    2.0**21,
    -(2.0**21),
]
"""Values that are no multiples, that no column holds, or that lie at its ends."""


def sweep(seed: int, count: int = 4000) -> NDArray[np.void]:
    """Points on the walls of a room of 8 x 8 m, as an XT16 orders, rounds and scatters them."""
    rng = np.random.default_rng(seed)
    pattern = LIDARS["xt16"].decimated(8).pattern(0)
    directions = pattern.directions[:count].astype(np.float64)
    distance = 4.0 / np.abs(directions[:, :2]).max(axis=1) + rng.normal(0.0, 0.01, len(directions))
    points = np.zeros(len(directions), POINT_DTYPE)
    for k, name in enumerate("xyz"):
        points[name] = np.rint(directions[:, k] * distance / POINT_QUANTUM) * POINT_QUANTUM
    points["intensity"] = rng.integers(60, 70, len(points))
    points["ring"] = pattern.ring[:count]
    points["time"] = np.rint(pattern.time[:count] * 1e-9 / TIME_QUANTUM) * TIME_QUANTUM
    return points


def test_a_packed_sweep_of_a_bag_is_read_as_a_sweep(tmp_path: Path) -> None:
    payload = wire(sweep(0))
    with LogWriter(tmp_path / "log.mcap", {}, pack_sweeps=True) as writer:
        writer.write(t.POINTS, payload, 1, 1)
    ((source, _, _, data),) = Bag(tmp_path / "log.mcap").messages()
    assert len(data) < len(payload) / 2
    found = Decoder().decode(source, data)
    assert found.data.tobytes() == decode(payload, msg.PointCloud2).data.tobytes()


def wire(points: NDArray[np.void]) -> bytes:
    return encode(scan_msg(LidarScan(5, points)))


def form(payload: bytes) -> str:
    return decode(payload, msg.CompressedPointCloud2).format


def test_a_sweep_takes_a_fifth_and_comes_back_to_the_bit() -> None:
    payload = wire(sweep(1))
    small = pack(payload)
    assert form(small) == COLUMNS
    assert len(small) < 0.2 * len(payload)
    assert unpack(small) == payload


@settings(max_examples=30, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.lists(
        st.tuples(
            st.sampled_from(["x", "y", "z", "intensity", "time"]),
            st.integers(0, 99),
            st.sampled_from(ODD) | st.floats(width=32),
        ),
        max_size=20,
    ),
    st.integers(0, 100),
)
def test_any_values_come_back_to_the_bit(seed: int, odd: list[tuple[str, int, float]], count: int) -> None:
    points = sweep(seed, 100)[:count].copy()
    for name, place, value in odd:
        if place < count:
            points[name][place] = value
    if seed % 2:
        points["ring"] = np.random.default_rng(seed).integers(0, 2**16, count)
    payload = wire(points)
    small = pack(payload)
    assert form(small) == COLUMNS
    assert unpack(small) == payload


@settings(max_examples=30, deadline=None)
@given(st.binary(max_size=200) | st.sampled_from([encode(cloud_msg(5, "a", np.ones((3, 3), np.float32)))]))
def test_what_is_no_sweep_comes_back_as_it_is(payload: bytes) -> None:
    small = pack(payload)
    assert form(small) == VERBATIM
    assert unpack(small) == payload


def test_a_message_that_lies_about_its_points_comes_back_as_it_is() -> None:
    cloud = scan_msg(LidarScan(5, sweep(2, 50)))
    cloud.width = 40
    payload = encode(cloud)
    assert form(pack(payload)) == VERBATIM
    assert unpack(pack(payload)) == payload


@settings(max_examples=80, deadline=None)
@given(st.data())
def test_damage_is_told_and_never_costs_memory(data: st.DataObject) -> None:
    small = bytearray(pack(wire(sweep(3, 60))))
    for _ in range(data.draw(st.integers(1, 4))):
        small[data.draw(st.integers(0, len(small) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(len(small) - 30, len(small)))
    try:
        payload = unpack(bytes(small[:cut]))
    except (PackedError, MessageError):
        return
    assert len(payload) < 1_000_000  # as many points as the message names, and only so many


def test_a_column_that_claims_more_than_its_points_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    cloud = decode(pack(wire(sweep(4, 50))), msg.CompressedPointCloud2)
    cloud.width = 49
    with pytest.raises(PackedError, match="larger than its points"):
        unpack(encode(cloud))
    cloud.width = packed.MOST_POINTS + 1
    with pytest.raises(PackedError, match="sweep of"):
        unpack(encode(cloud))


def test_every_reader_of_a_log_gets_the_sweep_and_a_copy_keeps_it_packed(tmp_path: Path) -> None:
    sweeps = [wire(sweep(seed)) for seed in range(3)]
    small, large = tmp_path / "small.mcap", tmp_path / "large.mcap"
    for path in (small, large):
        with LogWriter(path, {}, pack_sweeps=path is small) as writer:
            for stamp, payload in enumerate(sweeps, start=1):
                writer.write(t.POINTS, payload, stamp, stamp, stamp)
                writer.write(t.CLOUD, payload, stamp, stamp, stamp)
    entries = [entry for entry, _, _ in read_log(small)]
    assert entries == [entry for entry, _, _ in read_log(large)]
    assert {entry.type for entry in entries} == {t.POINTS.type}
    assert summarize(small).problems() == []
    recover(small, tmp_path / "mended.mcap")
    assert [entry for entry, _, _ in read_log(tmp_path / "mended.mcap")] == entries
    assert (tmp_path / "mended.mcap").stat().st_size < 1.1 * small.stat().st_size


def test_a_damaged_sweep_is_damage_of_the_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "log.mcap"
    with LogWriter(path, {}, pack_sweeps=True) as writer:
        writer.write(t.POINTS, wire(sweep(5)), 1, 1, 1)
        monkeypatch.setattr("rbtrg_robot.log.write.pack", lambda payload: pack(payload)[:-200])
        writer.write(t.POINTS, wire(sweep(6)), 2, 2, 2)
    contents = LogContents()
    assert len(list(read_log(path, contents))) == 1
    assert "after 1 messages" in contents.damage
