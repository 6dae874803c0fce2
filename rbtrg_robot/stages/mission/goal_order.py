"""The goal that a mission wants the navigator to have, and no other one of a mission."""

from __future__ import annotations

from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.stages.mission.mission import OURS
from rbtrg_robot.stages.navigation.goal import GoalState
from rbtrg_robot.stages.navigation.path_order import REPEAT_AFTER
from rbtrg_robot.stages.stage import Outputs
from rbtrg_robot.wire.messages import header


def active(status: msg.GoalStatus | None) -> bool:
    """A goal is being worked on."""
    return status is not None and GoalState(status.state).active


class GoalOrder:
    """Sends the wanted goal until the navigator answers, and cancels what a mission left there."""

    def __init__(self) -> None:
        self._wanted: msg.GoalRequest | None = None
        self._sent: dict[str, int] = {}

    def want(self, request: msg.GoalRequest | None) -> None:
        """From now on; None: no goal."""
        self._wanted = request
        self._sent.clear()

    def orders(self, now: int, status: msg.GoalStatus | None, displaced: str = "") -> Outputs:
        """What to tell the navigator whose newest status this is; `now` in ns. `displaced`: id of a goal of somebody
        that a mission took the place of."""
        wanted = self._wanted.id if self._wanted else ""
        out: Outputs = []
        ours = status is not None and (status.id.startswith(OURS) or status.id == displaced)
        stray = status.id if status and active(status) and ours else ""
        if stray not in ("", wanted) and self._due(f"cancel {stray}", now):
            cancel = msg.GoalRequest(header=header(now, "map"), action=1, id=stray, owner="mission")
            out.append((t.GOAL_REQUEST, cancel))
        if self._wanted is not None and (status is None or status.id != wanted) and self._due(wanted, now):
            out.append((t.GOAL_REQUEST, self._wanted))
        return out

    def _due(self, what: str, now: int) -> bool:
        if 0 <= now - self._sent.get(what, -REPEAT_AFTER) < REPEAT_AFTER:
            return False
        self._sent[what] = now
        return True
