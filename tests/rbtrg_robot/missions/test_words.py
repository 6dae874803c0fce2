"""A mission in words."""

from __future__ import annotations

from typing import Any

import pytest

from rbtrg_robot import msg
from rbtrg_robot.missions.file import describe
from rbtrg_robot.missions.words import lines


def state(**fields: Any) -> msg.MissionState:
    ids = ["goto-1", "wait-2"]
    lists: dict[str, Any] = {"action_id": ids, "action_type": ids, "action_status": ["FINISHED", "RUNNING"]}
    return msg.MissionState(
        order_id="o", name="round", phase="running", **lists, result_description=["", ""], **fields
    )


def test_the_step_and_its_reason_are_told() -> None:
    assert (
        lines(state(step=2, reason="it waits"))[0] == "mission round running, step 2 of 2 (wait-2): it waits"
    )
    assert lines(state(step=2))[1:] == [
        "   1 goto-1               FINISHED",
        "   2 wait-2               RUNNING",
    ]
    assert lines(msg.MissionState()) == ["no mission"]


@pytest.mark.parametrize("step", [0, 3, 65535])
def test_a_step_that_the_mission_does_not_have_is_told_without_a_name(step: int) -> None:
    assert lines(state(step=step))[0] == f"mission round running, step {step} of 2"


@pytest.mark.parametrize(
    ("kind", "words"), [("wait", "wait 2.5 s"), ("sit", "sit"), ("go\x00", "go\x00"), ("", "")]
)
def test_a_step_is_told_by_its_kind_whatever_that_is(kind: str, words: str) -> None:
    assert describe(msg.MissionStep(kind=kind, duration=2.5)) == words
