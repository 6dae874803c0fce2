"""Entry of every process the supervisor spawns: `python -m rbtrg_robot.child`, its specification on stdin."""

from __future__ import annotations

import base64
import ctypes
import faulthandler
import importlib
import json
import logging
import os
import signal
import sys
import threading
from typing import Any

FATAL = 78
"""Exit status for what a restart cannot mend (EX_CONFIG)."""
PR_SET_PDEATHSIG = 1


def die_with_parent(sign: signal.Signals, parent: int) -> None:
    """Have the system send `sign` to this process when its parent ends, however it ends."""
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, sign)
    if os.getppid() != parent:  # it ended before the line above
        sys.exit(0)


def main() -> int:
    """Run one process until told to stop."""
    spec: dict[str, Any] = json.loads(sys.stdin.read())
    name: str = spec["process"]
    # These two end in order (stop the robot, index the log); the others have nothing to lose.
    graceful = name in ("robot", "recorder")
    die_with_parent(signal.SIGTERM if graceful else signal.SIGKILL, spec["parent"])
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    faulthandler.enable()
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(name)s %(levelname)s %(message)s")

    from rbtrg_robot.bus import Bus, BusError
    from rbtrg_robot.config import StackConfig
    from rbtrg_robot.errors import OPERATOR_ERRORS
    from rbtrg_robot.node import Node, describe
    from rbtrg_robot.processes import BY_NAME
    from rbtrg_robot.topics import BY_NAME as TOPIC_BY_NAME

    row = BY_NAME[name]
    restored = {TOPIC_BY_NAME[k]: base64.b64decode(v) for k, v in spec["restored"].items()}
    try:
        config = StackConfig.model_validate(spec["config"])
        module, function = row.entry.split(":")
        entry = getattr(importlib.import_module(module), function)
        if not row.hosted:
            with Bus(config.endpoint, name, config.domain) as bus:
                entry(config, bus, stop.is_set, restored)
            return 0
        stage = entry(config)
        stage.warm_up()
        with Bus(config.endpoint, name, config.domain) as bus:
            node = Node(row, stage, bus, simulated=config.simulated)
            node.restore(restored)
            try:
                node.run(stop.is_set)
            finally:
                stage.close()
    except BusError as error:
        print(f"bus: {describe(error)}", file=sys.stderr, flush=True)
        return 1
    except OPERATOR_ERRORS as error:
        print(f"fatal: {describe(error)}", file=sys.stderr, flush=True)
        return FATAL
    return 0


if __name__ == "__main__":
    sys.exit(main())
