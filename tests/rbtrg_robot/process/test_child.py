"""The program of a process before it is ready."""

from __future__ import annotations

import gc
import signal
from contextlib import nullcontext
from typing import Any

import pytest

from rbtrg_robot.config import load
from rbtrg_robot.hosts import live
from rbtrg_robot.process.child import run
from rbtrg_robot.wire import bus


def test_what_is_loaded_when_it_is_ready_is_not_searched_for_garbage_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    frozen = list[int]()

    class Host:
        def __init__(self, *arguments: Any, **options: Any) -> None:
            frozen.append(gc.get_freeze_count())

        def restore(self, messages: Any) -> None: ...

        def run(self, stop: Any) -> None: ...

    monkeypatch.setattr(live, "Node", Host)
    monkeypatch.setattr(bus, "Bus", lambda *arguments, **options: nullcontext())
    before = signal.getsignal(signal.SIGTERM)
    spec = {
        "process": "tracker",
        "config": load(None, []).model_dump(mode="json"),
        "clock": 0,
        "stack": "one",
        "restored": {},
        "hurry": False,
    }
    try:
        assert run(spec) == 0
    finally:
        signal.signal(signal.SIGTERM, before)
        gc.unfreeze()
    assert frozen[0] > 10_000
