"""Who has the say over the motion."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from hal.safety.mux import TELEOP, TRACKER, CommandMux
from hal.types import NS

MS = NS // 1000


def test_the_higher_source_has_the_say_while_it_speaks_and_keeps_the_motion_until_it_is_released() -> None:
    mux = CommandMux(TRACKER, TELEOP)
    assert mux.take(TRACKER, "a", 0) == ""
    assert mux.taken(0) == ("", False)
    assert mux.take(TELEOP, "b", 10 * MS) == ""
    assert mux.taken(10 * MS) == ("teleop", True)
    assert mux.take(TRACKER, "a", 20 * MS) == "teleop has the say"
    assert mux.taken(220 * MS) == ("teleop", False)
    assert mux.take(TRACKER, "a", 220 * MS) == "teleop took the motion"
    assert mux.release(230 * MS)
    assert mux.take(TRACKER, "a", 240 * MS) == ""


def test_nothing_is_released_while_somebody_drives() -> None:
    mux = CommandMux(TRACKER, TELEOP)
    mux.take(TELEOP, "b", 0)
    assert not mux.release(100 * MS)
    assert mux.take(TRACKER, "a", 300 * MS) == "teleop took the motion"


def test_a_source_has_one_owner_at_a_time() -> None:
    mux = CommandMux(TRACKER, TELEOP)
    for source in (TRACKER, TELEOP):
        assert mux.take(source, "a", 0) == ""
        assert mux.take(source, "b", 100 * MS) == f"another {source.name} has the say"
        mux.take(source, "a", 150 * MS)
        assert mux.take(source, "b", 340 * MS) == f"another {source.name} has the say"
        mux.take(source, "b", 350 * MS)
        mux = CommandMux(TRACKER, TELEOP)


def test_the_one_who_is_refused_does_not_keep_the_source_alive() -> None:
    mux = CommandMux(TRACKER, TELEOP)
    mux.take(TELEOP, "a", 0)
    for ms in range(20, 200, 20):
        assert mux.take(TELEOP, "b", ms * MS) != ""
    assert mux.take(TELEOP, "b", 200 * MS) == ""


def test_what_was_taken_before_a_restart_stays_taken() -> None:
    mux = CommandMux(TRACKER, TELEOP)
    mux.hold(TELEOP)
    assert mux.taken(0) == ("teleop", False)
    assert mux.take(TRACKER, "a", 0) == "teleop took the motion"


def test_a_source_has_an_owner_on_each_channel() -> None:
    mux = CommandMux(TRACKER, TELEOP)
    assert mux.take(TELEOP, "a", 0) == ""
    assert mux.take(TELEOP, "b", 0, "trunk") == "", "publishers are told apart by topic"
    assert mux.take(TELEOP, "c", 100 * MS, "trunk") == "another teleop has the say"
    assert mux.take(TELEOP, "b", 150 * MS, "trunk") == ""
    assert mux.take(TELEOP, "c", 200 * MS) == "", "the velocity's owner fell silent"
    assert not mux.release(340 * MS), "one of the channels still speaks"


@given(st.lists(st.tuples(st.sampled_from([TRACKER, TELEOP]), st.sampled_from("ab"), st.integers(0, 150))))
@settings(max_examples=300, deadline=None)
def test_at_no_time_two_have_the_say(steps: list[tuple]) -> None:
    mux, now = CommandMux(TRACKER, TELEOP), 0
    said: list[tuple[int, str, str]] = []
    for source, owner, wait in steps:
        now += wait * MS
        if mux.take(source, owner, now) == "":
            recent = [(name, who) for at, name, who in said if now - at < 200 * MS]
            assert all(who == owner for name, who in recent if name == source.name)
            assert source is TELEOP or not any(name == "teleop" for name, _ in recent)
            assert source is TELEOP or not any(name == "teleop" for _, name, _ in said)
            said.append((now, source.name, owner))
