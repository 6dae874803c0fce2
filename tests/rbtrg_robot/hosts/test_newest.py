"""What the lockstep host keeps of each topic, and where its time goes."""

import pytest

from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.hosts.lockstep import Newest
from rbtrg_robot.wire.messages import encode


def test_the_newest_message_of_each_topic_is_kept() -> None:
    newest = Newest()
    assert newest.get(t.GOAL_STATUS) is None
    newest.put(t.GOAL_STATUS, encode(msg.GoalStatus(state="moving")))
    first = newest[t.GOAL_STATUS]
    assert first.state == "moving"
    assert newest[t.GOAL_STATUS] is first
    newest.put(t.GOAL_STATUS, encode(msg.GoalStatus(state="reached")))
    assert newest[t.GOAL_STATUS].state == "reached"
    assert list(newest) == [t.GOAL_STATUS]
    with pytest.raises(KeyError):
        newest[t.PLAN]
