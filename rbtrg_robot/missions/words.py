"""A mission's state in words and as a record."""

from __future__ import annotations

from typing import Any

from rbtrg_robot.msg import MissionState

ENDED = ("finished", "failed", "stopped")


def line(state: MissionState) -> str:
    """A mission in one line, without its question."""
    if not state.order_id:
        return "no mission"
    name = f"mission {state.name}".strip()
    count = len(state.action_id)
    step = f" ({state.action_id[state.step - 1]})" if 1 <= state.step <= count else ""
    where = f", step {state.step} of {count}{step}"
    if state.tries:
        where += f", try {state.tries + 1}"
    if len(state.loop_rounds):
        where += f", rounds done {' '.join(str(r) for r in state.loop_rounds)}"
    text = f"{name} {state.phase}" + ("" if state.phase == "finished" else where)
    if state.returning and state.phase not in ENDED:
        text += f"; on its way home: {state.failure}"
    return f"{text}: {state.reason}" if state.reason else text


def lines(state: MissionState) -> list[str]:
    """A mission in words: one line, then one for each step."""
    text = line(state)
    if state.question:
        text += f": {state.question} `rbtrg-robot mission answer {'|'.join(state.choices)}`"
    rows = zip(state.action_id, state.action_status, state.result_description, strict=True)
    warned = [state.warning] if state.warning else []
    return [text, *warned, *(f"{k:4d} {a:20s} {s:9s} {r}".rstrip() for k, (a, s, r) in enumerate(rows, 1))]


def as_record(state: MissionState) -> dict[str, Any]:
    """A mission for `--json`: VDA 5050's words where it has them."""
    keys = (
        "name",
        "owner",
        "phase",
        "reason",
        "returning",
        "failure",
        "warning",
        "step",
        "tries",
        "question",
    )
    rows = zip(state.action_id, state.action_type, state.action_status, state.result_description, strict=True)
    names = ("actionId", "actionType", "actionStatus", "resultDescription")
    return {
        "orderId": state.order_id,
        "orderUpdateId": state.order_update_id,
        "map": state.map,
        **{key: getattr(state, key) for key in keys},
        "choices": list(state.choices),
        "loopRounds": [int(r) for r in state.loop_rounds],
        "actionStates": [dict(zip(names, row, strict=True)) for row in rows],
    }
