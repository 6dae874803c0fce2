"""A command's connection to the stack: that of this computer, or the one that RBTRG_CONNECT names."""

from __future__ import annotations

from typing import Any

from rbtrg_robot.access.identity import NAME, client_tls, problem, remote
from rbtrg_robot.process.runfiles import read_state
from rbtrg_robot.scope import Scope
from rbtrg_robot.wire.bus import Bus, BusError
from rbtrg_robot.wire.session import Security


def connect(robot: str) -> Bus:
    """Open the bus of a robot. Raises NotRunning, BusError."""
    far = remote()
    if far is None:
        state = read_state(robot)
        return Bus(state["endpoint"], "cli", Scope.of(int(state["domain"]), robot))
    wrong = problem(far.folder)
    if wrong:
        raise BusError(f"{wrong}; set {NAME} to your name or to the folder of your certificate")
    return Bus(far.endpoint, "cli", Scope.of(far.domain, robot), security=Security(client_tls(far.folder)))


def scene(robot: str) -> tuple[str, dict[str, Any]]:
    """The scene that the stack of this computer simulates, and its options; empty if there is none. Raises
    NotRunning."""
    if remote() is not None:
        return "", {}
    state: dict[str, Any] = read_state(robot)
    return (
        (str(state["scene"]), dict(state.get("scene_options") or {}))
        if state["backend"] == "sim"
        else ("", {})
    )


def see_also() -> str:
    """Where to look when a command is not answered."""
    role = " and whether your certificate is an operator's" if remote() is not None else ""
    return f"see `rbtrg-robot status`{role}"
