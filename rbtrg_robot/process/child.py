"""What runs in every process that the supervisor starts."""

from __future__ import annotations

import base64
import faulthandler
import importlib
import logging
import signal
import sys
import threading
from typing import Any

FATAL = 78
"""Exit status for what a restart cannot mend (EX_CONFIG)."""


def run(spec: dict[str, Any]) -> int:
    """One process until told to stop; returns its exit status.

    `spec`: `process` its name, `config` the dumped StackConfig, `restored` {topic: base64 of its newest message}.
    """
    name: str = spec["process"]
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    faulthandler.enable()
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(name)s %(levelname)s %(message)s")

    from rbtrg_robot.config import StackConfig
    from rbtrg_robot.hosts.live import Node
    from rbtrg_robot.process.errors import OPERATOR_ERRORS, describe
    from rbtrg_robot.processes import BY_NAME
    from rbtrg_robot.topics import BY_NAME as TOPIC_BY_NAME
    from rbtrg_robot.wire.bus import Bus, BusError

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
