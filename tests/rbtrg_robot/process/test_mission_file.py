"""A mission outlives the stack, and is paused then."""

from __future__ import annotations

from pathlib import Path

import pytest

from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.process.mission_file import MissionFile
from rbtrg_robot.stages.mission.executor import MissionStage
from rbtrg_robot.wire.messages import decode, encode
from tests.rbtrg_robot.stages.mission.test_executor import goto, order, step


def test_a_mission_is_kept_while_it_is_under_way_and_comes_back_paused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    stage, file = MissionStage(), MissionFile("a")
    assert file.read() == {}
    given = order(goto(1.0), step("ask", text="?", choices=["yes"]), goto(2.0), start=2)
    stage.tick(10**9)
    kept = {}
    for outputs in (
        stage.on(t.MISSION_REQUEST, msg.MissionRequest(id="r", action="run", order=given)),
        stage.tick(2 * 10**9),
    ):
        kept |= {topic: encode(message) for topic, message in outputs}
    state = decode(kept[t.MISSION_STATE], msg.MissionState)
    assert (state.phase, state.question) == ("running", "?")
    file.write(kept, state)
    left = MissionFile("a").read()
    assert MissionFile("b").read() == {}
    again = MissionStage()
    for topic, payload in left.items():
        again.on(topic, decode(payload, topic.kind))
    ((_, told),) = again.tick(3 * 10**9)
    assert (told.phase, told.step, told.question) == ("paused", 2, "")
    assert "the stack was restarted" in told.reason
    assert told.action_status == ["WAITING", "PAUSED", "WAITING"]
    again.on(t.MISSION_REQUEST, msg.MissionRequest(id="s", action="resume"))
    assert dict(again.tick(4 * 10**9))[t.MISSION_STATE].question == "?"
    state.phase = "finished"
    file.write(kept, state)
    assert file.read() == {}


@pytest.mark.parametrize(
    "text", ["", "{}", "[]", '{"/mission/order": "AAEAAA==", "/mission/state": "AAEAAA=="}']
)
def test_a_broken_file_is_no_mission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    MissionFile("a")._path.write_text(text)
    assert MissionFile("a").read() == {}


def test_a_file_that_cannot_be_written_ends_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    file = MissionFile("a")
    newest = {topic: encode(topic.kind()) for topic in (t.MISSION_ORDER, t.MISSION_STATE)}
    (tmp_path / "rbtrg" / "a.mission-new").mkdir()
    for _ in range(3):
        file.write(newest, msg.MissionState(phase="running"))
    assert caplog.text.count("cannot be written") == 1
    file.write(newest, msg.MissionState(phase="a phase of nobody"))
    assert file.read() == {}
