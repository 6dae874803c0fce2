"""The newest mission of a robot on the disk: it outlives the stack, and goes on only when told to."""

from __future__ import annotations

import base64
import json
import logging
from collections.abc import Mapping

from rbtrg_robot import topics as t
from rbtrg_robot.msg import MissionState
from rbtrg_robot.run_folder import run_dir
from rbtrg_robot.stages.mission.mission import Phase, Status
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.messages import MessageError, decode, encode

log = logging.getLogger(__name__)
TOPICS: tuple[Topic, ...] = (t.MISSION_ORDER, t.MISSION_STATE)
ACTIVE = tuple(phase.value for phase in Phase if phase.active)
PAUSED = (
    "the stack was restarted: see that the robot is where the map says; `rbtrg-robot mission resume` goes on"
)


class MissionFile:
    """One file per robot name in the run folder, while a mission is under way."""

    def __init__(self, robot: str) -> None:
        self._path = run_dir() / f"{robot}.mission"
        self._trouble: str | None = None
        """Why the file could not be written last."""

    def read(self) -> dict[Topic, bytes]:
        """Order and state on the wire, paused; empty where no mission was under way. A broken file counts as none."""
        try:
            content = json.loads(self._path.read_text())
            found = {topic: base64.b64decode(content[topic.name]) for topic in TOPICS}
            decode(found[t.MISSION_ORDER], t.MISSION_ORDER.kind)
            return found | {t.MISSION_STATE: encode(_paused(decode(found[t.MISSION_STATE], MissionState)))}
        except FileNotFoundError:
            return {}
        except (OSError, ValueError, KeyError, TypeError, MessageError) as error:
            log.warning("%s is broken (%s); the mission of before is lost", self._path, error)
            return {}

    def write(self, newest: Mapping[Topic, bytes], state: MissionState) -> None:
        """What a later stack needs; `newest` payloads of TOPICS, the state decoded. A full disk ends nothing."""
        try:
            if state.phase not in ACTIVE or any(topic not in newest for topic in TOPICS):
                self._path.unlink(missing_ok=True)
                return
            content = {topic.name: base64.b64encode(newest[topic]).decode() for topic in TOPICS}
            fresh = self._path.with_suffix(".mission-new")
            fresh.write_text(json.dumps(content))
            fresh.replace(self._path)
        except OSError as error:
            if error.strerror != self._trouble:
                log.warning(
                    "%s cannot be written (%s): a restarted stack forgets the mission", self._path, error
                )
            self._trouble = error.strerror


def _paused(state: MissionState) -> MissionState:
    state.phase, state.reason, state.goal_id, state.question = Phase.PAUSED.value, PAUSED, "", ""
    state.choices = []
    state.action_status = [
        Status.PAUSED.value if status == Status.RUNNING else status for status in state.action_status
    ]
    return state
