"""A console on a robot that is played."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tools.bench.console.stack import Console, Robot


@pytest.fixture(scope="module")
def console(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Console]:
    """One for the tests of a file."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("run")))
        robot = Robot()
        made = Console(robot, tmp_path_factory.mktemp("console"))
        yield made
        made.close()
        robot.close()
