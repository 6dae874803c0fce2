"""Lines on a terminal. All foreign text goes through here: of logs, missions, maps, goals, processes and other
computers.

A terminal obeys control characters: a mission's name could clear the screen, rename the window, or overwrite
`stopped`. They are written out (`\\x1b`) instead. Only the standard library is imported: `stop` prints through this
module, too."""

from __future__ import annotations

import json
import shutil
import sys
import unicodedata
from typing import Any

JOINERS = "\u200c\u200d"
"""Not printable to Python, but part of words in Persian, Hindi and others, and harmless."""
CLEAR_LINE = "\r\x1b[K"


def plain(text: str) -> str:
    """The text in one line without characters that move a cursor, change colours or turn the direction of words;
    letters of all languages stay."""
    if text.isprintable():
        return text
    return "".join(c if _harmless(c) else c.encode("unicode_escape").decode() for c in text)


def plain_all(value: Any) -> Any:
    """`plain` of every text in dicts and lists."""
    if isinstance(value, str):
        return plain(value)
    if isinstance(value, dict):
        return {plain_all(key): plain_all(part) for key, part in value.items()}
    return [plain_all(part) for part in value] if isinstance(value, list | tuple) else value


def say(line: str = "", *, error: bool = False) -> None:
    """Print one line, at once."""
    stream = sys.stderr if error else sys.stdout
    coding = getattr(stream, "encoding", None) or "utf-8"
    print(plain(line).encode(coding, "backslashreplace").decode(coding), file=stream, flush=True)


def say_text(text: str) -> None:
    """Print a text of our own that has several lines."""
    for line in text.removesuffix("\n").split("\n"):
        say(line)


def say_json(record: Any) -> None:
    """Print it as JSON, which has its own way to write control characters."""
    print(json.dumps(record, indent=1).replace("\x7f", "\\u007f"), flush=True)


def overwrite(line: str, *, error: bool = False) -> None:
    """Put a line in the place of the present one, cut to the width of the terminal."""
    shown = plain(line)[: shutil.get_terminal_size().columns - 1]
    print(CLEAR_LINE + shown, end="", file=sys.stderr if error else sys.stdout, flush=True)


def _harmless(character: str) -> bool:
    return character.isprintable() or character in JOINERS or unicodedata.category(character) == "Zs"
