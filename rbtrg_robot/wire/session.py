"""How a Zenoh session of ours is set up: router or client, its id, TLS and access rules."""

from __future__ import annotations

import json
import secrets
from dataclasses import dataclass, field
from typing import Any

import zenoh


def stack_id() -> str:
    """What the session ids of one stack's processes begin with: 8 hexadecimal digits, the first not 0."""
    return f"5{secrets.token_hex(4)[1:]}"


@dataclass(frozen=True, slots=True)
class Security:
    """Zenoh's settings for sessions between computers."""

    tls: dict[str, Any]
    listen: tuple[str, ...] = ()
    """Where the router listens too."""
    access_control: dict[str, Any] = field(default_factory=dict)
    """Of the router."""


def session_config(
    endpoint: str, *, router: bool, stack: str = "", security: Security | None = None
) -> zenoh.Config:
    """Zenoh configuration of the router (`up`) or of a client of it. `stack`: what the session id begins with."""
    config: dict[str, Any] = {
        **({"id": stack + secrets.token_hex(12)} if stack else {}),
        "mode": "router" if router else "client",
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": True}},
        "timestamping": {"enabled": True},
        "transport": {
            "link": {
                "tx": {
                    "lease": 2000,
                    # A scan is half a megabyte; with the default of two 64 kB batches and 1 ms of patience a busy
                    # machine loses the first ones.
                    "queue": {
                        "size": {"data": 16},
                        "congestion_control": {"drop": {"wait_before_drop": 20_000}},
                    },
                }
            },
            # Queries through shared memory are lost silently when the receiver stalls. "init": a lazily made pool
            # sends the first large messages through the socket.
            "shared_memory": {"mode": "init", "transport_optimization": {"messages": ["put"]}},
        },
    }
    endpoints = [endpoint]
    if security is not None:
        config["transport"]["link"]["tls"] = security.tls
        endpoints += security.listen
        if security.access_control:
            config["access_control"] = security.access_control
    config["listen" if router else "connect"] = {"endpoints": endpoints}
    if not router:
        config["connect"]["timeout_ms"] = 3000
        config["listen"] = {"endpoints": []}
    return zenoh.Config.from_json5(json.dumps(config))
