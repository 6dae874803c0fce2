"""Every robot of this user on this computer."""

from __future__ import annotations

import json
from typing import Any

from rbtrg_robot.process.runfiles import NotRunning, read_state, running
from rbtrg_robot.scope import Scope
from rbtrg_robot.wire.bus import Bus, BusError


def statuses() -> dict[str, dict[str, Any] | None]:
    """What each stack's supervisor answers to `status`, by name; None where it does not. Blocks up to 2 s a robot."""
    found: dict[str, dict[str, Any] | None] = {}
    for name in running():
        try:
            state = read_state(name)
            with Bus(state["endpoint"], "cli", Scope.of(int(state["domain"]), name)) as bus:
                answer = bus.ask("status")
            found[name] = None if answer is None else json.loads(answer)
        except NotRunning:  # it ended meanwhile
            continue
        except BusError:
            found[name] = None
    return found
