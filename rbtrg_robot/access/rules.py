"""Zenoh's access control, made from the table of topics: what no row allows is denied.

`**` does not match a chunk that begins with `@`: without the patterns of their own, latched messages (`@adv`) and
process tokens (`@ros2_lv`) would be lost in silence.
"""

from __future__ import annotations

from typing import Any

from rbtrg_robot import topics as t
from rbtrg_robot.scope import Scope
from rbtrg_robot.topics import Role
from rbtrg_robot.wire import keys

LOCAL, NEIGHBOUR = "local", "neighbour"
ASKED = ("status", "events")
"""What outsiders may ask the supervisor."""
EVERY_MESSAGE = (
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "reply",
    "declare_queryable",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
)
SEE = ("declare_subscriber", "liveliness_query", "declare_liveliness_subscriber")
"""What one who sees sends."""
SIGHT = ("hear", "see", "ask", "stop")
"""Rules of everybody who has a role."""
RANKS = {Role.OBSERVER: (Role.OBSERVER,), Role.OPERATOR: (Role.OBSERVER, Role.OPERATOR)}
"""A role and those whose rights it has."""


def access_control(scope: Scope, members: dict[Role, list[str]], *, closed: bool = False) -> dict[str, Any]:
    """Zenoh's `access_control` of the router. `members`: common names of the certificates that have each role.

    `closed`: all rights on this computer come with the socket in the run folder; who comes by TCP is an observer.

    Who has none of these certificates may do nothing, whoever signed it. Outsiders declare no token and answer no
    query: with those they could pass for a process that died, or hand out a false map.
    """
    data, latched = f"{scope.prefix}/**", f"{scope.prefix}/**/@adv/**"
    all_keys = [
        data,
        latched,
        f"@ros2_lv/{scope.domain}/**",
    ]  # ROS tools ask for the tokens of a whole domain
    # `stop` of somebody who does not know the robot's name.
    stop, state = (
        f"{scope.domain}/**/{keys.key(x, scope).removeprefix(scope.prefix + '/')}"
        for x in (t.ROBOT_STOP, t.ROBOT_STATE)
    )
    rules: list[dict[str, Any]] = [
        _rule(LOCAL, EVERY_MESSAGE, ["**", "**/@adv/**", "@ros2_lv/**"]),
        _rule("hear", EVERY_MESSAGE, all_keys, "egress"),
        _rule("see", SEE, [*all_keys, state.rpartition("/")[0] + "/*"], "ingress"),
        _rule("stop", ("put",), [stop], "ingress"),
        _rule(
            "ask",
            ("query",),
            [latched, *(keys.service(name, scope) for name in ASKED)],
            "ingress",
        ),
    ]
    loopback = {"link_protocols": ["tcp"], "interfaces": ["lo"]}
    subjects: list[dict[str, Any]] = [
        {"id": LOCAL, **({"link_protocols": ["unixsock-stream"]} if closed else loopback)}
    ]
    policies: list[dict[str, Any]] = [{"rules": [LOCAL], "subjects": [LOCAL]}]
    if closed:
        subjects.append({"id": NEIGHBOUR, **loopback})
        policies.append({"rules": [*SIGHT, Role.OBSERVER.value], "subjects": [NEIGHBOUR]})
    for role, own in RANKS.items():
        rules.append(_rule(role.value, ("put",), [keys.key(x, scope) for x in publishable(role)], "ingress"))
        if members.get(role):  # Zenoh refuses a subject with an empty list of names
            names = members[role]
            subjects.append({"id": role.value, "cert_common_names": names, "link_protocols": ["tls"]})
            allowed = [*SIGHT, *(x.value for x in own)]
            policies.append({"rules": allowed, "subjects": [role.value]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def publishable(role: Role) -> list[t.Topic]:
    """Topics whose rows name exactly this role, in table order."""
    return [topic for topic in t.TOPICS if topic.publish_by is role]


def _rule(name: str, messages: tuple[str, ...], key_exprs: list[str], *flows: str) -> dict[str, Any]:
    return {
        "id": name,
        "permission": "allow",
        "flows": list(flows or ("ingress", "egress")),
        "messages": list(messages),
        "key_exprs": key_exprs,
    }
