"""Messages made wrong: bytes that are flipped, cut, doubled; fields whose values no sane publisher sends."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any

import numpy as np

from rbtrg_robot.msg import Message
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.messages import MessageError, decode, encode

ODD_FLOATS = (math.nan, math.inf, -math.inf, 0.0, -0.0, 1e-310, 1e38, -1e38, 5e6, -5e6, 1e9, -1.0, 1.0, 0.04)
ODD_STAMPS = (0, -(2**31), 2**31 - 1, 1, 1_700_000_000)
ODD_WORDS = (
    "",
    "map",
    "odom",
    "base_link",
    "nowhere",
    "\x00",
    "resume",
    "stop",
    "cancel",
    "x" * 5000,
    "\u00e9" * 40,
)


class Mutator:
    """A seeded stream of messages that began as `samples`, payloads by topic."""

    def __init__(self, seed: int, samples: dict[Topic, list[bytes]]) -> None:
        self._rng = np.random.default_rng(seed)
        self._samples = samples

    @staticmethod
    def blank(topic: Topic) -> bytes:
        """A message with nothing in it."""
        return encode(topic.kind())

    def draw(self, inputs: tuple[Topic, ...], sound: float) -> tuple[Topic, bytes]:
        """A topic of `inputs` and a payload for it; a share of `sound` as it was recorded."""
        rng = self._rng
        topic = inputs[rng.integers(len(inputs))]
        kept = self._samples[topic]
        payload = kept[rng.integers(len(kept))]
        dice = rng.random()
        if dice < sound:
            return topic, payload
        if dice < 0.5 + sound / 2:
            return topic, self._bytes(payload)
        return topic, self._fields(topic, payload)

    def _bytes(self, payload: bytes) -> bytes:
        rng = self._rng
        broken = bytearray(payload)
        for _ in range(rng.integers(1, 4)):
            kind = rng.integers(5)
            at = int(rng.integers(len(broken) + 1))
            if kind == 0:
                del broken[at:]
            elif kind == 1:
                broken[at:at] = rng.bytes(int(rng.integers(1, 64)))
            elif kind == 2:
                broken[at:] = broken[: len(broken) - at]
            elif kind == 3 and len(broken) >= at + 8:  # a length, a size, a number
                width = int(rng.choice([1, 2, 4, 8]))
                broken[at : at + width] = int(rng.choice([0, 1, 255])).to_bytes(1, "little") * width
            else:
                for place in rng.integers(0, max(len(broken), 1), min(8, len(broken))):
                    broken[place] = rng.integers(256)
        return bytes(broken)

    def _fields(self, topic: Topic, payload: bytes) -> bytes:
        try:
            message = decode(payload, topic.kind)
        except MessageError:
            return payload
        for _ in range(self._rng.integers(1, 5)):
            self._spoil(message)
        try:
            return encode(message)
        except Exception:  # noqa: BLE001 - what cannot be sent does not arrive
            return payload

    def _spoil(self, message: Any) -> None:
        """One field somewhere below `message`."""
        rng = self._rng
        names = [f.name for f in fields(message)]
        if not names:
            return
        name = names[rng.integers(len(names))]
        setattr(message, name, self._other(getattr(message, name), name))

    def _other(self, value: Any, name: str) -> Any:
        rng = self._rng
        if isinstance(value, Message):
            self._spoil(value)
            return value
        if isinstance(value, bool):
            return not value
        if isinstance(value, int):
            if name == "sec":
                return int(rng.choice(ODD_STAMPS))
            return int(rng.choice([0, 1, 2, 7, 127, 255, 65535, 2**31 - 1, max(value - 1, 0), value + 1]))
        if isinstance(value, float):
            return float(rng.choice(ODD_FLOATS))
        if isinstance(value, str):
            return str(rng.choice(ODD_WORDS)) if rng.random() < 0.7 else value + "x"
        if isinstance(value, np.ndarray):
            return self._array(value)
        if isinstance(value, list):
            return self._list(value, name)
        return value

    def _array(self, value: Any) -> Any:
        rng = self._rng
        kind = rng.integers(4)
        if kind == 0 or value.size == 0:
            return value[: rng.integers(value.size + 1)]
        if kind == 1:
            return np.concatenate([value, value[: rng.integers(1, value.size + 1)]])
        spoilt = value.copy()
        some = rng.random(value.size) < rng.choice([0.01, 0.3, 1.0])
        if value.dtype.kind == "f":
            with np.errstate(over="ignore"):
                spoilt[some] = rng.choice(ODD_FLOATS, int(some.sum()))
        elif value.dtype.kind == "b":
            spoilt[some] = ~spoilt[some]
        else:
            spoilt[some] = rng.integers(0, 2, int(some.sum())) * np.iinfo(value.dtype).max
        return spoilt

    def _list(self, value: list[Any], name: str) -> list[Any]:
        rng = self._rng
        if not value:
            return value
        at = int(rng.integers(len(value)))
        kind = rng.integers(4)
        if kind == 0:
            return value[:at] + value[at + 1 :]
        if kind == 1:
            return [*value, value[at]]
        if kind == 2:
            return value[::-1]
        return [*value[:at], self._other(value[at], name), *value[at + 1 :]]
