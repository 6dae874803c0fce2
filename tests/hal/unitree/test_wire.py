"""Bytes of the Unitree topics against the DDS library's own coder, checksum against its definition."""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hal.types import NS, POINT_DTYPE, POINT_QUANTUM, TIME_QUANTUM
from hal.unitree import api, cloud, layout

idl = pytest.importorskip("hal.unitree.idl", reason="cyclonedds is not installed")


def _leaves(kind) -> list:
    """Every primitive annotation below an IDL type."""
    from cyclonedds.idl import IdlStruct
    from cyclonedds.idl.types import array, sequence

    if isinstance(kind, type) and issubclass(kind, IdlStruct):
        return [leaf for field in kind.__annotations__.values() for leaf in _leaves(field)]
    for mark in getattr(kind, "__metadata__", ()):
        if isinstance(mark, array | sequence):
            return _leaves(mark.subtype)
    return [kind]


@pytest.mark.parametrize("kind", idl.TOPIC_TYPES, ids=lambda k: k.__name__)
def test_no_octet_is_announced_in_a_way_that_kills_older_peers(kind):
    from cyclonedds.idl.types import int8, uint8

    leaves = _leaves(kind)
    assert len(leaves) >= 5
    assert all(leaf not in (uint8, int8) for leaf in leaves)


@pytest.mark.parametrize("kind", idl.TOPIC_TYPES, ids=lambda k: k.__name__)
def test_types_are_keyless_and_go_out_as_xcdr1(kind):
    kind.__idl__.populate()
    kind.__idl__.fill_type_data()
    assert kind.__idl__.keyless
    assert kind.__idl__.default_version == 1


@pytest.mark.parametrize(
    ("kind", "dtype", "size"),
    [
        ("LowState", layout.LOW_STATE_CDR, 1176),
        ("SportModeState", layout.SPORT_MODE_STATE_CDR, 512),
    ],
)
def test_views_read_what_the_library_reads(kind: str, dtype: np.dtype, size: int):
    assert dtype.itemsize == size
    body = np.random.default_rng(3).integers(0, 255, size, dtype=np.uint8).tobytes()
    data = layout.CDR_HEADER + body
    reference = getattr(idl, kind).__idl__.deserialize(data)
    record = layout.view(data, dtype)
    names = dtype.names or ()

    def field_of(name: str, index: int, field: str, ours):
        if field == "mode" and f"{name}_modes" in names:
            return ours[f"{name}_first_mode"] if index == 0 else ours[f"{name}_modes"]["mode"][index - 1]
        return ours[name][index][field]

    def same(theirs, ours) -> None:
        for name in type(theirs).__annotations__:
            value = getattr(theirs, name)
            value = list(value) if isinstance(value, bytes) else value
            if isinstance(value, list) and hasattr(value[0], "__dataclass_fields__"):
                pairs = [
                    (field_of(name, index, field, ours), getattr(item, field))
                    for index, item in enumerate(value)
                    for field in type(item).__annotations__
                ]
            elif hasattr(value, "__dataclass_fields__"):
                same(value, ours[name])
                continue
            else:
                pairs = [(ours[name], value)]
            for got, wanted in pairs:
                wanted = list(wanted) if isinstance(wanted, bytes) else wanted
                np.testing.assert_array_equal(got, np.array(wanted).astype(got.dtype), name)

    same(reference, record)


def test_a_short_or_foreign_message_is_refused():
    with pytest.raises(api.WireError, match="expected 1180"):
        layout.view(layout.CDR_HEADER + b"\0" * 100, layout.LOW_STATE_CDR)
    with pytest.raises(api.WireError):
        layout.view(b"\0\0\0\0" + b"\0" * 1176, layout.LOW_STATE_CDR)


def _crc_by_definition(words: list[int]) -> int:
    crc = 0xFFFFFFFF
    for word in words:
        for bit in range(31, -1, -1):
            top = (crc >> 31) & 1
            crc = (crc << 1) & 0xFFFFFFFF
            if top != (word >> bit) & 1:
                crc ^= 0x04C11DB7
    return crc


@given(st.lists(st.integers(0, 2**32 - 1), min_size=1, max_size=40))
def test_crc_equals_its_bitwise_definition(words: list[int]):
    assert layout.crc32(np.array(words, np.uint32)) == _crc_by_definition(words)


def test_crc_of_the_standard_check_string():
    # CRC-32/MPEG-2 of "123456789" is 0x0376E6E7; whole words only here, so the definition carries the tail.
    words = [int.from_bytes(b"1234", "big"), int.from_bytes(b"5678", "big")]
    crc = layout.crc32(np.array(words, np.uint32))
    for bit in range(7, -1, -1):
        top = (crc >> 31) & 1
        crc = (crc << 1) & 0xFFFFFFFF
        if top != (ord("9") >> bit) & 1:
            crc ^= 0x04C11DB7
    assert crc == 0x0376E6E7


