"""The stack as a systemd service: the unit file of this installation."""

from __future__ import annotations

import getpass
import os
import sys
from pathlib import Path

from hal.errors import OperatorError
from rbtrg_robot.process.child import FATAL

WATCHDOG_TIME = 30
"""[s] without a sign of life of the supervisor's loop. It may wait for a new zygote, whose imports take seconds on a
busy computer."""
START_TIME = 600
"""[s] until ready: a cold start compiles the kernels."""
STOP_TIME = 20
"""[s] for the orderly end; it takes about 4 s at most."""

_UNIT = """\
# Written by `rbtrg-robot service install`. Local changes: `systemctl edit {name}`.
[Unit]
Description=rbtrg-robot, robot {robot}
After=network-online.target
Wants=network-online.target
# A robot that is switched on an hour later is found then: there is no limit to the number of starts.
StartLimitIntervalSec=0

[Service]
Type=notify
{user}ExecStart={up}
# `down` tells the supervisor alone, which stops the robot first and the recorder last, and waits for the end.
# After a crash of the supervisor every process gets SIGTERM and time:
# the robot process and its guardian stop the robot.
ExecStop={down}
KillMode=control-group
TimeoutStartSec={start}
TimeoutStopSec={stop}
WatchdogSec={watchdog}
# A supervisor that hangs: SIGABRT would end robot process and guardian at once, and nobody would stop the robot.
WatchdogSignal=SIGTERM
# A process that the kernel kills for its memory is started again by the supervisor; the others go on.
OOMPolicy=continue
Restart=on-failure
RestartSec=5
# A process was given up: a restart does not help, somebody has to look.
RestartPreventExitStatus={fatal}
LogsDirectory={name}
CacheDirectory={name}
Environment=NUMBA_CACHE_DIR=%C/{name}
{hardening}
[Install]
WantedBy={target}
"""
_USER = """\
User={user}
RuntimeDirectory={name}
# An emergency stop and a mission outlive the service, see `process.latch`.
RuntimeDirectoryPreserve=yes
Environment=XDG_RUNTIME_DIR=%t/{name}
"""
_ANYWHERE = """\
NoNewPrivileges=yes
LockPersonality=yes
RestrictSUIDSGID=yes
RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6 AF_NETLINK
SystemCallArchitectures=native
UMask=0027
"""
_SYSTEM = """\
CapabilityBoundingSet=
ProtectSystem=strict
ProtectHome=read-only
PrivateTmp=yes
ProtectClock=yes
ProtectHostname=yes
ProtectKernelTunables=yes
ProtectKernelModules=yes
ProtectKernelLogs=yes
ProtectControlGroups=yes
RestrictNamespaces=yes
"""
"""What a manager without privileges may be unable to set up. Not MemoryDenyWriteExecute: numba compiles at run time."""


class ServiceError(OperatorError):
    """The unit file cannot be written or is not there."""


def unit_name(robot: str) -> str:
    """One unit for each robot."""
    return f"rbtrg-robot-{robot}"


def unit_path(robot: str, *, user: bool) -> Path:
    """Where the unit file belongs: for the whole computer, or for the services of this user."""
    if not user:
        return Path("/etc/systemd/system") / f"{unit_name(robot)}.service"
    base = os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config"
    return Path(base) / "systemd" / "user" / f"{unit_name(robot)}.service"


def account() -> str:
    """Who runs the service of the whole computer: the one who called sudo, else this user."""
    return os.environ.get("SUDO_USER") or getpass.getuser()


def unit(robot: str, options: list[str], *, user: bool) -> str:
    """Text of the unit file. `options`: of `up`, beside the folder for logs."""
    name = unit_name(robot)
    command = [sys.executable, "-m", "rbtrg_robot.cli"]
    up = " ".join([*map(quoted, [*command, "up", *options, "--log-dir"]), f"%L/{name}"])
    return _UNIT.format(
        name=name,
        robot=robot,
        user="" if user else _USER.format(user=account(), name=name),
        up=up,
        down=" ".join(map(quoted, [*command, "down", "--robot", robot])),
        start=START_TIME,
        stop=STOP_TIME,
        watchdog=WATCHDOG_TIME,
        fatal=FATAL,
        hardening=_ANYWHERE + ("" if user else _SYSTEM),
        target="default.target" if user else "multi-user.target",
    )


def quoted(word: str) -> str:
    """A word of a command line, as systemd.service(5) reads it."""
    escaped = word.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%").replace("$", "$$")
    return (
        f'"{escaped}"' if escaped != word or not word or any(c.isspace() or c in "';" for c in word) else word
    )


def write(path: Path, text: str) -> None:
    """Put the unit file in place. Raises ServiceError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    except OSError as error:
        raise ServiceError(
            f"cannot write {path}: {error.strerror}; run it with sudo, as a service of yours with --user, or "
            "look at it with --dry-run"
        ) from error
