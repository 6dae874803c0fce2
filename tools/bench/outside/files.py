"""Files of others, made up: each format and each defect that was called broken once, and logs with what others put into
them."""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Channel, Schema
from PIL import Image, TiffImagePlugin
from rosbags.highlevel import AnyReader

from hal.scenes import load_scene
from hal.scenes.readers import read_geometry
from mapping.grid import ElevationGrid
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.hosts.plan import MapPlanner
from rbtrg_robot.importer.grid_map import grid_in
from rbtrg_robot.log.bag import describe
from rbtrg_robot.log.read import Entry, LogContents, read_log
from rbtrg_robot.log.replay import Controls, alone, play
from rbtrg_robot.log.summary import overview
from rbtrg_robot.log.write import LogWriter, recover
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.convert import patch_msg
from rbtrg_robot.wire.messages import encode

Check = Callable[[Path], bool]


def points(count: int = 20_000) -> np.ndarray:
    """(n, 3) of 8 x 6 m of gentle ground [m]."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 8, count), rng.uniform(0, 6, count)
    return np.column_stack([x, y, 0.05 * np.sin(x)])


def _pcd(path: Path, cloud: np.ndarray, data: str) -> Path:
    head = (
        f"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {len(cloud)}\nHEIGHT 1\n"
        f"POINTS {len(cloud)}\nDATA {data}\n"
    )
    body = cloud.astype("<f4").tobytes()
    if data == "ascii":
        body = "\n".join(" ".join(f"{v:.4f}" for v in row) for row in cloud).encode()
    elif data == "binary_compressed":  # literal runs of LZF, column by column
        plain = cloud.astype("<f4").T.tobytes()
        packed = b"".join(
            bytes([len(plain[k : k + 32]) - 1]) + plain[k : k + 32] for k in range(0, len(plain), 32)
        )
        body = np.array([len(packed), len(plain)], "<u4").tobytes() + packed
    path.write_bytes(head.encode() + body)
    return path


def _is_ground(path: Path, **options: Any) -> bool:
    """It lies in the right place, at the right size."""
    scene = load_scene(path, **options)
    x0, y0, x1, y1 = scene.extent
    return abs(x1 - x0 - 8.0) < 0.3 and abs(y1 - y0 - 6.0) < 0.3 and float(np.ptp(scene.height)) < 0.2


def _ply(folder: Path) -> bool:
    head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float X\nproperty float Y\nproperty float Z\n"
    text = f"{head}property list uchar int near\nend_header\n0 0 0 2 7 8\n1 0 0 0\n0 1 0 1 3\n"
    (folder / "a.ply").write_text(text)
    return bool(read_geometry(folder / "a.ply").vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]])


def _obj(folder: Path) -> bool:
    (folder / "a.obj").write_text("v 0 0 0\nv 1 \\\n0 0\nv 0 1 0\nf 1 2 \\\n 3\n")
    geometry = read_geometry(folder / "a.obj")
    return (len(geometry.vertices), len(geometry.triangles)) == (3, 1)


def _stl(folder: Path) -> bool:
    one = np.zeros(1, [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    one["corners"][0] = [[0, 0, 0], [4, 0, 0], [0, 3, 0]]
    (folder / "a.stl").write_bytes(bytes(80) + np.array([1], "<u4").tobytes() + one.tobytes())
    return len(read_geometry(folder / "a.stl").triangles) == 1


def _las(folder: Path, name: str) -> bool:
    import laspy

    cloud = points() + np.array([500_000.0, 5_400_000.0, 100.0])
    las = laspy.create(point_format=0, file_version="1.2")
    las.header.scales, las.header.offsets = np.array([0.001] * 3), cloud.min(axis=0)
    las.x, las.y, las.z = cloud.T
    las.write(folder / name)
    return _is_ground(folder / name)


def _heights() -> np.ndarray:
    """(30, 40) of 0.2 m; five rows that the model has none of."""
    height = np.zeros((30, 40), np.float32)
    height[:5] = -9999.0
    return height


def _holed(path: Path, **options: Any) -> bool:
    scene = load_scene(path, **options)
    return scene.survey is not None and int(np.isnan(scene.survey).sum()) == 200 and not scene.height.any()


def _tif(folder: Path) -> bool:
    import tifffile

    tags = [(33550, "d", 3, (0.2, 0.2, 0.0), True), (33922, "d", 6, (0, 0, 0, 100.0, 50.0, 0.0), True)]
    tifffile.imwrite(folder / "a.tif", _heights(), extratags=tags)
    return _holed(folder / "a.tif")


def _packed_tif(folder: Path, packing: str, predictor: int) -> bool:
    """As GDAL packs its elevation models."""
    about = TiffImagePlugin.ImageFileDirectory_v2()
    for tag, values in ((33550, (0.2, 0.2, 0.0)), (33922, (0.0, 0.0, 0.0, 100.0, 50.0, 0.0))):
        about[tag], about.tagtype[tag] = values, 12
    about[317] = predictor
    path = folder / f"{packing}_{predictor}.tif"
    Image.fromarray(_heights()).save(path, compression=packing, tiffinfo=about)
    return _holed(path)


def _npy(folder: Path) -> bool:
    np.save(folder / "a.npy", _heights())
    return _holed(folder / "a.npy", resolution=0.2)


def _grid_map(folder: Path) -> bool:
    from mapping.elevation.exchange import PATCH_LAYERS, MapPatch

    height = np.arange(12, dtype=np.float32).reshape(3, 4)
    patch = MapPatch((0.2, 0.4), 0.2, 1, 0, dict.fromkeys(PATCH_LAYERS, height))
    with LogWriter(folder / "grid.mcap", {}) as writer:
        writer.write(t.MAP_FULL, encode(patch_msg(patch)), 1, 1)
    found = grid_in(folder / "grid.mcap")
    return bool((found.height == height).all()) and np.allclose(found.origin, (0.2, 0.4))


def _array(_folder: Path) -> bool:
    """A plan on a numpy array."""
    grid = ElevationGrid(np.zeros((80, 120), np.float32), np.ones((80, 120), np.bool_), (0.0, 0.0), 0.05)
    return MapPlanner(grid).plan((1.0, 2.0), (5.0, 2.0)).ok


def _foreign_cloud(folder: Path) -> bool:
    """A cloud that another program packed hides nothing behind it."""
    packed = encode(msg.CompressedPointCloud2(format="draco", compressed_data=np.arange(9, dtype=np.uint8)))
    kind = msg.CompressedPointCloud2.__msgtype__
    path = folder / "draco.mcap"
    with LogWriter(path, {}) as writer:
        writer.copy(
            Entry("/c", kind, packed, 1, 1, 1),
            Schema(0, b"", "ros2msg", kind),
            Channel(0, "/c", "cdr", {}, 0),
        )
        writer.write(t.HEARTBEAT, encode(msg.Heartbeat()), 2, 2)
    contents = LogContents()
    data = [entry.data for entry, *_ in read_log(path, contents)]
    return len(data) == 2 and data[0] == packed and not contents.damage


def _channels(folder: Path) -> bool:
    """`log recover` keeps two channels of one topic, and what others wrote about the run."""
    with LogWriter(folder / "two.mcap", {}) as writer:
        writer.add_metadata("acme", {"lot": "7"})
        for encoding in ("json", "cbor"):
            writer.copy(
                Entry("/x", "T", b"{}", 1, 1, 1),
                Schema(0, b"s", "jsonschema", "T"),
                Channel(0, "/x", encoding, {}, 0),
            )
    recover(folder / "two.mcap", folder / "two_again.mcap")
    contents = LogContents()
    found = [channel.message_encoding for *_, channel in read_log(folder / "two_again.mcap", contents)]
    return found == ["json", "cbor"] and contents.metadata.get("acme") == {"lot": "7"}


def _zeros(folder: Path) -> bool:
    """200 kB of zeros behind the end are told, and mended."""
    path = folder / "zeros.mcap"
    with LogWriter(path, {}) as writer:
        writer.write(t.HEARTBEAT, encode(msg.Heartbeat()), 2, 2)
    with path.open("ab") as file:
        file.write(bytes(200_000))
    told = "behind its end" in overview(path).damage[0]
    recover(path, folder / "zeros_again.mcap")
    return told and not overview(folder / "zeros_again.mcap").damage


def _rolled(folder: Path) -> bool:
    """Stamps that roll over are not waited for."""
    path = folder / "rolled.mcap"
    with LogWriter(path, {}) as writer:
        for log_time in (10**9, 2**64 - 1, 10**9 + 1):
            writer.write(t.ODOM, encode(msg.Odometry()), log_time, 1, 1)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    with Bus(endpoint, "replay", router=True) as bus:
        report = play(bus, path, controls=Controls(), check=alone(bus), patterns=["*"])
    return report.messages == 3 and report.seconds < 1.0 and len(report.jumps) == 2


def _huge(folder: Path) -> bool:
    """What 9 GB hold is told from their summary: between its head and its end the file is a hole, which nobody can read
    as messages."""
    path, hole = folder / "huge.mcap", 9_000_000_000
    with LogWriter(path, {"scene": "flat"}) as writer:
        for stamp in range(1, 101):
            writer.write(t.HEARTBEAT, encode(msg.Heartbeat()), stamp, stamp)
    data = path.read_bytes()
    start, offsets, crc = struct.unpack("<QQI", data[-28:-8])
    with path.open("r+b") as file:
        file.truncate(start)
        file.seek(start + hole)
        file.write(data[start:-28] + struct.pack("<QQI", start + hole, offsets + hole, crc) + data[-8:])
    begin = time.process_time()
    found = overview(path)
    return (
        found.topics[t.HEARTBEAT.name].count == 100
        and found.size > hole
        and not found.damage
        and time.process_time() - begin < 1.0
    )


def _run_is_a_bag(folder: Path) -> bool:
    """rosbags opens the folder of a run as it is."""
    run = folder / "run"
    with LogWriter(run / "log_0.mcap", {}) as writer:
        for topic, message in ((t.DESCRIPTION, msg.String(data="<robot/>")), (t.IMU, msg.Imu())):
            writer.write(topic, encode(message), 1, 1)
    describe(run)
    with AnyReader([run]) as reader:
        return {t.DESCRIPTION.name, t.IMU.name} == set(reader.topics)


CASES: dict[str, Check] = {
    **{f"pcd_{d}": lambda f, d=d: _is_ground(_pcd(f / f"{d}.pcd", points(), d))  # type: ignore[misc]
    for d in ("ascii", "binary", "binary_compressed")},
    "pcd_millimetres": lambda f: _is_ground(_pcd(f / "mm.pcd", 1000.0 * points(), "binary")),
    "pcd_y_up": lambda f: _is_ground(_pcd(f / "y.pcd", points()[:, [0, 2, 1]] * (1, 1, -1), "binary")),
    "pcd_sparse": lambda f: _is_ground(_pcd(f / "sparse.pcd", points(4000), "binary")),
    "pcd_units_told": lambda f: _is_ground(_pcd(f / "cm.pcd", 100.0 * points(), "binary"), units="cm"),
    "ply_lists_and_capitals": _ply,
    "obj_continued_lines": _obj,
    "stl": _stl,
    "las": lambda f: _las(f, "a.las"),
    "laz": lambda f: _las(f, "a.laz"),
    "geotiff_nodata": _tif,
    "geotiff_lzw": lambda f: _packed_tif(f, "tiff_lzw", 2),
    "geotiff_deflate_of_floats": lambda f: _packed_tif(f, "tiff_adobe_deflate", 3),
    "npy_nodata": _npy,
    "grid_map_in_a_bag": _grid_map,
    "numpy_array_planned_on": _array,
}  # fmt: skip
LOGS: dict[str, Check] = {
    "foreign_compressed_cloud": _foreign_cloud,
    "two_channels_of_a_topic": _channels,
    "zeros_behind_the_end": _zeros,
    "stamps_that_roll_over": _rolled,
    "run_is_a_rosbag2": _run_is_a_bag,
    "nine_gigabytes_by_their_summary": _huge,
}