C_LOW_STATE = "<4B4IH2x" + "13fB3x" + 20 * "B3x7fB3x3I" + "4BiH4B15H" + "8hI41B3xf2B2x2f4H2I"
"""LowState as the robot's C compiler lays it out, which the checksum is taken over."""


def _flat(value: Any) -> list:
    """The numbers of an IDL object in order."""
    if hasattr(value, "__dataclass_fields__"):
        return [n for name in type(value).__annotations__ for n in _flat(getattr(value, name))]
    if isinstance(value, list | tuple | bytes):
        return [n for item in value for n in _flat(item)]
    return [value]


def test_the_checksum_of_low_state_is_that_of_its_c_struct():
    assert struct.calcsize(C_LOW_STATE) == layout.LOW_STATE_C.itemsize == 1180
    rng = np.random.default_rng(5)
    for _ in range(5):
        # No byte of 0x7f or 0xff: a NaN need not survive the conversion to double and back.
        data = layout.CDR_HEADER + rng.integers(0, 0x7F, 1176, dtype=np.uint8).tobytes()
        packed = struct.pack(C_LOW_STATE, *_flat(idl.LowState.__idl__.deserialize(data)))
        words = np.frombuffer(packed, "<u4")[:-1]
        assert layout.low_state_checksum(data) == _crc_by_definition(words.tolist())


@given(
    st.integers(0, 2**62),
    st.integers(0, 9999),
    st.text(max_size=60).filter(lambda s: "\0" not in s),
    st.booleans(),
)
@settings(max_examples=60)
def test_requests_and_responses_are_what_the_library_writes(
    identity: int, number: int, text: str, flag: bool
):
    request = api.Request(identity, number, text, flag)
    theirs = idl.RequestMessage.__idl__.deserialize(request.pack())
    assert (theirs.header.identity.id, theirs.header.identity.api_id) == (identity, number)
    assert (theirs.header.policy.noreply, theirs.parameter, list(theirs.binary)) == (flag, text, [])
    assert api.Request.unpack(idl.RequestMessage.__idl__.serialize(theirs)) == request
    response = api.Response(identity, number, -number, text)
    answer = idl.ResponseMessage.__idl__.deserialize(response.pack())
    assert (answer.header.status.code, answer.data) == (-number, text)
    assert api.Response.unpack(idl.ResponseMessage.__idl__.serialize(answer)) == response


@given(st.binary(max_size=200))
@settings(max_examples=200)
def test_noise_on_the_wire_is_an_error_not_a_crash(data: bytes):
    for reader in (
        api.Request.unpack,
        api.Response.unpack,
        cloud.decode_cloud,
        cloud.decode_imu,
        lambda d: layout.view(d, layout.LOW_STATE_CDR),
    ):
        try:
            reader(data)
        except api.WireError:
            continue


@given(st.integers(0, 400))
def test_a_cut_cloud_is_an_error_not_a_crash(size: int):
    data = cloud.encode_cloud(NS, "lidar", np.zeros(8, POINT_DTYPE))
    if size < len(data) - 1:
        with pytest.raises(api.WireError):
            cloud.decode_cloud(data[:size])


# --- clouds -------------------------------------------------------------------------------------------------------

L1_DTYPE = np.dtype(
    {
        "names": ["x", "y", "z", "intensity", "ring", "time"],
        "formats": ["<f4", "<f4", "<f4", "<f4", "<u2", "<f4"],
        "offsets": [0, 4, 8, 16, 20, 24],
        "itemsize": 32,
    }
)
XT16_DTYPE = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"), ("timestamp", "<f8")]
)
LIVOX_DTYPE = np.dtype(
    [
        ("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"),
        ("tag", "u1"), ("line", "u1"), ("timestamp", "<f8"),
    ]
)  # fmt: skip
OPEN = cloud.Limits()


def _filled(dtype: np.dtype, n: int = 500) -> np.ndarray:
    rng = np.random.default_rng(1)
    points = np.zeros(n, dtype)
    for axis in "xyz":
        points[axis] = rng.uniform(1.0, 5.0, n)
    points["intensity"] = rng.uniform(0, 255, n)
    return points


