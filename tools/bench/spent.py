"""Processor time of the parts of a lockstep run, all threads."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.processes import PROCESSES


class Spent:
    """Counts the processor time [s] of each stage, and inside the robot that of physics, controller and LiDAR."""

    def __init__(self, stack: Lockstep) -> None:
        self.seconds: dict[str, float] = {}
        names = [p.name for p in PROCESSES if p.hosted and p.name not in stack.config.absent]
        for name in names:
            self._count(stack.host.stage(name), ("on", "tick"), name)
        self._count(stack.robot, ("on", "tick"), "robot")
        backend: Any = stack.robot.backend
        self._count(backend.simulation, ("step",), "robot.physics")
        self._count(backend.controller, ("step",), "robot.controller")
        for lidar in backend._lidars:
            self._count(lidar, ("advance",), "robot.lidar")

    def _count(self, owner: Any, methods: tuple[str, ...], name: str) -> None:
        self.seconds.setdefault(name, 0.0)

        def counted(method: Callable[..., Any]) -> Callable[..., Any]:
            def call(*args: Any, **fields: Any) -> Any:
                began = time.process_time()
                try:
                    return method(*args, **fields)
                finally:
                    self.seconds[name] += time.process_time() - began

            return call

        for method in methods:
            setattr(owner, method, counted(getattr(owner, method)))
