"""A process that says ready compiles nothing more: a compilation holds it up for seconds and looks like a hang."""

from __future__ import annotations

import gc
import math
import multiprocessing
from pathlib import Path
from typing import Any

import pytest

from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.wire.messages import header

DRIVEN = 5.0
"""[s] of the log that hold no question where to explore."""
STAGES = ("odometry", "elevation", "planner", "guard", "robot")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive over the yard with its log; the planner is asked where to explore on the way."""
    path = tmp_path_factory.mktemp("drive") / "log_0.mcap"
    config = load(None, ["recorder.profile=full", "sim.lidar_step=8"], scene="yard")
    with Lockstep(config, Lockstep.open_log(config, path)) as stack:
        stack.wait_ready()
        stack.send_goal(*config.load_scene().goals["a"])
        stack.run(5.0)
        for target in (0.0, 3.0):
            where = msg.ExploreQuestion(
                header=header(stack.now, "map"), has_home=True, has_target=True, target_x=target
            )
            stack.host.inject(t.EXPLORE_QUESTION, where)
            stack.run(0.5)
    return path


@pytest.mark.parametrize(
    ("name", "first"), [*((name, name == "elevation") for name in STAGES), ("planner", True)]
)
def test_nothing_is_compiled_after_the_warm_up(name: str, first: bool, log: Path) -> None:
    """`first`: what a first start compiles before the others."""
    # A process of its own for each: what one stage compiled would hide what another lacks. They share the imports.
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__, "rbtrg_robot.hosts.offline", "rbtrg_robot.stages.planner"])
    with context.Pool(1) as pool:
        assert pool.apply(_late, (name, first, log)) == []


def _late(name: str, first: bool, log: Path) -> list[str]:
    """Kernels and argument types that one stage had not seen when it said it was warm."""
    from rbtrg_robot.hosts import offline as module

    if name == "robot":
        return _late_in_simulator()
    warm: set[str] = set()

    class Host(module.SyncHost):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            warm.update(_compiled())

    module.SyncHost = Host  # type: ignore[misc]
    if first:
        module.warm = lambda stage: stage.warm_up()  # type: ignore[assignment]
    counts = module.rerun(log, [name], log.with_name(f"{name}.mcap"), duration=DRIVEN if first else math.inf)
    assert warm
    assert counts
    return sorted(_compiled() - warm)


def _late_in_simulator() -> list[str]:
    from rbtrg_robot.hosts.robot import build
    from rbtrg_robot.hosts.sync import SyncHost
    from rbtrg_robot.stages.robot import STEP_PERIOD

    stage = build(load(None, ["recorder.profile=full", "sim.lidar_step=8"], scene="yard"))
    stage.warm_up()
    warm = _compiled()
    host = SyncHost({"robot": (stage, STEP_PERIOD / 1e9)})
    for step in range(1, 1200):
        command = t.CMD_VEL.kind(header=header(host.now, "base_link"))
        command.twist.linear.x, command.twist.angular.z = 0.4, 0.5 * (step > 900)
        if step % 4 == 0:
            host.inject(t.CMD_VEL, command)
        host.tick(step * STEP_PERIOD)
    host.close()
    assert warm
    return sorted(_compiled() - warm)


def _compiled() -> set[str]:
    from numba.core.dispatcher import Dispatcher

    return {
        f"{kernel.py_func.__module__}.{kernel.py_func.__qualname__}{types}"
        for kernel in gc.get_objects()
        if isinstance(kernel, Dispatcher)
        for types in kernel.overloads
    }
