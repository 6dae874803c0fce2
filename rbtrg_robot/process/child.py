"""The program of every process that the supervisor starts."""

from __future__ import annotations

import base64
import faulthandler
import importlib
import logging
import os
import signal
import threading
from typing import Any

from rbtrg_robot.terminal import plain, say

FATAL = 78
"""Exit status for what a restart cannot mend (EX_CONFIG in sysexits.h)."""
PASSING = 75
"""Exit status for what may be gone at the next start (EX_TEMPFAIL)."""


class _Formatter(logging.Formatter):
    """Words that came over the bus stand in these lines, and people read them in a terminal."""

    def formatMessage(self, record: logging.LogRecord) -> str:
        return plain(super().formatMessage(record))


def run(spec: dict[str, Any]) -> int:
    """One process until told to stop; returns its exit status.

    `spec`: `process` its name, `config` the dumped StackConfig, `clock` the offset of the stack's SourceClock, `stack`
    its id on the bus, `restored` {topic: base64 of its newest message}, `hurry` whether the first goal matters most.
    """
    name: str = spec["process"]
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    faulthandler.enable()
    handler = logging.StreamHandler()
    handler.setFormatter(_Formatter("%(asctime)s %(name)s %(levelname)s %(message)s"))
    logging.basicConfig(level=logging.INFO, handlers=[handler])

    from hal.errors import OperatorError, one_line
    from rbtrg_robot.config import load
    from rbtrg_robot.hosts.live import Node
    from rbtrg_robot.hosts.memory import keep_what_is_loaded, seldom_collecting
    from rbtrg_robot.process.kernels import REST, compile_rest
    from rbtrg_robot.processes import BY_NAME
    from rbtrg_robot.stages.stage import WarmsLater
    from rbtrg_robot.topics import BY_NAME as TOPIC_BY_NAME
    from rbtrg_robot.wire.bus import Bus
    from rbtrg_robot.wire.clock import SourceClock

    ours: dict[str, Any] = {"clock": SourceClock(spec["clock"]), "stack": spec["stack"]}
    restored = {TOPIC_BY_NAME[k]: base64.b64decode(v) for k, v in spec["restored"].items()}
    try:
        config = load(base=spec["config"])
        if name == REST:
            compile_rest(config)
            return 0
        row, ours["absent"] = BY_NAME[name], config.absent
        os.nice(row.nice)
        module, function = row.entry.split(":")
        part = importlib.import_module(module)
        entry = getattr(part, function)
        if not row.hosted:
            with Bus(config.endpoint, name, config.scope, **ours) as bus:
                entry(config, bus, stop.is_set, restored)
            return 0
        again = getattr(part, "build_again", entry) if restored else entry
        stage = again(config)
        with seldom_collecting():
            stage.warm_up()
            if isinstance(stage, WarmsLater) and not spec["hurry"]:
                stage.warm_up_rest()
        keep_what_is_loaded()
        with Bus(config.endpoint, name, config.scope, **ours) as bus:
            node = Node(row, stage, bus, simulated=config.simulated, folder=config.log_dir)
            node.restore(restored)
            try:
                node.run(stop.is_set)
            finally:
                stage.close()
    except OperatorError as error:
        say(f"error: {one_line(error)}", error=True)
        return PASSING if error.retry else FATAL
    return 0
