"""Who gives orders here. The standard library only: commands import it before they know what to do."""

from __future__ import annotations

import getpass
import socket


def me() -> str:
    """For whoever else is at the robot."""
    return f"{getpass.getuser()}@{socket.gethostname()}"
