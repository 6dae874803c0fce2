"""Where a robot's topics lie on a network: its ROS domain, and its name as their namespace.

The standard library only: `stop` imports this before anything else.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

ROBOT = "go2w"
"""Name of a robot that was given none. Its topics have no namespace, as ROS tools expect where there is one robot."""
NAMED = "RBTRG_ROBOT"
"""Environment: the robot that commands mean where they are told no other."""


def meant() -> str:
    """The robot that a command means which names none."""
    return os.environ.get(NAMED) or ROBOT


@dataclass(frozen=True, slots=True)
class Scope:
    """Robots whose scopes differ hear nothing of each other."""

    domain: int = 0
    namespace: str = ""
    """Without slashes; empty for none. ROS knows no hyphens in names."""

    @classmethod
    def of(cls, domain: int, robot: str) -> Scope:
        """That of a robot of this name."""
        return cls(domain, "" if robot == ROBOT else robot.replace("-", "_"))

    @property
    def prefix(self) -> str:
        """What its keys begin with: `0` or `0/a`."""
        return f"{self.domain}/{self.namespace}" if self.namespace else str(self.domain)

    @classmethod
    def wanted(cls, domain: int, robot: str) -> str:
        """Key prefix of the robot that an emergency stop means, if nobody knows what runs; without a name, every
        robot there."""
        return f"{domain}/**" if robot == ROBOT else cls.of(domain, robot).prefix

    def topic(self, name: str) -> str:
        """The full ROS name of a topic: `/odom` or `/a/odom`."""
        return f"/{self.namespace}{name}" if self.namespace else name
