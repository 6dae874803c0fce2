"""What the independent ROS 2 client is given: its command line, and the message definitions that it must not fetch."""

from __future__ import annotations

import sys
from pathlib import Path

from rbtrg_robot import msg
from rbtrg_robot.wire.messages import definition
from tests.places import ROOT


def write_definitions(folder: Path) -> Path:
    """Our topics' types and what they are made of as .msg files below `folder`, which is returned."""
    for kind in vars(msg).values():
        if isinstance(kind, type) and issubclass(kind, msg.Message) and kind is not msg.Message:
            path = folder / f"{kind.__msgtype__}.msg"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(definition(kind.__msgtype__).split("=" * 80)[0])
    return folder


def client_command(port: str | int, definitions: Path, x: float, y: float) -> list[str]:
    """The client against the router on `port`; it sends a goal to x, y [m] in `map`."""
    program = str(ROOT / "tests/rbtrg_robot/wire/ros2_client.py")
    return [sys.executable, program, str(port), str(definitions), str(x), str(y)]
