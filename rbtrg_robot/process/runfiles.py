"""Files of a running stack: one lock and one state file per robot name."""

from __future__ import annotations

import contextlib
import fcntl
import json
import logging
import os
import socket
import time
from pathlib import Path
from typing import Any

from hal.errors import OperatorError
from rbtrg_robot.run_folder import run_dir

log = logging.getLogger(__name__)

CONSOLE_ENTER = "/enter"
LOOKING_TIME = 0.2
"""Longest time [s] for which the lock may be held by processes that only look."""


class AlreadyRunning(OperatorError):
    """A stack for this robot name is up."""

    def __init__(self, robot: str, pid: int) -> None:
        self.pid = pid
        super().__init__(
            f"a stack for robot {robot!r} is already running with pid {pid}; "
            "stop it with `rbtrg-robot down` or choose another --robot"
        )


class RobotTaken(OperatorError):
    """Another stack drives the robot behind the same interface, or has its name on the same router."""


class NotRunning(OperatorError):
    """No stack for this robot name is up."""


class NoRoom(OperatorError):
    """The run folder takes no file."""


class RunLock:
    """Held by `up` while it lives; the system releases it however `up` ends."""

    def __init__(self, robot: str) -> None:
        """Raises AlreadyRunning, NoRoom."""
        self._state = run_dir() / f"{robot}.json"
        self._console = console_file(robot)
        self._file = (run_dir() / f"{robot}.lock").open("a+")  # kept open: closing it gives the lock away
        patience = time.monotonic() + LOOKING_TIME
        while not self._taken():
            # `read_state` of somebody who only looks holds it for microseconds.
            if time.monotonic() > patience:
                self._file.seek(0)
                pid = int(self._file.read() or 0)
                self._file.close()
                raise AlreadyRunning(robot, pid)
            time.sleep(0.01)
        self._console.unlink(missing_ok=True)  # of a stack that was killed: its cookies end with it
        self._file.truncate(0)
        try:
            os.write(self._file.fileno(), str(os.getpid()).encode())
        except OSError as error:
            self._file.close()
            raise NoRoom(
                f"cannot write {self._file.name}: {error.strerror}; make room, or set XDG_RUNTIME_DIR to another folder"
            ) from error

    def _taken(self) -> bool:
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

    def write_state(self, **state: Any) -> None:
        """Replace the state file. A full disk ends no stack; `stop` finds it at the default port all the same."""
        fresh = self._state.with_suffix(".tmp")
        try:
            fresh.write_text(json.dumps({"pid": os.getpid(), **state}))
            fresh.replace(self._state)
        except OSError as error:
            log.warning("%s cannot be written (%s)", self._state, error.strerror)

    def release(self) -> None:
        """Remove the state file, and with the console's secret its cookies; give the lock away."""
        self._state.unlink(missing_ok=True)
        self._console.unlink(missing_ok=True)
        self._file.truncate(0)
        self._file.close()


def state_of(pid: int) -> dict[str, Any]:
    """State of the running stack whose `up` is process `pid`, whatever its robot is called. Raises NotRunning."""
    for file in run_dir().glob("*.json"):
        with contextlib.suppress(NotRunning):
            state = read_state(file.stem)
            if state["pid"] == pid:
                return state
    raise NotRunning(f"no stack of process {pid} is running")


def running() -> list[str]:
    """Names of the robots whose stacks are up on this computer, in order."""
    found = []
    for file in sorted(run_dir().glob("*.json")):
        with contextlib.suppress(NotRunning):
            read_state(file.stem)
            found.append(file.stem)
    return found


def take_interface(interface: str, domain: int) -> socket.socket:
    """Hold a robot's network interface, or what else leads to it, for this process: two stacks would command one robot.
    Raises RobotTaken.

    An abstract socket is one for all users of the computer, and the system frees it however its owner ends. `domain`:
    of DDS."""
    held = socket.socket(socket.AF_UNIX)
    try:
        held.bind(f"\0rbtrg-robot-{interface}-{domain}")
    except OSError as error:
        held.close()
        raise RobotTaken(
            f"another stack on this computer drives the robot on {interface!r}; stop it with `rbtrg-robot down`"
        ) from error
    return held


def read_state(robot: str) -> dict[str, Any]:
    """State of the running stack. Raises NotRunning."""
    lock = run_dir() / f"{robot}.lock"
    state = run_dir() / f"{robot}.json"
    try:
        with lock.open() as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        try:
            content: dict[str, Any] = json.loads(state.read_text())
            return content
        except (OSError, json.JSONDecodeError) as error:
            raise NotRunning(f"the stack for robot {robot!r} is just starting; try again") from error
    except OSError:
        pass
    raise NotRunning(f"no stack for robot {robot!r} is running; start it with `rbtrg-robot up`")


def console_file(robot: str) -> Path:
    """Where the console of a robot leaves its address and its tokens, for the user who runs `up` alone."""
    return run_dir() / f"{robot}.console"


def console_address(robot: str, role: str = "operator", *, token: bool = True) -> str:
    """The address for a browser, used once; without the token, the address that `rbtrg-robot console` opens. Empty if
    there is none."""
    try:
        found: dict[str, str] = json.loads(console_file(robot).read_text())
        enter = f"{CONSOLE_ENTER}?token={found[role]}"
        return found["address"] + (enter if token else " (`rbtrg-robot console` lets a browser in)")
    except (OSError, KeyError, json.JSONDecodeError):
        return ""
