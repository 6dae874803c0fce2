"""How sessions are set up."""

from __future__ import annotations

import json
import os
from typing import Any

import pytest
import zenoh

from rbtrg_robot.wire import session
from tools.bench.ports import free_endpoint


@pytest.mark.parametrize("own", ["", "(acc: (worker_threads: 3))"])
def test_a_router_lets_in_with_more_threads_than_one_and_its_children_do_not_inherit_that(
    own: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[str] = []
    monkeypatch.setattr(zenoh, "open", lambda config: seen.append(os.environ[session.RUNTIME]))
    monkeypatch.delenv(session.RUNTIME, raising=False)
    if own:
        monkeypatch.setenv(session.RUNTIME, own)
    session.open_router(session.session_config(free_endpoint(), router=True))
    assert seen == [own or session.RUNTIME_OF_ROUTER]
    assert os.environ.get(session.RUNTIME, "") == own


def test_limits_of_a_router_are_beyond_what_one_visitor_opens() -> None:
    def told(router: bool) -> Any:
        return json.loads(
            session.session_config(free_endpoint(), router=router).get_json("transport/unicast")
        )

    assert (told(True)["accept_pending"], told(True)["max_sessions"]) == (
        session.MOST_CONNECTIONS,
        session.MOST_CONNECTIONS,
    )
    assert told(True)["max_links"] == told(False)["max_links"] == 1
