"""What of a text of others reaches a terminal."""

from __future__ import annotations

import io
import sys

import pytest

from rbtrg_robot.process.notify import Notifier
from rbtrg_robot.terminal import overwrite, plain, plain_all, say, say_json, say_text

CONTROL = [chr(c) for c in (*range(0x20), *range(0x7F, 0xA0))]
BIDI = list("\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
OTHERS = ["\u2028", "\u2029", "\ufeff", "\ud800", "\U000e0041"]


@pytest.mark.parametrize("character", CONTROL + BIDI + OTHERS)
def test_what_steers_a_terminal_is_written_out(character: str) -> None:
    shown = plain(f"a{character}b")
    assert shown.isprintable()
    assert shown[:2] == "a\\"
    assert shown[-1] == "b"


@pytest.mark.parametrize(
    "text",
    ["Größe 5 µm", "Πλατεία", "площадь", "広場　北", "ساحة", "می\u200cخواهم", "🤖 ready", "a\u00a0b", "é"],
)
def test_letters_of_all_languages_stay(text: str) -> None:
    assert plain(text) == text


def test_a_line_stays_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    say("goal a\nrbtrg-robot: stopped")
    say_text("one\ntwo\x85\x1b[2J\n")
    say_json({"name": "\x1b]0;x\x07\x9b\x7f\u202e"})
    overwrite("\x1b[2Jmoving")
    said = capsys.readouterr().out
    lines = said.split("\n")
    assert lines[:3] == ["goal a\\nrbtrg-robot: stopped", "one", "two\\x85\\x1b[2J"]
    assert said.count("\x1b") == 1  # that of `overwrite` itself
    assert '"\\u001b]0;x\\u0007\\u009b\\u007f\\u202e"' in said


def test_keys_and_values_of_a_record_are_cleaned() -> None:
    assert plain_all({"a\x1b": ["\x07", 1, None, {"b": ("\x9b",)}]}) == {
        "a\\x1b": ["\\x07", 1, None, {"b": ["\\x9b"]}]
    }


def test_a_terminal_without_the_letters_shows_their_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.TextIOWrapper(io.BytesIO(), "ascii")
    monkeypatch.setattr(sys, "stdout", stream)
    say("площадь")
    assert stream.buffer.getvalue().startswith(b"\\u043f")  # type: ignore[attr-defined]


def test_no_word_of_the_robot_is_a_message_to_the_service_manager(monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[str] = []
    monkeypatch.setattr(Notifier, "_send", lambda _self, text: sent.append(text))
    Notifier({}).status("robot ready\nSTOPPING=1")
    assert sent == ["STATUS=robot ready\\nSTOPPING=1"]
