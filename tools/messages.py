"""Writes `rbtrg_robot/msg.py`, one dataclass per message type, from the .msg definitions.

`python -m tools.messages` after a .msg file changed or a topic got a new standard type; a test compares the two.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys.base import normalize_fieldname

from rbtrg_robot.wire.messages import OURS, STORE

STANDARD = (
    "diagnostic_msgs/msg/DiagnosticArray",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TwistStamped",
    "nav_msgs/msg/OccupancyGrid",
    "nav_msgs/msg/Odometry",
    "nav_msgs/msg/Path",
    "rosgraph_msgs/msg/Clock",
    "sensor_msgs/msg/CameraInfo",
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/PointCloud2",
    "std_msgs/msg/String",
    "tf2_msgs/msg/TFMessage",
)
"""Types of ROS that our topics carry; what they are made of follows."""
OUT = Path(__file__).parent.parent / "rbtrg_robot" / "msg.py"

_HEAD = '''"""The messages as dataclasses. Fields that are not given get ROS defaults: zero, empty.

Written by `python -m tools.messages` from the .msg definitions, which also tell the units: change those, not this file.
Arrays of a decoded message are views on its bytes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class Message:
    """What every message is."""

    __slots__ = ()
    __msgtype__: ClassVar[str]


def _zeros(dtype: str, length: int) -> Any:
    import numpy as np  # late: the topics are listed without it

    return np.zeros(length, dtype)
'''
_PYTHON = {
    "bool": ("bool", "False"),
    "string": ("str", '""'),
    "float32": ("float", "0.0"),
    "float64": ("float", "0.0"),
}
_NUMPY = {"octet": "uint8", "byte": "uint8", "char": "uint8"}


def source() -> str:
    """Text of the module, formatted."""
    fields: Any = STORE.fielddefs
    ordered: dict[str, None] = {}

    def add(typename: str) -> None:
        for _, description in fields[typename][1]:
            for nested in _nested(description):
                add(nested)
        ordered.setdefault(typename)

    for typename in sorted({*STANDARD, *OURS}):
        add(typename)
    raw = "\n\n".join([_HEAD, *(_class(typename, *fields[typename]) for typename in ordered)])
    ruff = [sys.executable, "-m", "ruff", "format", "--stdin-filename", str(OUT), "-"]
    return subprocess.run(ruff, input=raw, capture_output=True, text=True, check=True).stdout


def _nested(description: Any) -> Iterator[str]:
    kind, detail = description
    if kind == Nodetype.NAME:
        yield detail
    elif kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        yield from _nested(detail[0])


def _class(typename: str, constants: list[Any], fields: list[Any]) -> str:
    name = _name(typename)
    lines = [
        "@dataclass(slots=True, eq=False)",
        f"class {name}(Message):",
        f'    """{typename}."""',
        "",
        f'    __msgtype__ = "{typename}"',
    ]
    lines += [
        f"    {constant}: ClassVar[{_PYTHON.get(kind, ('int', ''))[0]}] = {value!r}"
        for constant, kind, value in constants
    ]
    lines += [f"    {normalize_fieldname(field)}: {_annotation(d)} = {_default(d)}" for field, d in fields]
    return "\n".join(lines) + "\n"


def _name(typename: str) -> str:
    return typename.rsplit("/", 1)[1]


def _annotation(description: Any) -> str:
    kind, detail = description
    if kind == Nodetype.BASE:
        return _PYTHON.get(detail[0], ("int", ""))[0]
    if kind == Nodetype.NAME:
        return _name(detail)
    (element, inner), _ = detail
    if element == Nodetype.BASE and inner[0] != "string":
        dtype = _NUMPY.get(inner[0], inner[0])
        return f"NDArray[np.{'bool_' if dtype == 'bool' else dtype}]"
    return f"list[{_annotation((element, inner))}]"


def _default(description: Any) -> str:
    kind, detail = description
    if kind == Nodetype.BASE:
        return _PYTHON.get(detail[0], ("int", "0"))[1]
    if kind == Nodetype.NAME:
        return f"field(default_factory={_name(detail)})"
    (element, inner), length = detail
    count = length if kind == Nodetype.ARRAY else 0
    if element == Nodetype.BASE and inner[0] != "string":
        return f'field(default_factory=lambda: _zeros("{_NUMPY.get(inner[0], inner[0])}", {count}))'
    if not count:
        return "field(default_factory=list)"
    blank = '""' if element == Nodetype.BASE else f"{_name(inner)}()"
    return f"field(default_factory=lambda: [{blank} for _ in range({count})])"


if __name__ == "__main__":
    OUT.write_text(source())
    print(f"written: {OUT}")
