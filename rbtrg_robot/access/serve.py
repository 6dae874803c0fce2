"""Settings that let the router of a stack serve other computers."""

from __future__ import annotations

from pathlib import Path

from rbtrg_robot.access.certificates import check, members
from rbtrg_robot.access.identity import ROBOT, keys_dir, server_tls
from rbtrg_robot.access.rules import access_control
from rbtrg_robot.config import StackConfig
from rbtrg_robot.wire.session import Security


def keys_folder(config: StackConfig) -> Path:
    """Of the robot's certificate."""
    return Path(config.network.keys or keys_dir() / ROBOT)


def security(config: StackConfig) -> Security | None:
    """Certificate and rules; None where all who come in have all rights. Raises KeysError."""
    neighbours = (config.public,) if config.closed else ()
    if not config.network.listen:
        rules = access_control(config.scope, {}, closed=True)
        return Security({}, neighbours=neighbours, access_control=rules) if config.closed else None
    folder = keys_folder(config)
    check(folder)
    rules = access_control(config.scope, members(folder), closed=config.closed)
    return Security(server_tls(folder), config.network.listen, neighbours, rules)