def test_the_library_reads_our_clouds():
    points = _filled(L1_DTYPE)
    theirs = idl.PointCloud2.__idl__.deserialize(cloud.encode_cloud(5 * NS + 7, "utlidar_lidar", points))
    assert (theirs.header.stamp.sec, theirs.header.stamp.nanosec) == (5, 7)
    assert theirs.header.frame_id == "utlidar_lidar"
    assert (theirs.height, theirs.width, theirs.point_step) == (1, 500, 32)
    assert [(f.name, f.offset, f.datatype) for f in theirs.fields][3:] == [
        ("intensity", 16, 7),
        ("ring", 20, 4),
        ("time", 24, 7),
    ]
    assert bytes(theirs.data) == points.tobytes()


def test_relative_times_count_from_the_header_stamp():
    points = _filled(L1_DTYPE)
    points["time"] = np.linspace(0.0, 0.1, 500)
    start, out, _ = cloud.sweep(cloud.decode_cloud(cloud.encode_cloud(9 * NS, "l", points)), OPEN)
    assert start == 9 * NS
    assert out.dtype == POINT_DTYPE
    for name in POINT_DTYPE.names or ():
        step = {"x": POINT_QUANTUM, "y": POINT_QUANTUM, "z": POINT_QUANTUM, "time": TIME_QUANTUM}.get(name)
        want = points[name] if step is None else np.round(points[name] / step) * step
        np.testing.assert_array_equal(out[name], want)


@pytest.mark.parametrize(("dtype", "scale"), [(XT16_DTYPE, 1.0), (LIVOX_DTYPE, 1e9)])
def test_absolute_times_give_the_start_of_the_sweep(dtype: np.dtype, scale: float):
    points = _filled(dtype)
    points["timestamp"] = (1_700_000_000.25 + np.linspace(0.0, 0.1, 500)) * scale
    start, out, _ = cloud.sweep(cloud.decode_cloud(cloud.encode_cloud(1_700_000_001 * NS, "l", points)), OPEN)
    assert start == pytest.approx(1_700_000_000.25 * NS, abs=1000)
    assert out["time"][0] == 0.0
    assert out["time"][-1] == pytest.approx(0.1, abs=TIME_QUANTUM)


@pytest.mark.parametrize("boot", [0.3, 5.0, 900.0, 5000.0, 200_000.0])
def test_nanoseconds_of_a_clock_that_booted_in_1970_are_no_seconds(boot: float):
    points = _filled(LIVOX_DTYPE)
    points["timestamp"] = (boot + np.linspace(0.0, 0.1, 500)) * 1e9
    start, out, _ = cloud.sweep(
        cloud.decode_cloud(cloud.encode_cloud(round((boot + 0.1) * NS), "l", points)), OPEN
    )
    assert start == pytest.approx(boot * NS, abs=1000)
    assert out["time"][-1] == pytest.approx(0.1, abs=TIME_QUANTUM)


def test_relative_nanoseconds_count_from_the_header_stamp():
    points = _filled(LIVOX_DTYPE)
    points["timestamp"] = np.linspace(0.0, 1e8, 500)
    start, out, _ = cloud.sweep(cloud.decode_cloud(cloud.encode_cloud(9 * NS, "l", points)), OPEN)
    assert start == 9 * NS
    assert out["time"][-1] == pytest.approx(0.1, abs=TIME_QUANTUM)


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf, 1e300, 20.0, 1_700_000_020.0])
@pytest.mark.parametrize(("dtype", "name"), [(XT16_DTYPE, "timestamp"), (POINT_DTYPE, "time")])
@pytest.mark.filterwarnings("ignore:overflow")
def test_one_wrong_time_costs_its_point_and_many_are_told(dtype: np.dtype, name: str, wrong: float):
    points = _filled(dtype)
    times = np.linspace(0.0, 0.1, 500) + (1_700_000_000.25 if name == "timestamp" else 0.0)
    points[name] = times
    points[name][7] = wrong
    start, out, _ = cloud.sweep(cloud.decode_cloud(cloud.encode_cloud(9 * NS, "l", points)), OPEN)
    assert len(out) == 499
    assert start / NS == pytest.approx(1_700_000_000.25 if name == "timestamp" else 9.0, abs=1e-5)
    assert out["time"].max() == pytest.approx(0.1, abs=TIME_QUANTUM)
    points[name][::5] = wrong
    if np.isfinite(points[name][0]):
        with pytest.raises(api.WireError, match=f"point field '{name}' holds"):
            cloud.sweep(cloud.decode_cloud(cloud.encode_cloud(9 * NS, "l", points)), OPEN)
    points[name] = math.nan
    with pytest.raises(api.WireError, match=f"point field '{name}' holds no number"):
        cloud.sweep(cloud.decode_cloud(cloud.encode_cloud(9 * NS, "l", points)), OPEN)


