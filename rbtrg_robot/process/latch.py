"""The newest latched state of a robot on the disk: an emergency stop outlives the stack that was told of it."""

from __future__ import annotations

import logging

from rbtrg_robot.msg import RobotState
from rbtrg_robot.run_folder import run_dir
from rbtrg_robot.wire.messages import MessageError, decode, encode

log = logging.getLogger(__name__)


class LatchFile:
    """One file per robot name in the run folder."""

    def __init__(self, robot: str) -> None:
        self._path = run_dir() / f"{robot}.estop"
        self._latched = False
        self._trouble: str | None = None
        """Why the file could not be written last."""

    def read(self) -> bytes:
        """A RobotState with a latched stop, on the wire; empty when nothing is latched. A broken file counts as
        latched."""
        try:
            payload = self._path.read_bytes()
        except FileNotFoundError:
            return b""
        try:
            if decode(payload, RobotState).estop:
                return payload
        except MessageError:
            log.warning("%s is broken; the emergency stop is taken as latched", self._path)
        return encode(RobotState(estop=True, estop_cause="latched before this start"))

    def follow(self, state: bytes, *, latched: bool) -> None:
        """Write at every change, and again while a write fails: a full disk ends nothing. `state`: the newest
        RobotState on the wire."""
        if latched == self._latched:
            return
        try:
            if latched:
                fresh = self._path.with_suffix(".new")
                fresh.write_bytes(state)
                fresh.replace(self._path)
            else:
                self._path.unlink(missing_ok=True)
        except OSError as error:
            if error.strerror != self._trouble:
                log.warning(
                    "%s cannot be written (%s): a restarted stack forgets the stop", self._path, error
                )
            self._trouble = error.strerror
            return
        self._latched, self._trouble = latched, None
