"""Elevation maps in bags: of ROS 1 and 2, wherever their ring buffer begins, as files that `--map` reads."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from rbtrg_robot import msg
from rbtrg_robot.importer.grid_map import grid_in
from rbtrg_robot.log.read import LogError
from rbtrg_robot.wire.messages import STORE, encode, header
from tests.places import SHARED, needs_shared
from tests.rbtrg_robot.conftest import Here

MAP = msg.GridMap.__msgtype__
HEIGHT = np.arange(12, dtype=np.float32).reshape(3, 4)  # rows grow with y, columns with x


def message(start: tuple[int, int] = (0, 0), layer: str = "elevation") -> msg.GridMap:
    """As grid_map fills it: from the +x, +y corner, column by column, the first cell at `start` (x, y) of the ring."""
    ring = np.roll(HEIGHT[::-1, ::-1], (start[1], start[0]), axis=(0, 1))
    dim = [
        msg.MultiArrayDimension("column_index", 3, 12),
        msg.MultiArrayDimension("row_index", 4, 4),
    ]
    data = msg.Float32MultiArray(msg.MultiArrayLayout(dim), ring.reshape(-1))
    place = msg.Pose(msg.Point(1.0, 2.0, 0.0), msg.Quaternion(0.0, 0.0, 0.0, 1.0))
    info = msg.GridMapInfo(0.5, 2.0, 1.5, place)
    return msg.GridMap(header(1, "map"), info, [layer], [layer], [data], start[0], start[1])


def bag(path: Path, *maps: tuple[str, msg.GridMap]) -> Path:
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for k, (topic, one) in enumerate(maps):
            writer.write(writer.add_connection(topic, MAP, typestore=STORE), 1 + k, encode(one))
    return path


def test_a_map_is_read_wherever_its_ring_begins(tmp_path: Path) -> None:
    for name, start in (("a", (0, 0)), ("b", (1, 2)), ("c", (3, 1))):
        grid = grid_in(bag(tmp_path / name, ("/grid", message(start))))
        np.testing.assert_array_equal(grid.height, HEIGHT)
        assert (grid.origin, grid.resolution) == ((0.25, 1.5), 0.5)


def test_what_cannot_be_read_is_told_with_what_would_help(tmp_path: Path) -> None:
    two = bag(tmp_path / "two", ("/a", message()), ("/b", message()))
    with pytest.raises(LogError, match="say --topic /a or /b"):
        grid_in(two)
    assert grid_in(two, "/b").height.shape == (3, 4)
    with pytest.raises(LogError, match=r"on /c; it does on /a, /b"):
        grid_in(two, "/c")
    with pytest.raises(LogError, match="has no layer slope: say --layer elevation"):
        grid_in(two, "/a", "slope")
    turned = message()
    turned.info.pose.orientation.z = 0.5
    with pytest.raises(LogError, match="is turned in its frame"):
        grid_in(bag(tmp_path / "turned", ("/a", turned)))
    short = message()
    short.data[0].data = short.data[0].data[:7]
    with pytest.raises(LogError, match="is no array of 3 x 4 cells"):
        grid_in(bag(tmp_path / "short", ("/a", short)))


def test_a_map_in_a_bag_becomes_a_file(here: Here, tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", ("/grid", message()))
    done = here("map", "convert", str(folder), str(tmp_path / "m.npz"))
    assert done.returncode == 0, done.stderr
    assert "known cells" in done.stdout
    again = here("map", "convert", str(folder), str(tmp_path / "m.npz"))
    assert (again.returncode, "`--force` overwrites it" in again.stderr) == (1, True)
    wrong = here("map", "convert", str(folder), str(tmp_path / "m.jpg"))
    assert (wrong.returncode, "must end in .npz" in wrong.stderr) == (1, True)


@needs_shared
def test_a_bag_of_ros_1_is_read() -> None:
    grid = grid_in(SHARED / "data" / "files" / "grid_map.bag")
    assert (grid.shape, grid.resolution) == ((120, 40), 0.03)
    assert grid.origin == pytest.approx((-0.585, -1.785))
