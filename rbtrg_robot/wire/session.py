"""How a Zenoh session of ours is set up: router or client, its id, TLS and access rules."""

from __future__ import annotations

import json
import os
import secrets
from dataclasses import dataclass, field
from typing import Any

import zenoh

MOST_CONNECTIONS = 100_000
"""Connections that a router takes, before and after identification. Zenoh counts all ports together. With its own
limits of 100 and 1000, anybody whose certificate the authority once signed, on the list or not, keeps the robot's own
processes out."""
LEASE_MS = 10_000
"""A session that is silent this long is ended [ms]. A death is seen at once and a hang by the heartbeats, both long
before. With 2 s, a router that was held up for 5 s lost all sessions, and Zenoh mixes up topics while they come back.
"""
RUNTIME, RUNTIME_OF_ROUTER = "ZENOH_RUNTIME", "(acc: (worker_threads: 8))"
"""Zenoh closes a connection that is silent after TLS in 25 ms of one thread, and lets nobody else in through it
meanwhile."""


def stack_id() -> str:
    """What the session ids of one stack's processes begin with: 8 hexadecimal digits, the first not 0."""
    return f"5{secrets.token_hex(4)[1:]}"


@dataclass(frozen=True, slots=True)
class Security:
    """Zenoh's settings for sessions between computers."""

    tls: dict[str, Any]
    listen: tuple[str, ...] = ()
    """Where the router listens too."""
    neighbours: tuple[str, ...] = ()
    """Where the router listens for other users of this computer."""
    access_control: dict[str, Any] = field(default_factory=dict)
    """Of the router."""


def open_router(config: zenoh.Config) -> zenoh.Session:
    """A session that serves others. Raises zenoh.ZError. Zenoh takes its number of threads from the environment, once
    per process."""
    ours = RUNTIME not in os.environ
    if ours:
        os.environ[RUNTIME] = RUNTIME_OF_ROUTER
    try:
        return zenoh.open(config)
    finally:
        if ours:
            del os.environ[RUNTIME]


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
                    "lease": LEASE_MS,
                    # A scan is half a megabyte; with the default of two 64 kB batches and 1 ms of patience a busy
                    # machine loses the first ones. Commands go out one a batch: with two, a machine whose cores are
                    # taken for 60 ms loses velocities and the guard's limits (59 of 854 beside 20 busy programs).
                    "queue": {
                        "size": {"data": 16, "real_time": 16},
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
        if security.tls:
            config["transport"]["link"]["tls"] = security.tls
        endpoints += [*security.listen, *security.neighbours]
        if security.access_control:
            config["access_control"] = security.access_control
    config["listen" if router else "connect"] = {"endpoints": endpoints}
    if router:
        config["transport"]["unicast"] = {
            "accept_pending": MOST_CONNECTIONS,
            "max_sessions": MOST_CONNECTIONS,
        }
    else:
        config["connect"]["timeout_ms"] = 3000
        config["listen"] = {"endpoints": []}
    return zenoh.Config.from_json5(json.dumps(config))
