"""The viewer's window on the running simulation."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from rbtrg_robot.hosts.robot import Window


class Handle:
    """MuJoCo's handle, counting."""

    def __init__(self) -> None:
        self.synced, self.open = 0, True

    def is_running(self) -> bool:
        return self.open

    def sync(self) -> None:
        assert self.open, "a closed window must not be drawn"
        self.synced += 1

    def close(self) -> None:
        self.open = False


def test_the_window_draws_25_times_a_second_until_it_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    handle, given, now = Handle(), [], [100.0]

    def launch(model: object, data: object) -> Handle:
        given.extend([model, data])
        return handle

    monkeypatch.setattr("hal.mujoco.view.render.launch_viewer", launch)
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    window = Window(SimpleNamespace(simulation=SimpleNamespace(model="model", data="data")))
    assert given == ["model", "data"]
    for _ in range(1000):  # one second of the robot's loop
        window.show()
        now[0] += 0.001
    assert 24 <= handle.synced <= 26
    handle.open = False  # the user closes it
    drawn = handle.synced
    now[0] += 1.0
    window.show()
    assert handle.synced == drawn
    window.close()
