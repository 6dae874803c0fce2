"""Hosts run stages: live on Zenoh, in lockstep with the simulator, offline on a log."""

from rbtrg_robot.hosts.lockstep import Lockstep

__all__ = ["Lockstep"]
