"""A certificate's folder, and how Zenoh is told to use it.

The standard library only: `stop` imports this before anything else.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

CA, CERTIFICATE, KEY = "ca.pem", "certificate.pem", "key.pem"
"""The files of a folder: the authority's certificate, the own one, its private key."""
ROBOT = "robot"
"""Folder of the robot's own certificate."""
CONNECT, NAME, DOMAIN = "RBTRG_CONNECT", "RBTRG_CERT", "ROS_DOMAIN_ID"
"""Environment: tls/ADDRESS:PORT of a robot on another computer, whose certificate to show it, its ROS domain."""


@dataclass(frozen=True, slots=True)
class Remote:
    """A stack on another computer."""

    endpoint: str
    domain: int
    folder: Path
    """Of the certificate that is shown there."""


def keys_dir() -> Path:
    """The default folder of keys."""
    base = os.environ.get("XDG_CONFIG_HOME")
    return (Path(base) if base else Path.home() / ".config") / "rbtrg" / "keys"


def remote() -> Remote | None:
    """The stack that RBTRG_CONNECT names; None where the stack of this computer is meant."""
    endpoint = os.environ.get(CONNECT, "")
    if not endpoint:
        return None
    domain = os.environ.get(DOMAIN, "")
    # Joined to an absolute path it is that path: RBTRG_CERT is a name or a folder.
    return Remote(
        endpoint, int(domain) if domain.isdecimal() else 0, keys_dir() / os.environ.get(NAME, "nobody")
    )


def problem(folder: Path) -> str:
    """Why the folder's certificate cannot be used, in words; empty where it can."""
    for file in (CA, CERTIFICATE, KEY):
        if not (folder / file).is_file():
            return f"there is no {folder / file}"
    if (folder / KEY).stat().st_mode & 0o077:
        return f"others may read {folder / KEY}: chmod 600 it; if somebody did read it, make a new one"
    return ""


def client_tls(folder: Path) -> dict[str, Any]:
    """Zenoh's `transport.link.tls` of one who connects.

    The name is not compared: a robot's address changes. The authority signs one certificate for servers, the robot's,
    and a person's certificate is refused as a server's by its key usage."""
    return {
        "root_ca_certificate": str(folder / CA),
        "enable_mtls": True,
        "connect_certificate": str(folder / CERTIFICATE),
        "connect_private_key": str(folder / KEY),
        "verify_name_on_connect": False,
        "close_link_on_expiration": True,
    }


def server_tls(folder: Path) -> dict[str, Any]:
    """Zenoh's `transport.link.tls` of the robot's router: nobody connects without a certificate of the same
    authority."""
    return {
        "root_ca_certificate": str(folder / CA),
        "enable_mtls": True,
        "listen_certificate": str(folder / CERTIFICATE),
        "listen_private_key": str(folder / KEY),
        "close_link_on_expiration": True,
    }
