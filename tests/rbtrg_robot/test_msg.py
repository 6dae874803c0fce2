"""The dataclasses of the messages are those of the .msg files, and mypy knows what each topic carries."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from mypy import api

from rbtrg_robot import msg
from rbtrg_robot.topics import TOPICS
from rbtrg_robot.wire.messages import decode, encode
from tests.places import ROOT
from tools.messages import OUT, source

SNIPPET = """
from typing import Any
from rbtrg_robot import msg, topics as t
from rbtrg_robot.stages.stage import Outputs

def on(topic: t.Topic, message: Any) -> Outputs:
    if t.ODOM.carried(message, topic):
        message.pose.pose.position.x
        message.pose.position.x  # wrong
        message.poze  # wrong
    elif t.ROBOT_STATE.carried(message, topic):
        message.phase.upper()
        message.phase + 1  # wrong
        return [(t.ODOM, "text")]  # wrong
    return [(t.ODOM, msg.Odometry(child_frame_id="base_link"))]

def publish(topic: t.Topic[t.M], message: t.M) -> None: ...

publish(t.ODOM, msg.Odometry())
publish(t.ODOM, msg.Imu())  # wrong
msg.GoalRequest(name="platform")
msg.GoalRequest(nmae="platform")  # wrong
t.GOAL_REQUEST.kind(x="far")  # wrong
"""


def test_mypy_sees_what_a_topic_carries(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    snippet = tmp_path / "snippet.py"
    snippet.write_text(SNIPPET)
    out, err, _ = api.run([str(snippet), "--config-file", str(ROOT / "pyproject.toml")])
    found = {int(line) for line in re.findall(r"snippet\.py:(\d+): error", out)}
    wrong = {number for number, line in enumerate(SNIPPET.splitlines(), 1) if "# wrong" in line}
    assert found == wrong, out + err


def test_the_dataclasses_are_written_from_the_definitions() -> None:
    assert OUT.read_text() == source(), "run python -m tools.messages"


def test_what_is_decoded_is_of_the_topics_class() -> None:
    for topic in TOPICS:
        assert type(decode(encode(topic.kind()), topic.kind)) is topic.kind


def test_messages_share_no_default() -> None:
    one, other = msg.RobotState(), msg.RobotState()
    one.contact[0] = True
    one.header.stamp.sec = 7
    one.refused_reason.append("late")
    assert not other.contact.any()
    assert (other.header.stamp.sec, other.refused_reason) == (0, [])