@pytest.mark.parametrize("miss", [0.0, math.nan])
@pytest.mark.parametrize("dtype", [XT16_DTYPE, LIVOX_DTYPE])
def test_times_of_points_that_hit_nothing_do_not_count(dtype: np.dtype, miss: float):
    points = _filled(dtype)
    points["timestamp"] = (1_700_000_000.25 + np.linspace(0.0, 0.1, 500)) * (
        1.0 if dtype == XT16_DTYPE else 1e9
    )
    for axis in "xyz":
        points[axis][50:400] = miss
    points["timestamp"][50:400] = miss
    start, out, _ = cloud.sweep(cloud.decode_cloud(cloud.encode_cloud(0, "l", points)), OPEN)
    assert len(out) == 150
    assert start == pytest.approx(1_700_000_000.25 * NS, abs=1000)
    assert out["time"][-1] == pytest.approx(0.1, abs=TIME_QUANTUM)


_UNITS = [("<f8", 1.0), ("<f8", 1e-3), ("<f8", 1e-6), ("<f8", 1e-9), ("<f4", 1e-6)]
_FIELDS = [
    *((kind, unit, begin) for kind, unit in _UNITS for begin in (-0.1, 0.0, 1_700_000_000.25)
    if kind != "<f4" or begin < 1.0),
    ("<u4", 1e-6, 0.0), ("<u4", 1e-6, 44.0), ("<u4", 1e-9, 0.0), ("<u4", 1e-9, 1.5), ("<i4", 1e-6, -0.1),
    ("<f8", 1e-6, 44.0),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "unit", "begin"), _FIELDS)
def test_the_unit_of_a_time_field_is_recognised_by_its_spread(kind: str, unit: float, begin: float):
    layout_ = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("t", kind)])
    points = np.zeros(400, layout_)
    points["x"], points["t"] = 3.0, (begin + np.linspace(0.0, 0.1, 400)) / unit
    header = round((begin + 0.1) * NS) if begin > 1.0 else 50 * NS
    start, out, found = cloud.sweep(cloud.decode_cloud(cloud.encode_cloud(header, "l", points)), OPEN)
    assert found == unit
    want = header + begin * NS if begin <= 0.0 else begin * NS
    assert start == pytest.approx(want, abs=2000)
    np.testing.assert_allclose(out["time"], np.linspace(0.0, 0.1, 400), atol=2 * TIME_QUANTUM)


def test_a_doubled_field_name_is_an_error_not_a_crash():
    data = cloud.encode_cloud(0, "l", _filled(XT16_DTYPE))
    with pytest.raises(api.WireError, match="comes twice"):
        cloud.decode_cloud(data.replace(b"\x02\0\0\0y\0", b"\x02\0\0\0x\0"))


def test_invalid_near_and_far_returns_are_dropped():
    points = np.zeros(4, POINT_DTYPE)
    points["x"] = (2.0, math.nan, 0.05, 40.0)
    _, out, _ = cloud.sweep(cloud.decode_cloud(cloud.encode_cloud(0, "l", points)), cloud.Limits(0.1, 30.0))
    assert out["x"].tolist() == [2.0]


def test_clouds_without_coordinates_or_of_another_byte_order_are_refused():
    only_z = np.zeros(3, np.dtype([("z", "<f4")]))
    with pytest.raises(api.WireError, match="no x, y, z"):
        cloud.decode_cloud(cloud.encode_cloud(0, "l", only_z))


def test_l1_imu_quaternion_order_is_put_right():
    raw = cloud.RawImu(3 * NS + 5, np.array([0.1, 0.2, 0.3, 0.4]), np.arange(3.0), np.arange(3.0) + 9)
    theirs = idl.Imu.__idl__.deserialize(cloud.encode_imu(raw, "utlidar_imu", wxyz=True))
    # The real L1: w sits where the message says x.
    assert (theirs.orientation.x, theirs.orientation.w) == (0.1, 0.4)
    for order in (True, False):
        back = cloud.decode_imu(cloud.encode_imu(raw, "utlidar_imu", order), order)
        np.testing.assert_array_equal(back.quaternion, raw.quaternion)
        np.testing.assert_array_equal(back.gyro, raw.gyro)
        np.testing.assert_array_equal(back.accel, raw.accel)
        assert back.stamp == raw.stamp


@pytest.mark.parametrize("data", ["{", 5000 * "1", 10**5 * "[", "[]"], ids=len)
def test_an_answer_that_holds_no_object_is_refused_in_words(data: str) -> None:
    with pytest.raises(api.WireError, match="answer"):
        api.Response(1, 1, 0, data).json()
